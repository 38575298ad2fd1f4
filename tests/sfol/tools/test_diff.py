"""`sfol diff`: everything that changed, nothing that did not."""

import json
import os
import subprocess
import tempfile
import time
from dataclasses import replace

import pytest

from sfol import Facts, KnowledgeBase
from sfol.logs import LogWriter, read_log
from sfol.tools.diff import compare, compare_log
from tests.sfol.command_line import RULES, sfol
from tests.sfol.conftest import KITCHEN

BASE = KITCHEN.replace("{SEMANTICS}", "{}")
PE_CS = "version: 1\nname: pe_cs\nextends: aeb\nremove: {rules: [efficiency2, efficiency3]}\n"


def told(before, after):
    return [(change.section, change.name, change.kind) for change in compare(before, after)]


def test_an_ablation_lists_exactly_the_removed_rules(tmp_path):
    path = tmp_path / "pe_cs.yaml"
    path.write_text(PE_CS)
    done = sfol("diff", RULES / "aeb.yaml", path)
    assert done.code == 1
    assert done.out.splitlines() == [
        "rules",
        "  - efficiency2: efficiency2(X) :- Vehicle(X), Crosswalk(A), Approaching(X, A), IsClear(A).",
        "  - efficiency3: efficiency3(X) :- Vehicle(X), Crosswalk(A), IsAt(X, A), IsClear(A).",
    ]
    assert [line[:5] for line in sfol("diff", path, "aeb").out.splitlines()[1:]] == ["  + e"] * 2


@pytest.mark.parametrize("name", ["ce_ps", "pe_cs", "pe_ps"])
def test_the_bundled_ablations_remove_rules_and_nothing_else(name):
    changes = compare(KnowledgeBase.load("aeb"), KnowledgeBase.load(f"ablations/{name}"))
    removed = KnowledgeBase.load(RULES / "ablations" / f"{name}.yaml")
    assert {(c.section, c.kind) for c in changes} == {("rules", "removed")}
    assert {c.name for c in changes} == set(KnowledgeBase.load("aeb").rules) - set(removed.rules)


def test_the_bundled_street_changes_a_distance():
    done = sfol("diff", "aeb", "crossing")
    assert "  ~ segmentation.approaching\n      [50.0, 200.0] → [15.0, 45.0]\n" in done.out


def test_no_difference():
    assert sfol("diff", "aeb", RULES / "aeb.yaml") == (0, "no difference\n", "")


@pytest.mark.parametrize(
    ("old", "new", "section", "name", "kind"),
    [
        ("subject: cook\nbackground: [Person(cook)]", "subject: chef", "subject", "", "changed"),
        ("[Person(cook)]", "[Person(cook), Pot(p)]", "background", "Pot(p)", "added"),
        ("  Lid(X): X has a lid on.\n", "", "predicates", "Lid(X)", "removed"),
        ("X is hot.", "X burns.", "predicates", "Hot(X)", "changed"),
        (", Hot(P)", "", "rules", "care", "changed"),
        ("semantics: {}", "semantics: {conjunction: product}", "semantics", "", "changed"),
        ("{unit: m/s}", "{unit: km/h}", "signals", "speed", "changed"),
        ("{unit: m/s}", "{unit: m/s, default: 0.0}", "signals", "speed", "changed"),
        ("normalizer: 1", "normalizer: 2", "weights", "care", "changed"),
        ("careful: 1.0", "careful: 2.0", "weights", "care", "changed"),
        ("k: 2.0", "k: 2.5", "terms", "haste", "changed"),
        ("-k * speed", "k * speed", "terms", "haste", "changed"),
        ("rules:", "grounding: {margin: 0.1}\nrules:", "grounding", "margin", "changed"),
        ("rules:", "grounding: {camera: {fov: 90}}\nrules:", "grounding", "camera.fov", "added"),
        ("rules:", "entity_weights: [{when: Pot(X), weight: 1.0}]\nrules:", "entity_weights", "Pot(X)", "added"),
    ],
)  # fmt: skip
def test_each_part_is_compared(tmp_path, old, new, section, name, kind):
    assert old in BASE
    for file, text in (("a", BASE), ("b", BASE.replace(old, new))):
        (tmp_path / f"{file}.yaml").write_text(text)
    a, b = KnowledgeBase.load(tmp_path / "a.yaml"), KnowledgeBase.load(tmp_path / "b.yaml")
    assert (section, name, kind) in told(a, b)
    assert len({change.section for change in compare(a, b)}) == (2 if section == "subject" else 1)
    done = sfol("diff", tmp_path / "a.yaml", tmp_path / "b.yaml")
    assert done.code == 1
    assert section in done.out.splitlines()


