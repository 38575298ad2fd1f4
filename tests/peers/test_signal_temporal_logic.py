"""Past-time signal temporal logic: rules over time are as robust as its definition says.

The definition stands here, over the whole history (Maler and Nickovic 2004; Donzé and Maler 2010),
and where the monitor rtamt is installed it is asked as well.
"""

from collections.abc import Callable, Sequence
from math import inf
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfol import Facts, KnowledgeBase, RewardFunction

KB = KnowledgeBase.load(Path(__file__).with_name("signal_temporal_logic.yaml"))
Signals = Sequence[tuple[float, float]]
Robustness = Callable[[Signals, int], float]


def p(signals, t):
    return signals[t][0]


def q(signals, t):
    return signals[t][1]


def negated(a: Robustness) -> Robustness:
    return lambda signals, t: -a(signals, t)


def both(a: Robustness, b: Robustness) -> Robustness:
    return lambda signals, t: min(a(signals, t), b(signals, t))


def either(a: Robustness, b: Robustness) -> Robustness:
    return negated(both(negated(a), negated(b)))


def once(a: Robustness, first: int, last: int) -> Robustness:
    """The greatest of a over the steps from `last` to `first` before."""
    return lambda signals, t: max(
        (a(signals, s) for s in range(max(0, t - last), t - first + 1)), default=-inf
    )


def historically(a: Robustness, first: int, last: int) -> Robustness:
    return negated(once(negated(a), first, last))


def since(a: Robustness, b: Robustness, last: int) -> Robustness:
    return lambda signals, t: max(
        min([b(signals, s), *(a(signals, r) for r in range(s + 1, t + 1))])
        for s in range(max(0, t - last), t + 1)
    )


LONG = 1000  # longer than any signal that is drawn

# The head of a rule: how rtamt writes the specification, and what it is by definition.
SPECIFICATIONS = {
    "lately": ("once[0,4](p)", once(p, 0, 4)),
    "always": ("historically[0,4](p)", historically(p, 0, 4)),
    "before": ("prev(p)", historically(p, 1, 1)),
    "lasting": ("p since q", since(p, q, LONG)),
    "ever": ("once(p)", once(p, 0, LONG)),
    "answered": ("p -> once[0,3](q)", either(negated(p), once(q, 0, 3))),
    "rises": ("p and not(once[1,1](p))", both(p, negated(once(p, 1, 1)))),
    "window": ("once[2,5](p)", once(p, 2, 5)),
    "gap": ("historically[2,5](p)", historically(p, 2, 5)),
    "recently": ("p since[0,3] q", since(p, q, 3)),
    "prompt": (
        "historically[0,3](p -> once[0,2](q))",
        historically(either(negated(p), once(q, 0, 2)), 0, 3),
    ),
    "either": (
        "(p and not q) or (q and not p)",
        either(both(p, negated(q)), both(q, negated(p))),
    ),
}

levels = st.floats(-0.5, 0.5).map(lambda level: round(level, 3))
some_signals = st.lists(st.tuples(levels, levels), min_size=1, max_size=20)


def confidences(signals):
    """Return what the rules conclude at each step: the confidence of every specification."""
    episode = RewardFunction(KB).episode()
    for p_level, q_level in signals:
        facts = Facts()
        facts.add("P", "ego", confidence=p_level + 0.5)
        facts.add("Q", "ego", confidence=q_level + 0.5)
        yield episode.step(facts).confidences


def as_confidence(robustness):
    """Return c for the robustness c − 1/2; no step at all is infinite, and certain."""
    return min(max(robustness + 0.5, 0.0), 1.0)


def assert_as_robust(robustness, signals):
    """Check the rules against a robustness of (name, t)."""
    for t, found in enumerate(confidences(signals)):
        for name in SPECIFICATIONS:
            expected = as_confidence(robustness(name, t))
            assert found[name] == pytest.approx(expected, abs=1e-9), (name, t)


@given(some_signals)
def test_rules_are_as_robust_as_the_definition_says(signals):
    assert_as_robust(lambda name, t: SPECIFICATIONS[name][1](signals, t), signals)


def test_an_example_by_hand():
    signals = [(0.5, -0.5), (0.25, 0.25), (-0.25, -0.5), (0.5, -0.5)]
    found = [step["answered"] - 0.5 for step in confidences(signals)]
    # p at once and no q yet; q answers; p is no more; q was there two steps ago.
    assert found == pytest.approx([-0.5, 0.25, 0.25, 0.25])


@given(some_signals)
def test_held_is_historically_once_its_duration_has_passed(signals):
    for t, found in enumerate(confidences(signals)):
        assert found["steady"] == (0 if t < 4 else pytest.approx(found["always"]))


def monitored(text, signals):
    rtamt = pytest.importorskip("rtamt", reason="the monitor rtamt is not installed")
    monitor = rtamt.StlDiscreteTimeSpecification()
    for name in ("p", "q", "out"):
        monitor.declare_var(name, "float")
    monitor.spec = f"out = {text}"
    monitor.parse()
    return [monitor.update(t, [("p", a), ("q", b)]) for t, (a, b) in enumerate(signals)]


@given(some_signals)
def test_rtamt_agrees(signals):
    answers = {name: monitored(text, signals) for name, (text, _) in SPECIFICATIONS.items()}
    assert_as_robust(lambda name, t: answers[name][t], signals)
