"""Batches: the same as scene by scene, in numpy and in torch, with gradients."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfol import Facts, RewardFunction
from sfol.errors import FactError, FormulaError, SignalError, UsageError
from tests.laws.test_laws import REWARDS, facts_of, scenes

torch = pytest.importorskip("torch")

SCENES = [
    Facts.parse(text, margin=0.05)
    for text in (
        "",
        "NoCrosswalk(ego). EmptyLane(ego).",
        "Pedestrian(p1): [0.5, 0.7]. OnRoad(p1): [0.8, 0.9]. CenterOf(p1, ego). Pedestrian(p2): 0.9."
        "OnRoad(p2). CenterOf(p2, ego). OnCrosswalk(p2): [0.3, 0.6].",
        "Truck(t1): [0.4, 0.6]. Vehicle(t1): [0.5, 0.5]. Crosswalk(a1): 0.8. RightOf(t1, ego)."
        "Occludes(t1, a1). Vehicle(v1): 0.7. CenterOf(v1, ego). Occludes(v1, a1).",
    )
]
V = np.array([1.0, 2.0, 6.0, 4.0])
V_NEXT = np.array([1.5, 2.0, 5.0, 4.5])
D = np.array([math.inf, math.inf, 9.0, 0.0])


def assert_same(reward, scenes, outcome, signals):
    for i, facts in enumerate(scenes):
        single = reward.evaluate(facts, **{name: float(s[i]) for name, s in signals.items()})
        assert float(outcome.reward[i]) == pytest.approx(single.reward, abs=1e-9)
        for kind in ("terms", "weights", "confidences"):
            values = {name: float(x[i]) for name, x in getattr(outcome, kind).items()}
            assert values == pytest.approx(getattr(single, kind), abs=1e-9)
        for head, bound in single.bounds.items():
            found = outcome.bounds[head]
            assert bool(found.known[i]) == (bound is not None)
            if bound is not None:
                pair = float(found.lower[i]), float(found.upper[i])
                assert pair == pytest.approx(bound, abs=1e-9)


@pytest.mark.parametrize("reward", REWARDS.values(), ids=REWARDS)
@settings(max_examples=40)
@given(batch=st.lists(scenes, min_size=1, max_size=4))
def test_a_batch_is_its_scenes_one_by_one(reward, batch):
    facts = [facts_of(scene) for scene in batch]
    signals = {"v": V[: len(batch)], "v_next": V_NEXT[: len(batch)], "d": D[: len(batch)]}
    assert_same(reward, facts, reward.evaluate(reward.batch(facts), **signals), signals)


@pytest.mark.parametrize(
    ("rule", "text"),
    [
        ("Near(P, X), not Lid(P)", "Near(p, cook). Lid(p): [0.1, 0.5]. Near(q, cook). Near(r, cook). Lid(r)."),
        ("Near(P, X), Near(Q, X), P != Q", "Near(p, cook). Near(q, cook): 0.5."),
        ("Hot(stove), Near(P, X)", "Hot(stove): 0.3. Near(p, cook). Near(q, cook): 0.4."),
        ("Near(X, X)", "Near(cook, cook): 0.4. Near(p, cook)."),
        ("Near(P, X), not Lid(P)", "Near(p, cook): [0, 1]. Near(q, cook): [0.2, 1]."),
        ("Near(P, Q), Near(Q, X)", "Near(p, q): 0.7. Near(q, cook): 0.4. Near(r, q): [0, 0]."),
    ],
)  # fmt: skip
@pytest.mark.parametrize("semantics", ["", "groundings: best", "conjunction: product"])
def test_negation_guards_constants_and_paths(kitchen, rule, text, semantics):
    reward = RewardFunction(kitchen({"Person(X), Pot(P), Hot(P), Near(P, X)": rule}, semantics))
    facts = [Facts.parse(text), Facts(), Facts.parse(text + "careful(cook): [0.1, 0.2].")]
    signals = {"speed": np.array([1.0, 2.0, 3.0])}
    assert_same(reward, facts, reward.evaluate(reward.batch(facts), **signals), signals)


def test_derived_atoms_and_thresholds(kitchen):
    kb = kitchen(
        {
            "care: careful(X) :- Person(X), Pot(P), Hot(P), Near(P, X).": "care: {rule: "
            "'careful(X) :- Near(P, X), Pot(P).', threshold: 0.5}\n  boils: Pot(X) :- Hot(X)."
        }
    )
    texts = ("Near(p, cook). Hot(p): 0.9.", "Near(p, cook). Hot(p): 0.49.", "Hot(cook). Pot(p).")
    facts = [Facts.parse(text) for text in texts]
    reward, signals = RewardFunction(kb), {"speed": np.ones(3)}
    outcome = reward.evaluate(reward.batch(facts), **signals)
    assert_same(reward, facts, outcome, signals)
    assert [bool(k) for k in outcome.bounds["careful"].known] == [True, False, False]


def test_a_negation_threshold_of_zero_lets_what_is_certain_pass(kitchen):
    rule = "{rule: 'careful(X) :- Near(P, X), not Lid(P).', negation_threshold: 0.0}"
    kb = kitchen({"careful(X) :- Person(X), Pot(P), Hot(P), Near(P, X).": rule})
    reward, facts = RewardFunction(kb), [Facts.parse("Near(p, cook): 0.4. Lid(p).")]
    outcome = reward.evaluate(reward.batch(facts), speed=np.ones(1))
    assert outcome.bounds["careful"].known.all()
    assert_same(reward, facts, outcome, {"speed": np.ones(1)})


def test_torch_gives_what_numpy_gives():
    reward = RewardFunction("aeb")
    batch = reward.batch(SCENES)
    signals = {"v": torch.tensor(V), "v_next": torch.tensor(V_NEXT), "d": torch.tensor(D)}
    outcome = reward.evaluate(batch, **signals)
    assert isinstance(outcome.reward, torch.Tensor)
    expected = reward.evaluate(batch, v=V, v_next=V_NEXT, d=D)
    assert outcome.reward.numpy() == pytest.approx(expected.reward, abs=1e-12)
    single = {name: signal.to(torch.float32) for name, signal in signals.items()}
    assert reward.evaluate(batch, **single).reward.dtype == torch.float32
    assert_same(reward, SCENES, outcome, signals)


def numerical(function, x, step=1e-6):
    slopes = torch.zeros_like(x)
    for i in range(x.numel()):
        ends = []
        for sign in (1, -1):
            moved = x.detach().clone()
            moved.view(-1)[i] += sign * step
            ends.append(float(function(moved)))
        slopes.view(-1)[i] = (ends[0] - ends[1]) / (2 * step)
    return slopes


@pytest.mark.parametrize("name", REWARDS)
def test_gradients_of_bounds_are_finite_differences(name):
    reward = REWARDS[name]
    batch = reward.batch(SCENES[1:3])
    signals = {"v": V[1:3], "v_next": V_NEXT[1:3], "d": D[1:3]}
    # off the edges, where the functions have no derivative
    lower = torch.tensor(np.linspace(0.31, 0.42, len(batch.lower)), requires_grad=True)
    upper = torch.tensor(np.linspace(0.55, 0.69, len(batch.upper)), requires_grad=True)

    def total(low, up):
        return reward.evaluate(batch.with_bounds(low, up), **signals).reward.sum()

    total(lower, upper).backward()
    expected = numerical(lambda low: total(low, upper.detach()), lower)
    assert torch.allclose(lower.grad, expected, atol=1e-6)
    expected = numerical(lambda up: total(lower.detach(), up), upper)
    assert torch.allclose(upper.grad, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("numbers", "group", "name"),
    [("coefficients", "safety", "safe1"), ("parameters", "safety", "zeta"), ("parameters", "comfort", "xi")],
)  # fmt: skip
def test_gradients_of_coefficients_and_parameters_are_finite_differences(numbers, group, name):
    reward = RewardFunction("aeb")
    batch = reward.batch(SCENES)

    def total(value):
        getattr(reward, numbers)[group][name] = value
        return reward.evaluate(batch, v=V, v_next=V_NEXT, d=D).reward.sum()

    value = torch.tensor(0.7, dtype=torch.float64, requires_grad=True)
    total(value).backward()
    assert value.grad == pytest.approx(float(numerical(total, value)), abs=1e-6)
    assert value.grad != 0


def test_errors_of_batches():
    reward = RewardFunction("aeb")
    batch = reward.batch(SCENES)
    with pytest.raises(UsageError, match="another reward function"):
        RewardFunction("aeb").evaluate(batch, v=V, v_next=V_NEXT)
    with pytest.raises(SignalError, match="'v' is NaN"):
        reward.evaluate(batch, v=np.full(4, np.nan), v_next=V_NEXT)
    with pytest.raises(FactError, match="did you mean 'Pedestrian'"):
        reward.batch([Facts.parse("Pedestrain(p1).")])
    reward.parameters["safety"]["epsilon"] = 0.0
    with pytest.raises(FormulaError, match="'safety' has no value"):
        reward.evaluate(batch, v=V, v_next=V_NEXT, d=D)


def test_an_empty_batch():
    reward = RewardFunction("aeb")
    assert reward.evaluate(reward.batch([]), v=1.0, v_next=1.0).reward.shape == (0,)


def test_a_conclusion_that_is_false_supports_nothing(kitchen):
    kb = kitchen(
        {
            "Near(P, X).": "Near(P, X), warm(P).\n  warm: 'warm(X) :- Pot(X), Hot(X).'",
            "Hot(X): X is hot.": "Hot(X): X is hot.\n  warm(X): X is warm.",
        },
        semantics="conjunction: lukasiewicz",
    )
    reward = RewardFunction(kb)
    for upper, concluded in ((0.4, False), (0.9, True)):  # 0.5 + 0.4 − 1 is no more than 0
        facts = Facts.parse("Near(p, cook).")
        facts.add("Pot", "p", bound=(0.2, 0.5))
        facts.add("Hot", "p", bound=(0.1, upper))
        alone = reward.evaluate(facts, speed=1.0)
        together = reward.evaluate(reward.batch([facts]), speed=1.0)
        assert (alone.bounds["careful"] is not None) == concluded
        assert together.bounds["careful"].known.tolist() == [concluded]
