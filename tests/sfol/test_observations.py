"""Facts and signals, read off observations as the knowledge base says."""

import copy
import math
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sfol
from sfol.errors import FactError, SignalError, UsageError
from sfol.testing.cases import run_tests, written_out
from tests.sfol.hall import ACTION, HALL, NEXT, OBSERVATION


@pytest.fixture
def hall(tmp_path):
    """Return a function that loads the hall with changes: old text → new text."""

    def load(changes=None, more=""):
        text = HALL
        for old, new in (changes or {}).items():
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "hall.yaml"
        path.write_text(text + more)
        return sfol.RewardFunction(path)

    return load


def observed(**changes):
    return {**copy.deepcopy(OBSERVATION), **changes}


def arrays_of(value, make):
    if isinstance(value, dict):
        return {key: arrays_of(part, make) for key, part in value.items()}
    return make(value)


# -- what is read -------------------------------------------------------------------------------


def test_facts_of_everybody_who_is_there(hall):
    facts = hall().observe(OBSERVATION)
    margin = 0.05
    assert facts.margin == margin
    people = ("person1", "person2", "person3")
    assert {atom.arguments[0] for atom in facts} == set(people)
    assert [facts.bound("Person", name) for name in people] == [(0.95, 1.0)] * 3
    assert facts.bound("Ahead", "person1", "robot") == (1.0, 1.0)  # exact
    assert facts.bound("Close", "person1", "robot") == (0.95, 1.0)
    # 3 m outside of 2 m, of a margin of 4 m: 1 − 0.9 · 3/4, and 5 % of it
    assert facts.bound("Close", "person2", "robot") == pytest.approx((0.30875, 0.34125))
    # 1 m apart, of a margin of 2 m; everybody stands beside themselves
    assert facts.bound("Beside", "person1", "person3") == pytest.approx((0.5225, 0.5775))
    assert facts.bound("Beside", "person3", "person1") == pytest.approx((0.5225, 0.5775))
    assert facts.bound("Beside", "person1", "person1") == (0.95, 1.0)


def test_what_is_less_than_at_least_is_unknown_and_what_is_false_is_known(hall):
    facts = hall().observe(observed(people=[[5.2, 0.0], [-9.0, 0.0]], mask=[1, 1]))
    assert facts.bound("Close", "person1", "robot") is None  # 0.28
    assert facts.bound("Ahead", "person2", "robot") == (0.0, 0.0)


def test_at_least_counts_as_on_paper(hall):
    reward = hall({"at_least: 0.3": "at_least: 0.7", "formula: below": "formula: 0.7 * below"})
    assert reward.observe(observed(people=[[0.0, 0.0]], mask=[1])).bound(
        "Close", "person1", "robot"
    )
    reward = hall({"at_least: 0.3": "at_least: 0.7", "formula: below": "formula: 0.1 * 7 * below"})
    assert reward.observe(observed(people=[[0.0, 0.0]], mask=[1])).bound(
        "Close", "person1", "robot"
    )


def test_signals_before_and_after_the_action(hall):
    signals = hall().observe_signals(OBSERVATION, ACTION, NEXT)
    assert signals == {"v": 3.0, "v_next": 2.0, "push": 0.5, "dark": 0.25}
    given = hall().observe_signals(OBSERVATION, None, NEXT, push=0.1, limit=1.0)
    assert given == {"v": 3.0, "v_next": 2.0, "push": 0.1, "dark": 0.25, "limit": 1.0}


def test_a_transition_is_facts_and_signals(hall):
    reward = hall()
    outcome = reward.transition(OBSERVATION, ACTION, NEXT)
    expected = reward.evaluate(reward.observe(OBSERVATION), v=3.0, v_next=2.0, push=0.5, dark=0.25)
    assert outcome == expected
    assert outcome.terms["comfort"] == -1.5
    assert outcome.terms["haste"] < 0
    other = reward.transition(OBSERVATION, ACTION, NEXT, limit=0.0)
    assert other.terms["haste"] == pytest.approx(outcome.terms["haste"] * 9 / 11)


