"""Any Gymnasium environment, rewarded by rules."""

import numpy as np
import pytest

import sfol

gymnasium = pytest.importorskip("gymnasium")
check_env = pytest.importorskip("gymnasium.utils.env_checker").check_env

from sfol.wrappers import RuleReward, Transition  # noqa: E402 (it needs gymnasium)

SEEN: list[Transition] = []


def facts_of(observation, info, env):
    facts = sfol.Facts()
    facts.add("Upright", "pole", confidence=max(1.0 - abs(float(observation[2])) / 0.2095, 0.0))
    return facts


def signals_of(transition):
    SEEN.append(transition)
    return {"speed": float(transition.observation[1])}


@pytest.fixture
def cartpole():
    SEEN.clear()
    reward = sfol.RewardFunction("cartpole")
    env = gymnasium.make("CartPole-v1")
    yield RuleReward(env, reward, facts=facts_of, signals=signals_of), reward
    env.close()


def test_a_step_is_rewarded_by_the_facts_before_it(cartpole):
    env, reward = cartpole
    before, _ = env.reset(seed=3)
    for _ in range(5):
        after, value, _, _, info = env.step(1)
        outcome = reward.evaluate(facts_of(before, {}, env), speed=float(before[1]))
        assert value == outcome.reward
        assert {k: info[f"reward_{k}"] for k in outcome.terms} == outcome.terms
        assert {k: info[f"weight_{k}"] for k in outcome.weights} == outcome.weights
        assert {k: info[f"confidence_{k}"] for k in outcome.confidences} == outcome.confidences
        assert info["original_reward"] == 1.0
        assert (SEEN[-1].observation == before).all()
        assert (SEEN[-1].next_observation == after).all()
        before = after


def test_it_is_an_environment(cartpole):
    check_env(cartpole[0], skip_render_check=True)


def test_observations_actions_and_endings_are_the_environments(cartpole):
    env, _ = cartpole
    plain = gymnasium.make("CartPole-v1")
    first, _ = env.reset(seed=1)
    other, _ = plain.reset(seed=1)
    done = False
    while not done:
        assert np.array_equal(first, other)
        first, _, done, _, _ = env.step(0)
        other, _, plain_done, _, _ = plain.step(0)
        assert done == plain_done


def test_a_missing_signal_is_named(cartpole, tmp_path):
    path = tmp_path / "mute.yaml"
    path.write_text("version: 1\nname: mute\nextends: cartpole\nsignals: {speed: {from: null}}\n")
    reward = sfol.RewardFunction(path)
    env = RuleReward(cartpole[0].env, reward, facts=facts_of, signals=lambda _: {})
    env.reset(seed=0)
    with pytest.raises(sfol.errors.SignalError, match="speed"):
        env.step(0)


class OneArray(gymnasium.Env):
    """An environment that gives the same array at every step, changed in place."""

    observation_space = gymnasium.spaces.Box(-100, 100, (2,))
    action_space = gymnasium.spaces.Discrete(2)

    def __init__(self):
        self.state = np.zeros(2, dtype=np.float32)

    def reset(self, *, seed=None, options=None):
        self.state[:] = 0
        return self.state, {}

    def step(self, action):
        self.state += 1
        return self.state, 0.0, False, False, {}


def test_the_observation_before_stays_what_it_was():
    reward = sfol.RewardFunction("cartpole")
    seen = []

    def signals(transition):
        seen.append((transition.observation.tolist(), transition.next_observation.tolist()))
        return {"speed": 0.0}

    env = RuleReward(OneArray(), reward, facts=lambda *_: sfol.Facts(), signals=signals)
    env.reset()
    env.step(0)
    env.step(0)
    assert seen == [([0, 0], [1, 1]), ([1, 1], [2, 2])]


def test_facts_and_signals_are_read_without_functions(cartpole):
    env, reward = RuleReward(cartpole[0].env, cartpole[1]), cartpole[1]
    before, _ = env.reset(seed=3)
    for _ in range(5):
        after, value, _, _, info = env.step(1)
        outcome = reward.transition(before, 1, after)
        assert value == outcome.reward != 0
        assert {k: info[f"reward_{k}"] for k in outcome.terms} == outcome.terms
        before = after
    check_env(RuleReward(gymnasium.make("CartPole-v1"), reward), skip_render_check=True)


@pytest.mark.parametrize(
    ("given", "speed"),
    [
        ({}, 2.0),
        ({"signals": lambda _: {"speed": 7.0}}, 7.0),
        ({"facts": lambda *_: sfol.Facts()}, 2.0),
    ],
)
def test_a_function_may_make_the_facts_or_some_signals(given, speed):
    class Still(OneArray):
        observation_space = gymnasium.spaces.Box(-100, 100, (4,))

        def __init__(self):
            self.state = np.float32([2.4, 2.0, 0.0, 0.0])

        def reset(self, *, seed=None, options=None):
            return self.state, {}

        def step(self, action):
            return self.state, 0.0, False, False, {}

    env = RuleReward(Still(), sfol.RewardFunction("cartpole"), **given)
    env.reset()
    info = env.step(0)[-1]
    leaving = info["confidence_leaving"]
    assert leaving == (0.0 if "facts" in given else 1.0)
    assert info["reward_track"] == pytest.approx(-0.5 * (1 + speed**2) * leaving)


def test_a_file_that_reads_no_facts_needs_a_function(cartpole):
    with pytest.raises(sfol.errors.UsageError, match="'aeb' does not say how facts are read"):
        RuleReward(cartpole[0].env, sfol.RewardFunction("aeb"))


@pytest.mark.parametrize("wrong", ["env", "reward", "facts", "signals"])
def test_an_argument_of_another_type_is_refused_at_once(wrong):
    given = {
        "env": gymnasium.make("CartPole-v1"),
        "reward": sfol.RewardFunction("cartpole"),
        "facts": facts_of,
        "signals": signals_of,
        wrong: 3,
    }
    with pytest.raises(sfol.errors.UsageError, match="of type int"):
        RuleReward(given.pop("env"), given.pop("reward"), **given)
