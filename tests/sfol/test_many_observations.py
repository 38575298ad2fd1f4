"""Many scenes as arrays: every one gets what it gets alone."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sfol
from sfol.errors import FactError, SfolError, SignalError, WorkLimitError
from tests.sfol.hall import HALL

SEEDS = st.integers(0, 2**32 - 1)
NEAR = "min(hypot(P.x - robot.x, P.y - robot.y) for P in person)"
CHANGES = {
    # What quantifiers, negation and thresholds add.
    "  careful: careful(X) :- Robot(X), Person(P), Close(P, X), Ahead(P, X).": (
        "  careful: careful(X) :- Robot(X), Person(P), Close(P, X), Ahead(P, X).\n"
        "  free:\n"
        "    rule: free(X) :- Robot(X), Person(P), not Close(P, X), Alone(P).\n"
        "    threshold: 0.25\n"
        "  group: group(P) :- Person(P), Person(Q), Beside(P, Q), P != Q.\n"
        "  crowded2: crowded(X) :- Robot(X), group(P), Close(P, X)."
    ),
    "  Beside(X, Y)": "  Alone(X): X is alone.\n  Beside(X, Y)",
    "facts:\n": (
        "facts:\n"
        "  Alone(P in person): 1 - any(near(hypot(P.x - Q.x, P.y - Q.y), 2, margin=2) for Q in person)\n"
    ),
    "{careful: 1.0}": "{careful: 1.0, free: 0.5}",
    "default: 2.0": f"from: 'min(5, {NEAR})'",
}


@pytest.fixture(scope="module")
def reward(tmp_path_factory):
    return load(tmp_path_factory.mktemp("hall"), {})


def load(folder, changes, semantics=""):
    text = HALL
    for old, new in {**CHANGES, **changes}.items():
        assert old in text, old
        text = text.replace(old, new, 1)
    path = folder / "hall.yaml"
    path.write_text(text + semantics)
    return sfol.RewardFunction(path)


def drawn(seed, size=7, people=4):
    """Return B transitions, as arrays."""
    chance = np.random.default_rng(seed)

    def observation():
        there = chance.random((size, people)) < 0.7
        rows = chance.normal(0, 2, (size, people, 2))
        return {
            "people": np.where(there[..., None], rows, np.nan),
            "mask": there,
            "body": {"state": chance.normal(0, 2, (size, 4))},
            "light": chance.random(size),
        }

    return observation(), chance.normal(0, 1, (size, 1)), observation()


def part(value, scene):
    if isinstance(value, dict):
        return {key: part(inner, scene) for key, inner in value.items()}
    return value[scene]


def mapped(value, make):
    if isinstance(value, dict):
        return {key: mapped(inner, make) for key, inner in value.items()}
    return make(value)


def assert_alike(reward, transitions, outcome, tolerance=1e-9):
    for scene in range(len(outcome.reward)):
        alone = reward.transition(*(part(value, scene) for value in transitions))
        assert float(outcome.reward[scene]) == pytest.approx(alone.reward, abs=tolerance)
        for name, value in alone.terms.items():
            assert float(outcome.terms[name][scene]) == pytest.approx(value, abs=tolerance)
        for name, value in alone.confidences.items():
            assert float(outcome.confidences[name][scene]) == pytest.approx(value, abs=tolerance)
        for head, bound in alone.bounds.items():
            found = outcome.bounds[head]
            assert bool(found.known[scene]) == (bound is not None)
            if bound is not None:
                pair = float(found.lower[scene]), float(found.upper[scene])
                assert pair == pytest.approx(tuple(bound), abs=tolerance)


@settings(max_examples=20)
@given(SEEDS)
def test_numpy(reward, seed):
    transitions = drawn(seed)
    assert_alike(reward, transitions, reward.transition(*transitions))


@settings(max_examples=10)
@given(SEEDS)
def test_torch(reward, seed):
    torch = pytest.importorskip("torch")
    transitions = drawn(seed)
    tensors = [mapped(value, torch.as_tensor) for value in transitions]
    outcome = reward.transition(*tensors)
    assert isinstance(outcome.reward, torch.Tensor)
    assert_alike(reward, transitions, outcome)
    single = [
        mapped(
            value, lambda a: torch.as_tensor(a).float() if a.dtype != bool else torch.as_tensor(a)
        )
        for value in transitions
    ]
    assert reward.transition(*single).reward.dtype == torch.float32


@pytest.mark.parametrize(
    "semantics",
    [
        "semantics: {conjunction: minimum}\n",
        "semantics: {conjunction: product, disjunction: probabilistic_sum}\n",
        "semantics: {conjunction: lukasiewicz, confidence: lower}\n",
        "semantics: {groundings: best, confidence: upper}\n",
    ],
)
def test_every_operator(tmp_path, semantics):
    reward = load(tmp_path, {}, semantics)
    for seed in range(5):
        transitions = drawn(seed)
        assert_alike(reward, transitions, reward.transition(*transitions))


def test_gradients_reach_the_observation(reward):
    torch = pytest.importorskip("torch")
    before, action, after = (mapped(value, torch.as_tensor) for value in drawn(3))
    people = torch.nan_to_num(before["people"]).requires_grad_()
    state = before["body"]["state"].requires_grad_()
    outcome = reward.transition({**before, "people": people}, action, after)
    outcome.reward.sum().backward()
    assert people.grad.isfinite().all()
    assert state.grad.isfinite().all()
    assert people.grad.abs().sum() > 0
    assert (people.grad[~before["mask"]] == 0).all()


def test_a_batch_of_one_and_a_batch_of_nobody(reward):
    transitions = drawn(0, size=1)
    assert_alike(reward, transitions, reward.transition(*transitions))
    transitions = drawn(0, size=3, people=0)
    assert_alike(reward, transitions, reward.transition(*transitions))


def test_nothing_is_known_of_an_entity_without_a_row(tmp_path):
    second = "  second: second(X) :- Robot(X), Person(person2)."
    reward = load(
        tmp_path,
        {
            "rules:\n": f"rules:\n{second}\n",
            "{careful: 1.0, free: 0.5}": "{careful: 1.0, free: 0.5, second: 1.0}",
        },
    )
    for people, known in ((1, False), (2, True)):
        transitions = drawn(0, people=people)
        transitions[0]["mask"][:] = True
        transitions[0]["people"] = np.nan_to_num(transitions[0]["people"])
        outcome = reward.transition(*transitions)
        assert (outcome.bounds["second"].known == known).all()
        assert_alike(reward, transitions, outcome)


@pytest.mark.parametrize("kind", ["numpy", "torch"])
def test_rules_that_fire_for_whichever_entity(tmp_path, kind):
    make = np.asarray if kind == "numpy" else pytest.importorskip("torch").as_tensor
    changes = {
        "  crowded:": "  lonely: lonely(P) :- Person(P), Alone(P) >= 0.5.\n  crowded:",
        "{careful: 1.0, free: 0.5}": "{careful: 1.0, free: 0.5, lonely: 0.0}",
    }
    reward = load(tmp_path, changes)
    seen = dict.fromkeys(reward.kb.rules, 0)
    for seed in range(5):
        before, *_ = drawn(seed)
        fired = reward.fired_of_many(mapped(before, make))
        for scene in range(7):
            alone = reward.conclude(reward.observe(part(before, scene))).fired
            assert {rule for rule, mask in fired.items() if mask[scene]} == alone
            for rule in alone:
                seen[rule] += 1
    assert all(0 < count < 35 for count in seen.values()), seen


def test_no_rule_fires_where_nobody_is(reward):
    fired = reward.fired_of_many(drawn(0, size=3, people=0)[0])
    assert {rule: mask.tolist() for rule, mask in fired.items()} == {
        rule: [False] * 3 for rule in reward.kb.rules
    }


def test_cartpole():
    reward = sfol.RewardFunction("cartpole")
    observations = np.random.default_rng(0).normal(0, 0.1, (50, 4)).astype(np.float32)
    outcome = reward.transition(observations)
    assert outcome.reward.shape == (50,)
    assert_alike(reward, (observations,), outcome)


@pytest.mark.parametrize("kind", ["numpy", "torch"])
def test_the_papers_rules_over_positions(kind):
    make = np.asarray if kind == "numpy" else pytest.importorskip("torch").as_tensor
    chance = np.random.default_rng(0)
    size = 60

    def street():
        return {
            "people": chance.uniform([-5, -8], [40, 6], (size, 10, 2)),
            "people_there": chance.random((size, 10)) < 0.3,
            "vehicles": chance.uniform([-5, -6], [30, 6], (size, 3, 2)),
            "vehicles_there": chance.random((size, 3)) < 0.7,
            "crosswalks": chance.uniform(-5, 50, (size, 1, 1)),
            "crosswalks_there": chance.random((size, 1)) < 0.8,
            "ego": chance.uniform(0, 10, (size, 1)),
        }

    reward = sfol.RewardFunction("aeb_state")
    transitions = street(), None, street()
    outcome = reward.transition(*(v and mapped(v, make) for v in transitions))
    alone = [
        reward.transition(part(transitions[0], i), None, part(transitions[2], i))
        for i in range(size)
    ]
    assert outcome.reward.tolist() == pytest.approx([one.reward for one in alone], abs=1e-9)
    heads = {head for one in alone for head, bound in one.bounds.items() if bound is not None}
    assert heads == {
        "Vehicle",
        *(f"{kind}{n}" for kind in ("safe", "efficiency") for n in (1, 2, 3)),
    }
    for head in heads:
        known = [one.bounds[head] is not None for one in alone]
        assert outcome.bounds[head].known.tolist() == known
        assert head == "Vehicle" or not all(known)


def test_single_numbers_are_of_one_scene_unless_there_are_several(tmp_path):
    path = tmp_path / "height.yaml"
    path.write_text(
        "version: 1\nname: height\nobservation: {h: {key: h}}\n"
        "signals: {height: {unit: m, from: h}}\nterms: {t: {weight: 1, formula: height}}\n"
    )
    reward = sfol.RewardFunction(path)
    for one in (2.0, [2.0], np.array(2.0), np.array([2.0])):
        assert reward.transition({"h": one}).reward == 2.0
    for many in ([2.0, 3.0], np.array([2.0, 3.0]), np.array([[2.0], [3.0]])):
        assert reward.transition({"h": many}).reward.tolist() == [2.0, 3.0]


ROWS = """\
version: 1
name: rows
subject: ego
background: [Vehicle(ego)]
predicates:
  Vehicle(X): X is a vehicle.
  Fast(X): X is fast.
  Close(X, Y): X is close to Y.