def test_lists_arrays_and_tensors_are_the_same(hall):
    torch = pytest.importorskip("torch")
    reward = hall()
    outcome = reward.transition(OBSERVATION, ACTION, NEXT)
    makes = [
        np.array,
        lambda value: torch.tensor(value, dtype=torch.float64, requires_grad=True),
        lambda value: tuple(value) if isinstance(value, list) else value,
    ]
    for make in makes:
        given = (arrays_of(part, make) for part in (OBSERVATION, ACTION, NEXT))
        assert reward.transition(*given) == outcome


def test_fields_by_name_in_records_and_tables(hall):
    reward = hall(
        {"key: [body, state], fields: {x: 0, y: 1, speed: 3}": "key: body, fields: [x, y, speed]"}
    )
    named = observed(
        people={"x": np.array([1.0, 5.0, 1.0]), "y": np.array([0.0, 0.0, 1.0]), "z": 7.0},
        mask=[1, 1, 1],
        body={"x": 0.0, "y": 0.0, "speed": 3.0, "more": "?"},
    )
    assert reward.observe(named) == hall().observe(OBSERVATION)


def test_presence_as_a_field_and_tables_side_by_side(hall):
    changes = {
        "people: {key: people, fields: [x, y], present: mask}": (
            "people: {key: people, fields: [there, x], present: there}\n"
            "  heights: {key: [heights, 1]}"
        ),
        "from: people": "from: [people, heights]",
        "P.y": "P",
        "Q.y": "Q",
    }
    given = observed(
        people=[[1, 1.0], [1, 5.0], [1, 1.0], [0, math.nan]],
        heights=("?", [0.0, 0.0, 1.0, math.nan]),
    )
    assert hall(changes).observe(given) == hall().observe(OBSERVATION)


def test_the_whole_observation_may_be_one_vector():
    reward = sfol.RewardFunction("cartpole")
    facts = reward.observe(np.array([1.2, 2.0, 0.0, 0.0], np.float32))
    assert str(facts.bound("Upright", "pole")) == "[1, 1]"
    assert reward.observe_signals([1.2, 2.0, 0.0, 0.0]) == {"speed": 2.0}


def test_nobody_is_there(hall):
    facts = hall().observe(observed(people=np.zeros((0, 2)), mask=np.zeros(0, bool)))
    assert len(facts) == 0


def test_a_signal_may_be_infinite(hall):
    reward = hall({"from: robot.speed": "from: 1 / robot.speed"})
    still = observed(body={"state": [0.0, 0.0, 0.0, 0.0]})
    assert reward.observe_signals(still, ACTION, NEXT)["v"] == math.inf


@given(st.lists(st.tuples(*[st.floats(-9, 9)] * 2), min_size=1, max_size=4), st.randoms())
def test_the_order_of_rows_changes_names_only(tmp_path_factory, people, chance):
    path = tmp_path_factory.mktemp("hall") / "hall.yaml"
    path.write_text(HALL)
    reward = sfol.RewardFunction(path)
    shuffled = chance.sample(people, len(people))

    def outcome(rows):
        return reward.transition(observed(people=rows, mask=[1] * len(rows)), ACTION, NEXT)

    first, second = outcome(people), outcome(shuffled)
    assert first.reward == pytest.approx(second.reward, abs=1e-9)
    assert first.bounds.keys() == second.bounds.keys()


