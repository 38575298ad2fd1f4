"""What the rules' reward does to the environment's own: replaces it, adds to it, or shapes it."""

import numpy as np
import pytest

import sfol

gymnasium = pytest.importorskip("gymnasium")

from sfol.wrappers import EPISODE, RuleReward  # noqa: E402 (it needs gymnasium)

STATES, ACTIONS, DISCOUNT = 7, 3, 0.9
MAZE = """\
version: 1
name: maze
subject: walker
background: [Walker(walker)]
predicates:
  Walker(X): X walks.
  Far(X): X has come far.
rules:
  far: far(X) :- Walker(X), Far(X).
semantics: {conjunction: minimum}
observation:
  place: {}
facts:
  Far(walker): {formula: place / 6, bounds: exact}
signals:
  off: {unit: "1", from: abs(place - 3)}
weights:
  far: {normalizer: 1, coefficients: {far: 5.0}}
terms:
  far: {weight: far, formula: 1}
  odd: {weight: 3, formula: off}
"""


class Maze(gymnasium.Env):
    """States, and where chosen actions lead at random; the last state is terminal."""

    observation_space = gymnasium.spaces.Discrete(STATES)
    action_space = gymnasium.spaces.Discrete(ACTIONS)

    def __init__(self, seed):
        chance = np.random.default_rng(seed)
        self.following = chance.integers(0, STATES, (STATES, ACTIONS))
        self.native = chance.normal(0.0, 1.0, (STATES, ACTIONS)).round(3)

    def reset(self, *, seed=None, options=None):
        self.state = 0 if options is None else options["state"]
        return self.state, {}

    def step(self, action):
        reward = self.native[self.state, action]
        self.state = int(self.following[self.state, action])
        return self.state, reward, self.state == STATES - 1, False, {}


@pytest.fixture
def maze(tmp_path):
    def load(*changes):
        text = MAZE
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "maze.yaml"
        path.write_text(text)
        return sfol.RewardFunction(path)

    return load


def action_values(env):
    """Return Q* of an environment, by value iteration over the steps that it takes."""
    steps = {}
    for state in range(STATES - 1):
        for action in range(ACTIONS):
            env.reset(options={"state": state})
            following, reward, terminated, *_ = env.step(action)
            steps[state, action] = (following, float(reward), terminated)
    values = np.zeros((STATES, ACTIONS))
    for _ in range(400):
        values = values.copy()
        for (state, action), (following, reward, terminated) in steps.items():
            values[state, action] = reward + DISCOUNT * (not terminated) * values[following].max()
    return values[:-1]


def shaped(maze, potential, seed):
    return RuleReward(Maze(seed), maze(), mode="potential", potential=potential, discount=DISCOUNT)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("potential", [None, "far"])
def test_a_potential_changes_no_optimal_policy(maze, potential, seed):
    plain = action_values(Maze(seed))
    values = action_values(shaped(maze, potential, seed))
    assert (values.argmax(axis=1) == plain.argmax(axis=1)).all()
    assert not np.allclose(values, plain)
    places = np.arange(STATES - 1)
    phi = 5.0 * places / 6 + (3.0 * abs(places - 3) if potential is None else 0.0)
    assert values == pytest.approx(plain - phi[:, None], abs=1e-9)  # Ng, Harada, Russell, eq. 3


def test_a_reward_that_is_added_does_change_optimal_policies(maze):
    changed = [
        (action_values(RuleReward(Maze(seed), maze(), mode="add")).argmax(axis=1)
         != action_values(Maze(seed)).argmax(axis=1)).any()
        for seed in range(5)
    ]  # fmt: skip
    assert any(changed)


@pytest.mark.parametrize("action", range(ACTIONS))
def test_replaced_and_added(maze, action):
    reward = maze()
    expected, native = reward.transition(2).reward, Maze(1).native[2, action]
    for mode, value in (("replace", expected), ("add", expected + native)):
        env = RuleReward(Maze(1), reward, mode=mode)
        env.reset(options={"state": 2})
        _, found, _, _, info = env.step(action)
        assert found == value
        assert info["original_reward"] == native


