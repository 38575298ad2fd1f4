"""Version 2 of the format, and how files of version 1 come to it."""

import pytest

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.errors import InvalidKnowledgeBase
from sfol.knowledge_base.migrating import clashing_names, migrated
from sfol.knowledge_base.printing import to_yaml
from tests.sfol.command_line import RULES, sfol

OLD = """\
# What a crossing was like.
version:   1   # the first
name: old
predicates:
  once( X ): X was there before.   # a word that an operator has now
  "held(X, Y)": X holds Y.
  Calm(X): X is calm.
rules:
  # who was there
  greet: once(X):-Calm( X ) .   # itself a head
  rest:
    rule: >-
      rested(X) :- once(X),
      not held(X, once), held(X,Y).
weights:
  w: {normalizer: 1, coefficients: {once: 1.0, rested: 2.0}}   # the head once
terms: {t: {weight: w, formula: "1"}}
schedules: {weights.w.once: {from: 0.0, to: 1.0, over: 10, by: steps}}
entity_weights: [{when: "once(X), Calm(X)", weight: 1.0}]
tests:
  - name: once upon a time
    facts: "Calm(ego): 0.5. held(ego, once)."
    expect: {confidences: {once: 0.5, "rested": 0.0}}
"""
NEW = (
    OLD.replace("version:   1", "version:   2")
    .replace("once( X )", "once_( X )")
    .replace("once(X)", "once_(X)")
    .replace('"held(X, Y)"', '"held_(X, Y)"')
    .replace("held(X, once)", "held_(X, once)")
    .replace("held(X,Y)", "held_(X,Y)")
    .replace("held(ego", "held_(ego")
    .replace("{once:", "{once_:")
    .replace("weights.w.once", "weights.w.once_")
)
PLAIN = """\
version: 1
name: plain   # and simple
predicates: {P(X): "", v(X): ""}
rules:
  a: v(X) :- P(X).
signals: {v: {unit: m/s}}
weights: {w: {normalizer: 1, coefficients: {v: 1}}}
terms: {t: {weight: w, formula: 2 * v}}
"""


def written(folder, text, name="old.yaml"):
    path = folder / name
    path.write_bytes(text.encode())
    return path


def test_predicates_get_other_names_and_all_else_stays():
    clashing = clashing_names(OLD)
    assert clashing == {"once", "held"}
    found = migrated(OLD, clashing)
    assert found.text == NEW
    assert found.changes == (
        "version 1 → 2",
        "the predicate 'held' is called 'held_' from now on",
        "the predicate 'once' is called 'once_' from now on",
    )
    assert migrated(NEW, clashing_names(NEW)) == (NEW, ())


def test_what_was_migrated_means_what_it_said(tmp_path):
    with pytest.raises(
        InvalidKnowledgeBase, match=r"'once' is an operator over time.*sfol migrate"
    ):
        KnowledgeBase.load(written(tmp_path, OLD))
    kb = KnowledgeBase.load(written(tmp_path, NEW))
    assert kb.version == 2
    outcome = RewardFunction(kb).evaluate(Facts.parse("Calm(ego): 0.5. held_(ego, p)."))
    assert outcome.confidences == {"once_": 0.5, "rested": pytest.approx((0.5 + 1 + 1) / 3)}


@pytest.mark.parametrize("name", ["aeb", "crossing", "cartpole", "lunarlander", "highway"])
def test_the_bundled_files_mean_the_same_in_version_2(tmp_path, name):
    text = (RULES / f"{name}.yaml").read_bytes().decode()
    found = migrated(text, clashing_names(text))
    assert found.changes == ("version 1 → 2",)
    assert found.text == text.replace("version: 1", "version: 2")
    for line_break in ("\r\n", "\r"):
        other = text.replace("\n", line_break)
        assert migrated(other, ()).text == found.text.replace("\n", line_break)
    new = KnowledgeBase.load(written(tmp_path, found.text))
    assert new.hash == KnowledgeBase.load(name).hash


def test_operators_over_time_stay_what_they_are():
    text = 'version: 1\nrules:\n  a: "h(X) :- once[2](P(X)), previously(Q(X))."\n'
    assert clashing_names(text) == frozenset()
    assert migrated(text, ()).text == text.replace("version: 1", "version: 2")


def test_a_signal_comes_before_a_head_in_version_1_and_in_version_2_it_must_be_said(tmp_path):
    kb = KnowledgeBase.load(written(tmp_path, PLAIN))
    assert kb.version == 1
    assert RewardFunction(kb).evaluate(Facts.parse("P(ego): 0.5."), v=3.0).reward == 0.5 * 6.0
    again = KnowledgeBase.load(written(tmp_path, to_yaml(kb), "again.yaml"))
    assert (again.version, again.hash) == (1, kb.hash)
    with pytest.raises(InvalidKnowledgeBase, match="'v' is a signal and a head"):
        KnowledgeBase.load(written(tmp_path, PLAIN.replace("version: 1", "version: 2")))


def test_of_a_chain_the_last_file_that_says_a_version_counts(tmp_path):
    written(tmp_path, PLAIN, "plain.yaml")
    over = written(tmp_path, "name: over\nextends: plain\n", "over.yaml")
    assert KnowledgeBase.load(over).version == 1
    with pytest.raises(InvalidKnowledgeBase, match="'v' is a signal and a head"):
        KnowledgeBase.load(written(tmp_path, "version: 2\nname: over\nextends: plain\n"))


def test_a_version_that_there_is_not_is_refused(tmp_path):
    with pytest.raises(InvalidKnowledgeBase, match="version: input should be 1 or 2"):
        KnowledgeBase.load(written(tmp_path, PLAIN.replace("version: 1", "version: 3")))


def test_the_command_writes_whole_files_and_says_what_it_did(tmp_path):
    path = written(tmp_path, OLD)
    over = "version: 1\nname: over\nextends: old\nremove: {predicates: [Calm]}\nrules:\n"
    over += "  greet: once(X) :- held(X, _).\nentity_weights: []\n"
    other = written(tmp_path, over, "over.yaml")
    checked = sfol("migrate", "--check", tmp_path)
    assert checked.code == 1
    assert "old.yaml: would be migrated: version 1 → 2; the predicate 'held'" in checked.out
    assert path.read_bytes().decode() == OLD
    done = sfol("migrate", tmp_path)
    assert (done.code, done.err) == (0, "")
    assert path.read_bytes().decode() == NEW
    assert "greet: once_(X) :- held_(X, _)." in other.read_text()
    again = sfol("migrate", tmp_path)
    assert (again.code, again.out) == (0, "")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["old.yaml", "over.yaml"]


def test_a_file_that_would_not_be_valid_is_not_touched(tmp_path):
    plain = written(tmp_path, PLAIN, "plain.yaml")
    broken = written(tmp_path, "version: 1\nname: [", "broken.yaml")
    fine = written(tmp_path, PLAIN.replace("2 * v", "2"), "fine.yaml")
    done = sfol("migrate", plain, broken, fine)
    assert done.code == 2
    assert f"{plain}:8:" in done.err
    assert "'v' is a signal and a head" in done.err
    assert "broken.yaml" in done.err
    assert plain.read_text() == PLAIN
    assert "version: 2" in fine.read_text()
    assert "migrate takes files" in sfol("migrate", "aeb").err