# -- what is wrong ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "message", "suggestion"),
    [
        ({"people": [[1.0, 0.0, 2.0]]}, "'people' has the shape (1, 3)", "(n, 2)"),
        ({"people": [1.0, 0.0]}, "'people' has the shape (2,)", "(n, 2)"),
        ({"people": [[0.0, 0.0]] * 5}, "'people' has 5 rows", "at_most says 4"),
        ({"people": [["a", "b"]]}, "'people' is [['a', 'b']]", "real numbers"),
        ({"people": [[0.0], [0.0, 1.0]]}, "'people' is [[0.0], [0.0, 1.0]]", "real numbers"),
        ({"people": np.array([[1j, 2]])}, "'people' is array", "real numbers"),
        ({"people": {"x": [1.0]}}, "people has no 'y'", "known: x"),
        ({"people": {"x": [1.0], "y": 2.0}}, "different shapes", ""),
        ({"mask": [True]}, "'people.present' has the shape (1,)", "(4,)"),
        ({"mask": [1, 1, 1, math.nan]}, "people.present is NaN", ""),
        ({"mask": [1, 1, 1, 1]}, "person4.x is NaN", ""),
        ({"body": {}}, "the observation has no 'state'", ""),
        ({"body": [1.0]}, "the observation has no 'state'", "it is list"),
        ({"body": {"state": [0.0, 0.0, 99.0]}}, "'robot' has the shape (3,)", "(4 or more,)"),
        ({"body": {"state": {"x": 1.0}}}, "'robot' has the keys x", "key"),
        ({"body": {"state": [math.nan, 0, 0, 0]}}, "robot.x is NaN", ""),
    ],
)
def test_another_form_is_an_error_of_a_fact(hall, changes, message, suggestion):
    with pytest.raises(FactError) as caught:
        hall().observe(observed(**changes))
    assert message in caught.value.message
    assert suggestion in (caught.value.suggestion or "")
    assert caught.value.name


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((OBSERVATION, ACTION, None), "the observation after the action is not given"),
        ((OBSERVATION, None, NEXT), "the action is not given"),
        ((None, ACTION, NEXT), "the observation is not given"),
        ((OBSERVATION, [0.1, 0.2], NEXT), "'action' has the shape (2,)"),
        (({**OBSERVATION, "light": [0.1, 0.2]}, ACTION, NEXT), "'light' has the shape (2,)"),
        (({**OBSERVATION, "light": math.nan}, ACTION, NEXT), "light is NaN"),
        ((OBSERVATION, ACTION, {"bodi": 1}), "the observation after the action has no 'body'"),
        ((np.zeros(3), ACTION, NEXT), "the observation has no 'body'"),
    ],
)
def test_another_form_is_an_error_of_a_signal(hall, given, message):
    with pytest.raises(SignalError) as caught:
        hall().observe_signals(*given)
    assert message in caught.value.message


def test_a_number_that_nothing_reads_may_be_anything(hall):
    state = [0.0, 0.0, math.nan, 3.0]
    assert hall().observe(observed(body={"state": state})) == hall().observe(OBSERVATION)


@pytest.mark.parametrize("formula", ["P.x", "-0.5", "1.0001"])
def test_a_confidence_outside_of_0_and_1_names_the_atom(hall, formula):
    reward = hall({"Person(P in person): 1.0": f"Person(P in person): {formula}"})
    with pytest.raises(FactError, match=r"Person\(person\d\)") as caught:
        reward.observe(OBSERVATION)
    assert "clip" in caught.value.suggestion


def test_a_formula_without_a_value_names_the_atom(hall):
    reward = hall(
        {"Person(P in person): 1.0": "Person(P in person): clip(1 / P.y, 0, 1) + 0 / P.y"}
    )
    with pytest.raises(FactError, match=r"Person\(person1\).*has no value"):
        reward.observe(OBSERVATION)
    reward = hall({"from: robot.speed": "from: robot.x / robot.x"})
    with pytest.raises(SignalError, match="the signal 'v'"):
        reward.observe_signals(OBSERVATION, ACTION, NEXT)


def test_who_does_not_say_how_facts_are_read_is_told():
    with pytest.raises(UsageError, match="'aeb' does not say how facts are read"):
        sfol.RewardFunction("aeb").observe([1.0])


def test_a_signal_that_nobody_gives_is_missing(hall):
    reward = hall({"{unit: m/s, default: 2.0}": "{unit: m/s}"})
    with pytest.raises(SignalError, match="'limit' is missing"):
        reward.transition(OBSERVATION, ACTION, NEXT)


# -- tests in files -----------------------------------------------------------------------------