def test_a_terminal_state_has_no_potential_and_a_truncated_one_does(maze):
    class Corridor(Maze):
        def step(self, action):
            self.state += 1
            return self.state, 0.0, action == 1, action == 2, {}

    env = RuleReward(Corridor(0), maze(), mode="potential", potential="far", discount=DISCOUNT)
    for action, after in ((0, 4), (1, 0), (2, 4)):
        env.reset(options={"state": 3})
        _, value, _, _, info = env.step(action)
        expected = DISCOUNT * 5.0 * after / 6 - 5.0 * 3 / 6
        assert value == info["reward_far"] == pytest.approx(expected)
        assert info["potential_far"] == pytest.approx(5.0 * 4 / 6)


@pytest.mark.parametrize(
    "mode", [{}, {"mode": "add"}, {"mode": "potential", "discount": DISCOUNT}], ids=str
)
def test_an_episode_has_the_sums_of_every_term(maze, mode):
    env = RuleReward(gymnasium.wrappers.TimeLimit(Maze(3), 9), maze(), **mode)
    for length in (9, 4, 9):  # sums begin anew, after an episode that was broken off, too
        env.reset()
        seen = []
        for step in range(length):
            _, value, terminated, truncated, info = env.step(step % ACTIONS)
            seen.append((value, info["original_reward"], info["reward_far"], info["reward_odd"]))
            if terminated or truncated:
                break
            assert EPISODE not in info
        else:
            continue
        sums = info[EPISODE]
        found = (sums["return"], sums["original_return"], *sums["terms"].values())
        assert found == pytest.approx(np.sum(seen, axis=0))
        assert list(sums["terms"]) == ["far", "odd"]
        assert sums["length"] == len(seen)


def test_the_environments_own_keys_stay(maze):
    env = gymnasium.wrappers.RecordEpisodeStatistics(gymnasium.wrappers.TimeLimit(Maze(3), 1))
    env = RuleReward(env, maze(), mode="add")
    env.reset()
    *_, info = env.step(0)
    assert info["episode"]["r"] == info["original_reward"]
    assert info[EPISODE]["return"] == info["original_reward"] + info[EPISODE]["terms"]["far"] + 9.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"mode": "shape"}, "there is no mode 'shape'"),
        ({"mode": 3}, "mode is of type int"),
        ({"discount": 0.9}, "the mode 'replace' has no discount"),
        ({"mode": "add", "potential": "far"}, "the mode 'add' has no potential"),
        ({"mode": "potential"}, "the discount is None .*0.99"),
        ({"mode": "potential", "discount": 1.5}, "the discount is 1.5"),
        ({"mode": "potential", "discount": "0.9"}, "the discount is '0.9'"),
        ({"mode": "potential", "discount": float("nan")}, "the discount is nan"),
        ({"mode": "potential", "discount": 0.9, "potential": 3}, "potential is of type int"),
        (
            {"mode": "potential", "discount": 0.9, "potential": "fra"},
            "no weight 'fra' .did you mean 'far'",
        ),
        (
            {"mode": "potential", "discount": 0.9, "signals": lambda _: {}},
            "a potential has no signals of a transition",
        ),
    ],
)
def test_what_does_not_fit_is_refused_when_it_is_made(maze, given, message):
    with pytest.raises(sfol.errors.UsageError, match=message):
        RuleReward(Maze(0), maze(), **given)


@pytest.mark.parametrize(
    ("signal", "message"),
    [
        ("from: next.place", "the signal 'off' reads 'next'"),
        ("from: place + native", "the signal 'off' reads 'native'"),
        ("description: given", "does not say how the signal 'off' is read"),
    ],
)
def test_a_reward_of_transitions_is_no_potential_but_its_weights_are(maze, signal, message):
    reward = maze(("from: abs(place - 3)", signal))
    shaping = {"mode": "potential", "discount": 0.9}
    with pytest.raises(sfol.errors.UsageError, match=message):
        RuleReward(Maze(0), reward, **shaping)
    env = RuleReward(Maze(0), reward, **shaping, potential="far")
    env.reset()
    assert np.isfinite(env.step(0)[1])


def test_a_signal_that_nobody_gives_is_named_when_it_is_made(maze):
    reward = maze(("from: abs(place - 3)", "description: given"))
    with pytest.raises(sfol.errors.UsageError, match=r"signal 'off' is read .*signals=…"):
        RuleReward(Maze(0), reward)
