"""YAML: whatever stands in a file, it becomes plain data, or an error of ours says where it stands."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfol import KnowledgeBase, strict_yaml
from sfol.errors import FileError, InvalidKnowledgeBase
from sfol.strict_yaml import MAXIMUM_DEPTH, MAXIMUM_VALUES, parse
from tests.sfol.conftest import KITCHEN
from tests.sfol.work import calls

TAGS = ["", "!!bool ", "!!int ", "!!float ", "!!null ", "!!str ", "!!timestamp ", "!!binary ", "!!merge ",
        "!!map ", "!!seq ", "!!set ", "!!omap ", "!!python/object/apply:os.system ", "!foo ", "!<x> ", "! "]  # fmt: skip
SCALARS = ["maybe", "''", '""', "true", "~", "null", "0", "0x", "0x" + "f" * 5000, "9" * 400, "9" * 5000,
           "-" + "9" * 399, "1e999", "-.inf", ".nan", "1_000", "0b1", "1:30", "2020-01-01", "=", "<<", "*a",
           "&a x", "'\ud800'", '"\\ud800"', '"\\U0011FFFF"', '"\\UFFFFFFFF"', '"\\x9b"', '"\\e"', "\x07",
           "[1, 2]", "{x: 1}", "[", "{", "- x", "? x", "| x", "%", "@", "`", "#", "٣", "🙂"]  # fmt: skip
SHAPES = [
    "a: {}",
    "{}: 1",
    "? {}\n: 1",
    "a: [{}]",
    "a: {{b: {}}}",
    "- {}",
    "{}",
    "a: &x {}\nb: *x",
    "<<: {}",
]
values = st.builds(
    str.__add__, st.sampled_from(TAGS), st.sampled_from(SCALARS) | st.text(max_size=8)
)


def parsed(text):
    """Return the data of a text, or the error that says where it is wrong."""
    try:
        return parse(text, "x.yaml").data
    except FileError as error:
        found = error
    assert (found.place.file, found.place.line >= 1, found.place.column >= 1) == (
        "x.yaml",
        True,
        True,
    )
    assert found.place.line <= text.count("\n") + len(text.splitlines()) + 1
    return found


def plain(data):
    if isinstance(data, dict):
        return all(isinstance(key, str) and plain(value) for key, value in data.items())
    if isinstance(data, list):
        return all(map(plain, data))
    return data is None or type(data) in (str, int, float, bool)


@settings(max_examples=400)
@given(
    st.builds(str.format, st.sampled_from(SHAPES), values)
    | st.text()
    | st.text("a:-[]{}?&*!|>'\" \n<", max_size=30)
)
def test_every_text_becomes_plain_data_or_an_error_with_its_place(text):
    found = parsed(text)
    assert isinstance(found, FileError) or plain(found)


@pytest.mark.parametrize(
    ("text", "where", "message"),
    [
        ("a: 1\nb: !!bool maybe", "2:4", "'maybe' is not a value of this kind"),
        ("a: !!int ''", "1:4", "'' is not a value of this kind"),
        ("a: 0x" + "f" * 5000, "1:4", "is not a value of this kind"),
        ("a: !!int {x: 1}", "1:4", "values of the kind 'tag:yaml.org,2002:int' are not allowed"),
        ("a: !foo [x]", "1:4", "values of the kind '!foo' are not allowed"),
        ("? !!bool maybe\n: 1", "1:3", "'maybe' is not a value of this kind"),
        ('a: 1\nb: "\\U0011FFFF"', "2:7", "there is no such character"),
        ('a: "\\UFFFFFFFF"', "1:7", "there is no such character"),
        ("a: 1\nb: x\ud800", "2:5", "it has the character '\\ud800'"),
        ("a: \x07", "1:4", "it has the character '\\x07'"),
    ],
)
def test_an_error_says_where_it_is(text, where, message):
    error = parsed(text)
    assert message in str(error)
    assert str(error.place) == f"x.yaml:{where}"


def test_what_is_not_merged_is_a_key_like_others():
    assert parsed("a: &a {x: 1}\nb: {<<: *a}") == {"a": {"x": 1}, "b": {"<<": {"x": 1}}}


BOMBS = {
    "aliases": "".join(f"k{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9 if i else [])}]\n" for i in range(12)),
    "merges": "".join(f"k{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 9 if i else [])}]}}\n" for i in range(12)),
    "chain": "k0: &a0 {x: 1}\n" + "".join(f"k{i}: &a{i} {{<<: *a{i - 1}}}\n" for i in range(1, 400)),
    "itself": "a: &a {<<: *a}\n",
    "depth": "a: " + "{a: " * 5000,
    "lists": "a: " + "[" * 5000,
    "dashes": "- " * 5000,
}  # fmt: skip


@pytest.mark.parametrize("name", BOMBS)
def test_bombs_end_at_a_limit(name):
    found = []
    work = calls(lambda: found.append(parsed(BOMBS[name])))
    assert "too many values, or is nested too deeply" in str(found[0])
    assert work < 200 * MAXIMUM_VALUES


def test_up_to_the_limits_all_is_read(monkeypatch):
    depth = MAXIMUM_DEPTH - 1
    assert not isinstance(parsed("a: " + "[" * depth + "1" + "]" * depth), FileError)
    assert isinstance(parsed("a: [[" + "[" * depth + "1" + "]" * depth + "]]"), FileError)
    monkeypatch.setattr(strict_yaml, "MAXIMUM_VALUES", 500)
    for count, fits in ((498, True), (499, False), (5_000, False)):
        data = parsed("a: [" + "1," * count + "]")
        assert isinstance(data, FileError) != fits
        assert not fits or len(data["a"]) == count


NUMBERS = ["version: 1", "normalizer: 1", "careful: 1.0", "k: 2.0", "speed: {unit: m/s"]


@settings(max_examples=150)
@given(st.sampled_from(NUMBERS), values)
def test_a_knowledge_base_with_such_a_value_is_valid_or_says_where_it_is_not(
    tmp_path_factory, entry, value
):
    path = tmp_path_factory.getbasetemp() / "scalar.yaml"
    key = entry.partition(":")[0]
    new = f"{entry}, default: {value}" if "unit" in entry else f"{key}: {value}"
    text = KITCHEN.replace("{SEMANTICS}", "{}").replace(entry, new, 1)
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        kb = KnowledgeBase.load(path)
    except InvalidKnowledgeBase as invalid:
        errors = invalid.errors
    else:
        errors = ()
        assert all(math.isfinite(weight.normalizer) for weight in kb.weights.values())
    assert all(error.place.file == str(path) for error in errors)