def test_the_parts_of_a_change_are_told_apart(kitchen):
    changes = {"-k * speed": "-k * speed - j", "k: 2.0": "k: 2.5, j: 1.0"}
    (change,) = compare(kitchen(), kitchen(changes))
    assert change.before == {"formula": "-k * speed", "parameters.k": "2.0"}
    assert change.after == {
        "formula": "-k * speed - j",
        "parameters.k": "2.5",
        "parameters.j": "1.0",
    }


def test_the_order_of_entity_weights_counts():
    aeb = KnowledgeBase.load("aeb")
    turned = replace(aeb, entity_weights=aeb.entity_weights[::-1])
    assert told(aeb, turned) == [("entity_weights", "order", "changed")]
    assert told(aeb, replace(aeb, entity_weights=aeb.entity_weights[1:]))[0][2] == "removed"


def test_words_are_not_meaning(kitchen):
    assert compare(kitchen(), kitchen({"name: kitchen": "name: other\ndescription: hello"})) == ()


def test_json(tmp_path):
    (tmp_path / "pe_cs.yaml").write_text(PE_CS)
    done = sfol("diff", "aeb", tmp_path / "pe_cs.yaml", "--json")
    assert [change["name"] for change in json.loads(done.out)["changes"]] == [
        "efficiency2",
        "efficiency3",
    ]
    assert json.loads(sfol("diff", "aeb", "aeb", "--json").out) == {"changes": []}


# -- recorded episodes ----------------------------------------------------------------------------


@pytest.fixture
def drives(tmp_path):
    """A log of two episodes: at a clear crosswalk, and near a pedestrian."""
    path = tmp_path / "drives.parquet"
    clear = Facts.parse("Crosswalk(a). IsAt(ego, a). IsClear(a).")
    near = Facts.parse("Pedestrian(p). OnRoad(p). CenterOf(p, ego).")
    with LogWriter(path, KnowledgeBase.load("aeb")) as log:
        for facts, speed in ((clear, 2.0), (clear, 6.0), (near, 4.0)):
            log.step(facts, speed, v=speed, v_next=speed, d=9.0)
        log.end_episode("success")
        log.step(near, 0.0, v=1.0, v_next=1.0, d=5.0)
        log.end_episode("timeout")
    return path


def test_what_moves_on_recorded_episodes(tmp_path, drives):
    (tmp_path / "pe_cs.yaml").write_text(PE_CS)
    before, after = KnowledgeBase.load("aeb"), KnowledgeBase.load(tmp_path / "pe_cs.yaml")
    found = compare_log(read_log(drives), before, after)
    assert [(m.episode, m.step) for m in found.moved] == [(0, 1), (0, 0)]
    assert found.moved[0].moves["reward"] == (1.0, 0.0)
    assert found.moved[0].moves["confidence efficiency3"] == (1.0, 0.0)
    assert found.movements["term efficiency"] == (2, -1.0)
    assert [e.value for e in found.before] != [e.value for e in found.after]
    assert compare_log(read_log(drives), before, before).moved == ()


def test_the_report_on_a_log(tmp_path, drives):
    (tmp_path / "pe_cs.yaml").write_text(PE_CS)
    done = sfol("diff", "aeb", tmp_path / "pe_cs.yaml", "--log", drives, "--top", 1)
    assert done.code == 1
    assert "2 of 4 steps moved in 2 episodes" in done.out
    assert "The worst step before: episode 0, step 1, under 'aeb'" in done.out
    assert "rule efficiency3 with X = ego, A = a" in done.out
    assert "confidence efficiency3 1 → 0" in done.out
    data = json.loads(sfol("diff", "aeb", tmp_path / "pe_cs.yaml", "--log", drives, "--json").out)
    assert data["log"]["steps"] == 4
    assert "0 of 4 steps moved" in sfol("diff", "aeb", "aeb", "--log", drives).out


def test_a_log_that_lacks_a_signal(tmp_path, drives):
    path = tmp_path / "more.yaml"
    path.write_text("version: 1\nname: more\nextends: aeb\nsignals: {t: {unit: s}}\n")
    done = sfol("diff", "aeb", path, "--log", drives)
    assert done.code == 2
    assert "episode 0, step 0 under 'more': the signal 't' is missing" in done.err


