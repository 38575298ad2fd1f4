"""Schedules: what a file says of numbers that change in a training, and what becomes of it."""

import json
import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

import sfol
from sfol.errors import InvalidKnowledgeBase, UsageError
from sfol.knowledge_base import KnowledgeBase, ScheduledNumber
from sfol.knowledge_base.formatting import format_file
from sfol.knowledge_base.printing import to_yaml
from sfol.knowledge_base.schema import json_schema
from sfol.tools.diff import compare
from sfol.tools.lint import lint, located
from tests.sfol.command_line import sfol as command

RISING = "weights.walk.far"
POND = """\
version: 1
name: pond
subject: duck
predicates:
  Far(X): X is far out.
  Cold(X): X is cold.
rules:
  far: far(X) :- Far(X).
  cold: cold(X) :- Cold(X).
signals:
  v: {unit: m/s}
weights:
  walk: {normalizer: 2, coefficients: {far: 1.0, cold: -1.0}}
terms:
  far: {weight: walk, formula: k * v, parameters: {k: 3}}
schedules:
  weights.walk.far: {from: 0, to: 1, over: 1000}
  terms.far.k: {from: 1.5, to: 3, over: 10, by: episodes}
"""


@pytest.fixture
def pond(tmp_path):
    def load(*changes, name="pond"):
        text = POND
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / f"{name}.yaml"
        path.write_text(text)
        return path

    return load


# -- values -------------------------------------------------------------------------------------

FINITE = st.floats(-1e6, 1e6)


@given(FINITE, FINITE, st.integers(1, 10**9), st.data())
def test_a_number_goes_straight_from_its_start_to_its_end(start, end, over, data):
    number = ScheduledNumber("weights", "walk", "far", start, end, over)
    assert number.value_at(0) == start
    assert number.value_at(over) == number.value_at(10 * over) == end
    done = data.draw(st.integers(0, over))
    exact = start + (end - start) * done / over
    assert number.value_at(done) == pytest.approx(exact, rel=1e-9, abs=1e-6)
    assert min(start, end) - 1e-6 <= number.value_at(done) <= max(start, end) + 1e-6


def test_the_reward_is_that_of_the_numbers_at_the_moment(pond):
    reward = sfol.RewardFunction(pond())
    facts = sfol.Facts.parse("Far(duck): [1, 1].")
    assert reward(facts, v=2.0) == 0.5 * 3 * 2  # nobody is trained
    values = reward.apply_schedules(steps=250, episodes=4)
    assert values == {RISING: 0.25, "terms.far.k": pytest.approx(2.1)}
    assert reward(facts, v=2.0) == pytest.approx(0.125 * 2.1 * 2)
    assert reward.coefficients["walk"] == {"far": 0.25, "cold": -1.0}
    reward.apply_schedules(steps=5000, episodes=10)
    assert reward(facts, v=2.0) == 0.5 * 3 * 2
    reward.apply_schedules(steps=250, episodes=4)  # as before, whatever was between
    assert reward.coefficients["walk"]["far"] == 0.25


def test_only_what_is_counted_is_needed(pond):
    reward = sfol.RewardFunction(pond((", by: episodes", "")))
    assert reward.apply_schedules(steps=10) == {RISING: 0.01, "terms.far.k": 3.0}
    assert sfol.RewardFunction("cartpole").apply_schedules() == {}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"steps": 1}, "the episodes of the training are None"),
        ({"episodes": 1}, "the steps of the training are None"),
        ({"steps": -1, "episodes": 1}, "the steps of the training are -1"),
        ({"steps": 0.5, "episodes": 1}, "the steps of the training are 0.5"),
        ({"steps": 1, "episodes": True}, "the episodes of the training are True"),
    ],
)
def test_what_is_no_count_is_refused(pond, given, message):
    with pytest.raises(UsageError, match=message):
        sfol.RewardFunction(pond()).apply_schedules(**given)


def test_a_reward_that_is_sent_has_its_numbers(pond):
    reward = sfol.RewardFunction(pond())
    reward.apply_schedules(steps=250, episodes=4)
    sent = pickle.loads(pickle.dumps(reward))
    assert sent.coefficients == reward.coefficients
    assert sent.apply_schedules(steps=500, episodes=4)[RISING] == 0.5


