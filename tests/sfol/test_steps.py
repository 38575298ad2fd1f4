"""Signals that read how a step ended, and the environment's own reward of it."""

import numpy as np
import pytest

import sfol
from sfol.testing.cases import run_tests

STEPS = """\
version: 1
name: steps
observation:
  place: {}
signals:
  won: {unit: "1", from: "native * (1 + next.place)"}
  fallen: {unit: "1", from: terminated}
  late: {unit: "1", from: "truncated * (1 - terminated)"}
terms:
  won: {weight: 1, formula: won}
  fallen: {weight: -10, formula: fallen}
  late: {weight: -1, formula: late}
tests:
  - name: a fall
    observation: 0
    next: 1
    native: 0.5
    terminated: true
    truncated: false
    expect: {terms: {won: 1, fallen: -10, late: 0}, reward: -9}
"""


@pytest.fixture
def steps(tmp_path):
    def load(**changes):
        text = STEPS
        for old, new in changes.values():
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "steps.yaml"
        path.write_text(text)
        return sfol.RewardFunction(path)

    return load


def test_a_step_is_what_the_environment_returned(steps):
    outcome = steps().transition(0, None, 1, 0.5, True, False)
    assert outcome.terms == {"won": 1.0, "fallen": -10.0, "late": 0.0}
    assert steps().transition(0, None, 1, 0.5, False, True).reward == 0.0


def test_many_steps_are_as_each_of_them(steps):
    places, after = np.array([0.0, 1.0, 2.0]), np.array([1.0, 2.0, 3.0])
    native, terminated = np.array([0.5, -1.0, 2.0]), np.array([True, False, False])
    truncated = np.array([True, True, False])
    columns = (places, np.zeros(3), after, native, terminated, truncated)
    expected = [steps().transition(*step).reward for step in zip(*columns, strict=True)]
    assert steps().transition(*columns).reward.tolist() == expected
    torch = pytest.importorskip("torch")
    tensors = [torch.from_numpy(column) for column in columns]
    assert steps().transition(*tensors).reward.tolist() == expected


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((0, None, 1), "the environment's own reward is not given .give what env.step returned"),
        ((0, None, 1, 0.5), "whether the step terminated the episode is not given"),
        ((0, None, 1, 0.5, False), "whether the episode was truncated is not given"),
        ((0, None, 1, "much", False, False), "'native' is 'much'"),
        ((0, None, 1, float("nan"), False, False), "native is NaN"),
        ((0, None, 1, [1.0, 2.0], False, False), "'place' has the shape \\(\\)"),
    ],
)
def test_what_is_not_given_or_no_number_is_named(steps, given, message):
    with pytest.raises(sfol.errors.SignalError, match=message):
        steps().transition(*given)


def test_many_steps_without_it_are_refused(steps):
    with pytest.raises(sfol.errors.SignalError, match="own reward is not given"):
        steps().transition(np.zeros(2), None, np.zeros(2))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("from: terminated", "from: terminate", "did you mean 'terminated'"),
        ("from: terminated", "from: next.terminated", "'terminated', which is no part"),
        ("from: terminated", "from: terminated.x", "'terminated' has no field 'x'"),
        ("place: {}", "place: {}\n  native: {}", "can't be called 'native'"),
        (
            "signals:",
            "predicates: {Late(X): X is late.}\nfacts: {Late(ego): truncated}\nsignals:",
            "a fact can't read 'truncated'",
        ),
        ("    observation: 0\n    next: 1\n", "", "the test has 'native' without an observation"),
        ("terminated: true", "terminated: 3", "valid boolean"),
    ],
)
def test_errors_of_the_file(steps, old, new, message):
    with pytest.raises(sfol.errors.InvalidKnowledgeBase, match=message):
        steps(change=(old, new))


def test_a_test_of_the_file_gives_them(steps):
    report = run_tests(steps().kb)
    assert report.passed, report
    missing = run_tests(steps(change=("    native: 0.5\n", "")).kb)
    assert "own reward is not given" in missing.results[0].differences[0]
    other = run_tests(steps(change=("terminated: true", "terminated: false")).kb)
    assert not other.passed


def test_an_environment_gives_them(steps):
    gymnasium = pytest.importorskip("gymnasium")
    from sfol.wrappers import RuleReward  # noqa: PLC0415 (it needs gymnasium)

    seen = []
    env = gymnasium.make("FrozenLake-v1", is_slippery=False, max_episode_steps=2)
    env = RuleReward(env, steps(), signals=lambda transition: seen.append(transition) or {})
    for actions, last in (((1, 2), -10.0), ((0, 0), -1.0)):  # into a hole in time; at a wall
        env.reset(seed=0)
        rewards = [env.step(action)[1] for action in actions]
        assert rewards == [0.0, last]
    assert [(t.native, t.terminated, t.truncated) for t in seen[1::2]] == [
        (0, True, True),
        (0, False, True),
    ]
