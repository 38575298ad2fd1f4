"""The JSON Schema: in step with the models, and with what the loader takes."""

import json
import os

import pytest
import yaml

from sfol.errors import InvalidKnowledgeBase
from sfol.knowledge_base import KnowledgeBase
from sfol.knowledge_base.schema import json_schema, schema_text
from tests.sfol.command_line import ROOT, RULES, sfol
from tests.sfol.conftest import KITCHEN

jsonschema = pytest.importorskip("jsonschema")

COMMITTED = ROOT / "sfol" / "knowledge_base.schema.json"
BASE = KITCHEN.replace("{SEMANTICS}", "{}")
FILES = sorted(RULES.rglob("*.yaml"))


@pytest.fixture(scope="module")
def validator():
    jsonschema.Draft202012Validator.check_schema(json_schema())
    return jsonschema.Draft202012Validator(json_schema())


def test_the_committed_schema_is_that_of_the_models():
    hint = "run: sfol schema > sfol/knowledge_base.schema.json"
    assert COMMITTED.read_text() == schema_text(), hint
    assert sfol("schema").out == schema_text()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_bundled_file_names_the_schema_and_follows_it(validator, path):
    first = path.read_text().partition("\n")[0]
    schema = os.path.relpath(COMMITTED, path.parent)
    assert first == f"# yaml-language-server: $schema={schema}"
    validator.validate(yaml.safe_load(path.read_text()))


def test_everything_has_a_description_and_what_may_be_left_out_a_default():
    schema = json_schema()
    for model in (schema, *schema["$defs"].values()):
        assert model["description"]
        needed = {
            *model.get("required", ()),
            "normalizer",
            "coefficients",
            "formula",
            "unit",
            "from",
            "at_most",
            "to",
            "over",
        }
        for name, entry in model["properties"].items():
            assert entry["description"], name
            assert "default" in entry or name in needed or "weight" in name, name


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("", ""),
        ("rules:\n", "rules:\n  more: {rule: 'careful(X) :- Hot(X).', threshold: 0.5}\n"),
        ("rules:\n", "rules:\n  more: {description: no rule}\n"),
        ("rules:\n", "ruels:\n"),
        ("rules:\n", "rules:\n  more: {rule: 'careful(X) :- Hot(X).', threshold: 1.5}\n"),
        ("{unit: m/s}", "{}"),
        ("normalizer: 1", "normalizer: 0"),
        ("normalizer: 1, ", ""),
        ("weight: care, ", ""),
        ("weight: care, ", "weight: 1.5, "),
        ("version: 1", "version: 2"),
        ("name: kitchen", "name: 7"),
        ("k: 2.0", "k: fast"),
    ],
)
def test_schema_and_loader_agree(tmp_path, validator, old, new):
    text = BASE.replace(old, new, 1) if old else BASE
    path = tmp_path / "kitchen.yaml"
    path.write_text(text)
    try:
        KnowledgeBase.load(path)
    except InvalidKnowledgeBase:
        assert not validator.is_valid(yaml.safe_load(text))
    else:
        validator.validate(yaml.safe_load(text))


OVERLAY = "version: 1\nname: overlay\nextends: kitchen\n"


@pytest.mark.parametrize(
    "change",
    [
        "terms: {haste: {parameters: {k: 3.0}}}",
        "weights: {care: {normalizer: 2}}",
        "signals: {speed: {default: 0.0}}",
        "remove: {rules: [care]}",
        "semantics: {disjunction: probabilistic_sum}",
    ],
)
def test_an_overlay_may_leave_out_what_it_does_not_change(tmp_path, validator, change):
    (tmp_path / "kitchen.yaml").write_text(BASE)
    path = tmp_path / "overlay.yaml"
    path.write_text(OVERLAY + change)
    KnowledgeBase.load(path)
    data = yaml.safe_load(OVERLAY + change)
    validator.validate(data)
    if "remove" not in data and "semantics" not in data:
        del data["extends"]
        assert not validator.is_valid(data)


def test_it_is_json_for_an_editor():
    assert json.loads(schema_text())["$schema"].startswith("https://json-schema.org/draft/")