# -- the file -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("  weights.walk.far:", "  weights.wlak.far:", "did you mean 'weights.walk.far'?"),
        ("  weights.walk.far:", "  walk.far:", "did you mean 'weights.walk.far'?"),
        ("  weights.walk.far:", "  weights.walk.normalizer:", "is no number that can be scheduled"),
        ("  terms.far.k:", "  terms.far.kk:", "did you mean 'terms.far.k'?"),
        ("from: 0, to: 1", "from: 0, too: 1", "did you mean 'to'?"),
        ("from: 0, ", "", "the key 'from' is missing"),
        ("over: 1000", "over: 0", "greater than or equal to 1"),
        ("over: 1000", "over: 0.5", "schedules.weights.walk.far.over: "),
        ("to: 1,", "to: .inf,", "schedules.weights.walk.far.to: "),
        ("to: 1,", "to: much,", "schedules.weights.walk.far.to: "),
        ("by: episodes", "by: episode", "'steps' or 'episodes'"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(pond, old, new, message):
    with pytest.raises(InvalidKnowledgeBase) as caught:
        KnowledgeBase.load(pond((old, new)))
    (error,) = caught.value.errors
    assert message in str(error)
    assert error.place.line in (17, 18)


def test_an_overlay_changes_and_removes_schedules(pond, tmp_path):
    pond()
    overlay = tmp_path / "deep.yaml"
    overlay.write_text(
        "version: 1\nname: deep\nextends: pond\nremove: {schedules: [terms.far.k]}\n"
        "schedules: {weights.walk.far: {over: 50}}\n"
    )
    (number,) = KnowledgeBase.load(overlay).schedules.values()
    assert number == ScheduledNumber("weights", "walk", "far", 0.0, 1.0, 50)
    overlay.write_text(overlay.read_text().replace("terms.far.k", "terms.far.j"))
    with pytest.raises(InvalidKnowledgeBase, match=r"did you mean 'terms\.far\.k'"):
        KnowledgeBase.load(overlay)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("from: 0", "from: 0.1"),
        ("to: 1,", "to: 2,"),
        ("over: 1000", "over: 1001"),
        (", by: episodes", ""),
        ("  terms.far.k: {from: 1.5, to: 3, over: 10, by: episodes}\n", ""),
    ],
)
def test_hash_and_diff_have_every_part(pond, old, new):
    before, after = KnowledgeBase.load(pond()), KnowledgeBase.load(pond((old, new), name="other"))
    assert before.hash != after.hash
    (change,) = compare(before, after)
    assert change.section == "schedules"


def test_a_schedule_of_a_head_without_rules_means_nothing(pond, tmp_path):
    pond((RISING, "weights.walk.cold"))
    overlay = tmp_path / "warm.yaml"
    overlay.write_text("version: 1\nname: warm\nextends: pond\nremove: {rules: [cold]}\n")
    warm = KnowledgeBase.load(overlay)
    other = tmp_path / "other.yaml"
    other.write_text(overlay.read_text() + "schedules: {weights.walk.cold: {to: 7}}\n")
    assert KnowledgeBase.load(other).hash == warm.hash
    printed = tmp_path / "printed.yaml"
    printed.write_text(to_yaml(warm))
    assert KnowledgeBase.load(printed).hash == warm.hash


def test_they_are_printed_and_shown_and_left_alone_by_fmt(pond, tmp_path):
    path = pond()
    kb = KnowledgeBase.load(path)
    printed = tmp_path / "printed.yaml"
    printed.write_text(to_yaml(kb))
    again = KnowledgeBase.load(printed)
    assert (again.schedules, again.hash) == (kb.schedules, kb.hash)
    assert format_file(path.read_text()) == path.read_text()
    shown = command("show", path).out
    assert "1,000 steps" in shown
    assert "10 episodes" in shown


def test_the_schema_knows_them(pond):
    jsonschema = pytest.importorskip("jsonschema")
    yaml = pytest.importorskip("yaml")
    validator = jsonschema.Draft202012Validator(json.loads(json.dumps(json_schema())))
    assert validator.is_valid(yaml.safe_load(pond().read_text()))
    for old, new in (("over: 1000", "over: 0"), ("from: 0, ", ""), ("by: ", "per: ")):
        assert not validator.is_valid(yaml.safe_load(pond((old, new)).read_text()))


def test_lint_finds_one_that_ends_elsewhere(pond):
    assert "SF021" not in {finding.code for finding in lint(KnowledgeBase.load(pond()))}
    kb = KnowledgeBase.load(pond(("to: 1,", "to: 0.5,")))
    (found,) = (f for f in located(kb, lint(kb)) if f.code == "SF021")
    assert "ends at 0.5" in found.message
    assert found.suggestion == "let it end at 1, or change the number"
    assert found.place.line == 17