rules:
  fast: fast(X) :- Vehicle(X), Fast(X).
  close: close(X) :- Vehicle(X), Close(Y, X).
observation:
  ego: {key: KEY, fields: [x, v]}
  all: {key: ALL, fields: [x, v], present: THERE}
entities:
  car: {from: all, at_most: 3}
facts:
  Fast(ego): above(ego.v, 1, margin=2)
  Close(C in car, ego): below(abs(C.x - ego.x), 0, margin=2)
signals:
  v: {unit: m/s, from: ego.v}
weights:
  w: {normalizer: 1, coefficients: {fast: 1.0, close: -0.5}}
terms:
  t: {weight: w, formula: v}
"""


@pytest.mark.parametrize("kind", ["numpy", "torch"])
def test_an_index_is_of_a_row_and_never_of_a_scene(tmp_path, kind):
    text = ROWS.replace("KEY", "[cars, 1]").replace("ALL", "cars").replace("THERE", "[there, 2]")
    (tmp_path / "rows.yaml").write_text(text)
    reward = sfol.RewardFunction(tmp_path / "rows.yaml")
    chance = np.random.default_rng(0)
    scenes = {
        "cars": chance.normal(0.0, 2.0, (20, 3, 2)),
        "there": (chance.random((20, 4, 3)) < 0.5).astype(float),
    }
    expected = [
        reward.transition({name: part[i] for name, part in scenes.items()}).reward
        for i in range(20)
    ]
    if kind == "torch":
        torch = pytest.importorskip("torch")
        scenes = {name: torch.as_tensor(part) for name, part in scenes.items()}
    for many in (reward.transition(scenes), reward.transitions(scenes)):
        assert np.asarray(many.reward) == pytest.approx(expected, abs=1e-9)
    assert np.ptp(expected) > 0.5


def test_signals_may_be_given(reward):
    before, action, after = drawn(1)
    outcome = reward.transition(before, action, after, limit=np.zeros(7), v=0.0)
    assert (outcome.terms["haste"] == 0).all()
    with pytest.raises(SignalError, match=r"'limit' is ndarray of shape \(3,\)"):
        reward.transition(before, action, after, limit=np.zeros(3))


def test_fields_by_name_and_presence_as_a_field(tmp_path):
    reward = load(
        tmp_path,
        {
            "people: {key: people, fields: [x, y], present: mask}": (
                "people: {key: people, fields: [x, y, there], present: there}"
            ),
            "fields: {x: 0, y: 1, speed: 3}": "fields: [x, y, speed]",
        },
    )
    before, action, after = drawn(2)
    for whole in (before, after):
        state = whole["body"].pop("state")
        whole["body"]["state"] = {"x": state[:, 0], "y": state[:, 1], "speed": state[:, 3]}
        rows = np.nan_to_num(whole.pop("people"))
        whole["people"] = {"x": rows[..., 0], "y": rows[..., 1], "there": whole.pop("mask")}
    outcome = reward.transition(before, action, after)
    assert_alike(reward, (before, action, after), outcome)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"people": np.zeros((7, 4, 3))}, FactError, "'people' has the shape (7, 4, 3)"),
        (
            {"people": np.zeros((7, 5, 2)), "mask": np.ones((7, 5))},
            FactError,
            "'people' has 5 rows",
        ),
        ({"mask": np.ones((7, 3))}, FactError, "'people.present' has the shape (7, 3)"),
        ({"people": np.zeros((6, 4, 2))}, FactError, "different numbers of scenes: [6, 7]"),
        ({"mask": np.ones((7, 4))}, FactError, ".x is NaN in scene"),
        ({"light": np.full(7, math.nan)}, SignalError, "light is NaN in scene 0"),
        ({"light": np.zeros((7, 2))}, SignalError, "'light' has the shape (7, 2)"),
        ({"body": {"state": np.zeros((7, 3))}}, FactError, "'robot' has the shape (7, 3)"),
    ],
)
def test_another_form_is_an_error(reward, change, error, message):
    before, action, after = drawn(0)
    with pytest.raises(error) as caught:
        reward.transition({**before, **change}, action, after)
    assert message in caught.value.message


def test_a_confidence_outside_names_atom_and_scene(tmp_path):
    reward = load(tmp_path, {"Person(P in person): 1.0": "Person(P in person): P.x"})
    with pytest.raises(FactError, match=r"Person\(person\d\) in scene \d: 'P.x' is"):
        reward.transition(*drawn(0))


def test_too_large_an_array_is_refused(tmp_path):
    rule = "  crowded2: crowded(X) :- Robot(X), Beside(P, Q), Beside(Q, R), Beside(R, P).\n"
    reward = sfol.RewardFunction(
        load(
            tmp_path,
            {
                "rules:\n": f"rules:\n{rule}",
                "  crowded2: crowded(X) :- Robot(X), group": "  crowded3: crowded(X) :- Robot(X), group",
            },
        ).kb,
        work_limit=60,
    )
    with pytest.raises(WorkLimitError, match="an array of 64 numbers"):
        reward.transition(*drawn(0))


@pytest.mark.parametrize(
    "value", [None, 3.0, "x", [], {}, np.zeros((7, 4, 2, 2)), [["a"]], np.zeros(0)], ids=str
)
@pytest.mark.parametrize("key", ["people", "mask", "body", "light"])
def test_whatever_is_given_the_error_is_ours(reward, key, value):
    before, action, after = drawn(0)
    with pytest.raises(SfolError):
        reward.transition({**before, key: value}, action, after)