CASE = """\
tests:
  - name: t
    observation:
      people: [[1, 0], [5, 0]]
      mask: [true, false]
      body: {state: [0, 0, 99, 3]}
      light: 1
    action: [0.5]
    next: {body: {state: [0, 0, 99, 2]}}
    signals: {limit: 0.0}
    expect: {bounds: {careful: [EXPECTED], crowded: null}, terms: {comfort: -1.25}}
"""


def test_a_test_may_observe(hall):
    reward = hall(more=CASE.replace("EXPECTED", "0.975, 1.0"))
    report = run_tests(reward.kb)
    assert report.passed
    assert report.coverage == {"careful": 1, "crowded": 0}
    case = written_out(reward, reward.kb.tests[0])
    assert case.observation is None
    assert sfol.Facts.parse(case.facts) == reward.observe(reward.kb.tests[0].observation)


def test_a_test_that_observes_can_fail(hall):
    report = run_tests(hall(more=CASE.replace("EXPECTED", "0.9, 1.0")).kb)
    assert "bound of careful: expected [0.9, 1]" in report.results[0].differences[0]
    broken = CASE.replace("EXPECTED", "0, 1").replace("light: 1", "light: [1, 2]")
    assert "'light' has the shape" in run_tests(hall(more=broken).kb).results[0].differences[0]


# -- anything at all ----------------------------------------------------------------------------

ANYTHING = [
    *(None, 3, "x", b"1", [], [[]], {}, {"a": 1}, ..., object(), range(3), np.zeros((2, 2, 2))),
    *(
        {"x": [1.0], "y": [2.0]},
        [["a"]],
        [[0.0], [0.0, 1.0]],
        np.array(["a"]),
        np.array(None),
        [None],
        math.nan,
        10**400,
    ),
]
PARTS = ["people", "mask", "body", "light"]


@pytest.mark.parametrize("value", ANYTHING, ids=lambda value: type(value).__name__)
def test_whatever_is_observed_gives_facts_or_an_error_of_ours(hall, value):
    reward = hall()
    for observation in (value, *(observed(**{part: value}) for part in PARTS)):
        for seen in ((observation, ACTION, NEXT), (OBSERVATION, value, NEXT)):
            with suppress(FactError, SignalError):
                assert math.isfinite(reward.transition(*seen).reward)


def test_quantifiers_go_through_everybody_who_is_there(hall):
    near = "min(hypot(P.x - robot.x, P.y - robot.y) for P in person)"
    after = "min(hypot(P.x - next.robot.x, P.y) for P in next.person)"
    changes = {
        "from: robot.speed": f"from: '{near}'",
        "from: next.robot.speed": f"from: '{after}'",
        "Person(P in person): 1.0": "Person(P in person): 1 - any(Q.x > P.x for Q in person)",
    }
    reward = hall(changes)
    later = {**NEXT, "people": [[9.0, 0.0], [4.0, 0.0]], "mask": [1, 0]}
    signals = reward.observe_signals(OBSERVATION, ACTION, later)
    assert (signals["v"], signals["v_next"]) == (1.0, 9.0)
    facts = reward.observe(OBSERVATION)
    found = [facts.bound("Person", f"person{row}") for row in (1, 2, 3, 4)]
    assert found == [(0.0, 0.0), (0.95, 1.0), (0.0, 0.0), None]
    for nobody in (observed(people=[], mask=[]), observed(people=np.zeros((0, 2)), mask=[])):
        assert len(reward.observe(nobody)) == 0
        assert reward.observe_signals(nobody, ACTION, later)["v"] == math.inf
    assert reward.observe_signals(nobody, ACTION, {**later, "mask": [0, 0]})["v_next"] == math.inf


def test_nan_of_whom_a_quantifier_goes_through_is_named(hall):
    reward = hall({"from: robot.speed": "from: sum(P.x for P in person)"})
    with pytest.raises(SignalError, match=r"person4\.x is NaN"):
        reward.observe_signals(observed(mask=[1, 1, 1, 1]), ACTION, NEXT)