# -- the last commit ------------------------------------------------------------------------------


@pytest.fixture
def repository(tmp_path):
    def git(*arguments):
        who = ("-c", "user.name=x", "-c", "user.email=x@example.org")
        subprocess.run(["git", *who, *arguments], cwd=tmp_path, check=True, capture_output=True)

    (tmp_path / "kitchen.yaml").write_text(BASE)
    (tmp_path / "overlay.yaml").write_text("version: 1\nname: overlay\nextends: kitchen\n")
    git("init")
    git("add", ".")
    git("commit", "-m", "first")
    return tmp_path


def test_one_file_is_compared_with_its_last_commit(repository):
    path = repository / "kitchen.yaml"
    assert sfol("diff", path).code == 0
    path.write_text(BASE.replace("k: 2.0", "k: 3.0"))
    done = sfol("diff", path)
    assert done.code == 1
    assert "parameters.k: 2.0 → 3.0" in done.out
    assert "parameters.k: 2.0 → 3.0" in sfol("diff", repository / "overlay.yaml").out


def test_without_a_commit_the_error_is_clear(repository, tmp_path_factory):
    (repository / "new.yaml").write_text(BASE)
    assert (
        "'%s' is not in the last commit" % (repository / "new.yaml")
        in sfol("diff", repository / "new.yaml").err
    )
    outside = tmp_path_factory.mktemp("outside") / "x.yaml"
    outside.write_text(BASE)
    done = sfol("diff", outside)
    assert done.code == 2
    assert "not a git repository" in done.err
    assert "name two knowledge bases" in done.err
    assert "has no last commit" in sfol("diff", "aeb").err


@pytest.mark.parametrize("name", ["../../planted.yaml", "../planted.yaml", "/{}/planted.yaml", "..\\x.yaml", "\xff.yaml"])  # fmt: skip
def test_a_commit_writes_nowhere_but_in_its_temporary_folder(repository, name, monkeypatch):
    """A tree that no git would make: its entries are paths that lead elsewhere."""

    def git(*arguments, content=b""):
        command = ["git", "-c", "user.name=x", "-c", "user.email=x@example.org", *arguments]
        done = subprocess.run(
            command, cwd=repository, input=content, capture_output=True, check=True
        )
        return done.stdout.decode().strip()

    temporary = repository / "a" / "b"
    temporary.mkdir(parents=True)
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    blob = bytes.fromhex(git("hash-object", "-w", "--stdin", content=b"planted"))
    kitchen = bytes.fromhex(git("rev-parse", "HEAD:kitchen.yaml"))
    path = name.format(str(temporary).strip("/")).encode("latin-1")
    entries = [(path, blob), (b"kitchen.yaml", kitchen)]
    tree = b"".join(b"100644 " + file + b"\0" + digest for file, digest in sorted(entries))
    made = git("hash-object", "-t", "tree", "-w", "--literally", "--stdin", content=tree)
    git("update-ref", "HEAD", git("commit-tree", made, "-m", "hostile"))
    assert sfol("diff", repository / "kitchen.yaml") == (0, "no difference\n", "")
    assert not [*repository.rglob("*planted*")]
    assert os.listdir(temporary) == []


def test_a_link_to_a_file_is_compared_with_the_files_last_commit(repository, tmp_path_factory):
    link = tmp_path_factory.mktemp("elsewhere") / "link.yaml"
    link.symlink_to(repository / "kitchen.yaml")
    assert sfol("diff", link).code == 0


def test_watch_compares_again_at_every_save(tmp_path, monkeypatch):
    path = tmp_path / "kitchen.yaml"
    path.write_text(BASE)
    (tmp_path / "base.yaml").write_text(BASE)
    saves = iter([BASE.replace("k: 2.0", "k: 3.0"), BASE.replace("Hot(P)", "Hto(P)"), None])

    def save(seconds):
        text = next(saves)
        if text is None:
            raise KeyboardInterrupt
        path.write_text(text)

    monkeypatch.setattr(time, "sleep", save)
    done = sfol("diff", tmp_path / "base.yaml", path, "--watch")
    assert done.code == 0
    assert done.out.splitlines()[0] == "no difference"
    assert "parameters.k: 2.0 → 3.0" in done.out
    assert "did you mean 'Hot'?" in done.err
