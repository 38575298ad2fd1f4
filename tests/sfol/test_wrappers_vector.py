"""Many environments at once are rewarded as each of them would be, however they begin anew."""

from functools import partial

import numpy as np
import pytest

import sfol

gymnasium = pytest.importorskip("gymnasium")
from gymnasium.utils.env_checker import data_equivalence  # noqa: E402
from gymnasium.vector import AutoresetMode, SyncVectorEnv  # noqa: E402

from sfol.wrappers import EPISODE, RuleReward, VectorRuleReward  # noqa: E402 (as above)
from tests.sfol.boat import DRIFT, Boat, load  # noqa: E402 (as above)

COUNT, STEPS = 5, 60


@pytest.fixture
def drift(tmp_path):
    return partial(load, tmp_path)


class Alone:
    """Environments one by one, each begun anew when its episode has ended, as a mode says."""

    def __init__(self, envs, autoreset):
        self.envs, self.autoreset = envs, autoreset
        for seed, env in enumerate(envs):
            env.reset(seed=seed)
        self.ended = [False] * len(envs)

    def step(self, actions):
        """Return (reward, info) of each; None where an environment began anew instead."""
        found = []
        for i, (env, action) in enumerate(zip(self.envs, actions, strict=True)):
            if self.ended[i] and self.autoreset is AutoresetMode.NEXT_STEP:
                env.reset()
                self.ended[i] = False
                found.append(None)
                continue
            _, reward, terminated, truncated, info = env.step(int(action))
            self.ended[i] = terminated or truncated
            found.append((reward, info))
            if self.ended[i] and self.autoreset is not AutoresetMode.NEXT_STEP:
                env.reset()
        return found


def compared(make, reward, autoreset, given):
    """Step both, compare everything, and return how many episodes ended."""
    many = SyncVectorEnv([make] * COUNT, copy=False, autoreset_mode=autoreset)
    envs = VectorRuleReward(many, reward, **given)
    alone = Alone([RuleReward(make(), reward, **given) for _ in range(COUNT)], autoreset)
    for wrapped in (envs, *alone.envs):
        wrapped.report_fired()
    envs.reset(seed=list(range(COUNT)))
    chance, episodes = np.random.default_rng(0), 0
    for _ in range(STEPS):
        actions = chance.integers(0, 2, COUNT)
        _, rewards, terminated, truncated, infos = envs.step(actions)
        found = alone.step(actions)
        assert rewards == pytest.approx([0.0 if one is None else one[0] for one in found])
        for i, one in enumerate(found):
            check_info(infos, i, {} if one is None else one[1])
        ended = terminated | truncated
        episodes += ended.sum()
        if autoreset is AutoresetMode.DISABLED and ended.any():
            envs.reset(options={"reset_mask": ended})
    return episodes


def check_info(infos, index, expected):
    """Compare what the rules say of one environment, with masks, and sums in any depth."""
    assert {name for name in ruled(infos) if infos[f"_{name}"][index]} == ruled(expected)
    for name in ruled(expected):
        compare(infos[name], index, expected[name])


def ruled(info):
    own = ("reward_", "weight_", "confidence_", "potential_", "original_reward", "sfol.")
    return {name for name in info if name.startswith(own)}


def compare(values, index, expected):
    if isinstance(expected, dict):
        for name, part in expected.items():
            assert values[f"_{name}"][index]
            compare(values[name], index, part)
    else:
        assert values[index] == pytest.approx(expected)


MODES = [{}, {"mode": "add"}, {"mode": "potential", "potential": "far", "discount": 0.9}]


@pytest.mark.parametrize("given", MODES, ids=str)
@pytest.mark.parametrize("facts_at", ["state", "next"])
@pytest.mark.parametrize("autoreset", AutoresetMode)
def test_each_is_rewarded_by_what_really_happened(drift, autoreset, facts_at, given):
    assert compared(Boat, drift(facts_at), autoreset, given) > 20


@pytest.mark.parametrize("autoreset", AutoresetMode)
def test_the_reward_of_a_state_as_a_potential(drift, autoreset):
    of_steps = ("way:", "push:", "lost:", "late:", "own:", "ending:")
    lines = [line for line in DRIFT.splitlines(True) if line.strip().startswith(of_steps)]
    reward = drift("state", ("1 + push", "1"), *((line, "") for line in lines))
    assert compared(Boat, reward, autoreset, {"mode": "potential", "discount": 0.9}) > 20


@pytest.mark.parametrize("autoreset", AutoresetMode)
def test_cartpole(autoreset):
    def make():
        return gymnasium.make("CartPole-v1")

    assert compared(make, sfol.RewardFunction("cartpole"), autoreset, {}) > 5


def test_an_environment_that_is_vectorised_by_itself_and_one_of_one():
    reward = sfol.RewardFunction("cartpole")
    for count in (1, 3):
        envs = gymnasium.make_vec("CartPole-v1", count, vectorization_mode="vector_entry_point")
        envs = VectorRuleReward(envs, reward)
        before, _ = envs.reset(seed=0)
        after, rewards, *_ = envs.step(np.ones(count, dtype=np.int64))
        steps = zip(before, after, strict=True)
        assert rewards.tolist() == pytest.approx([reward.transition(*p).reward for p in steps])
        envs.close()


@pytest.mark.parametrize("autoreset", AutoresetMode)
def test_a_step_in_which_all_begin_anew(drift, autoreset):
    short = gymnasium.wrappers.TimeLimit
    many = SyncVectorEnv([lambda: short(Boat(), 1)] * 2, autoreset_mode=autoreset)
    envs = VectorRuleReward(many, drift())
    envs.reset(seed=0)
    actions, rewarded = np.zeros(2, dtype=np.int64), []
    for _ in range(4):
        _, rewards, terminated, truncated, infos = envs.step(actions)
        rewarded.append(bool(rewards.all()))
        assert infos["_reward_far"].all() == rewarded[-1]
        if autoreset is AutoresetMode.DISABLED:
            envs.reset(options={"reset_mask": terminated | truncated})
    assert rewarded == [True, autoreset is not AutoresetMode.NEXT_STEP] * 2


def test_what_a_step_returned_may_be_written_to(drift):
    def make():
        return gymnasium.wrappers.TimeLimit(Boat(), 2)

    def written_to(parts):
        for part in parts.values() if isinstance(parts, dict) else parts:
            if isinstance(part, dict):
                written_to(part)
            elif isinstance(part, np.ndarray):
                part[...] = True

    left_alone, written = (VectorRuleReward(SyncVectorEnv([make] * 3), drift()) for _ in range(2))
    for envs in (left_alone, written):
        envs.reset(seed=0)
    actions, ended = np.zeros(3, dtype=np.int64), 0
    for _ in range(9):
        expected, found = (envs.step(actions) for envs in (left_alone, written))
        assert data_equivalence(expected, found)
        infos = found[-1]
        before = infos["reward_far"].copy()
        written_to(found[:2])
        assert infos["reward_far"].tolist() == before.tolist()  # as the rewards were
        written_to(infos)
        ended += EPISODE in infos
    assert ended >= 3


def test_an_episode_that_is_broken_off_leaves_nothing_in_the_sums(drift):
    def make():
        return gymnasium.wrappers.TimeLimit(Boat(), 3)

    many = SyncVectorEnv([make] * 2, autoreset_mode=AutoresetMode.DISABLED)
    envs = VectorRuleReward(many, drift())
    envs.reset(seed=[0, 1])  # with which none is lost before
    actions = np.zeros(2, dtype=np.int64)
    envs.step(actions)
    for begin, steps, ended in (([1, 0], 2, [0, 1]), ([0, 1], 1, [1, 0])):
        envs.reset(options={"reset_mask": np.array(begin, dtype=bool)})
        infos = [envs.step(actions)[-1] for _ in range(steps)][-1]
        assert infos[f"_{EPISODE}"].tolist() == ended
        assert infos[EPISODE]["length"].tolist() == [3 * one for one in ended]


class Mute(SyncVectorEnv):
    """Environments that do not hand on the last observations."""

    def step(self, actions):
        *found, infos = super().step(actions)
        return *found, {key: value for key, value in infos.items() if key != "final_obs"}


def test_last_observations_that_are_not_given_are_asked_for(drift):
    many = Mute([Boat] * 3, autoreset_mode=AutoresetMode.SAME_STEP)
    envs = VectorRuleReward(many, drift())
    envs.reset(seed=0)
    actions = np.zeros(3, dtype=np.int64)
    with pytest.raises(sfol.errors.UsageError, match="give no final_obs"):
        any(envs.step(actions) is None for _ in range(20))


def test_how_they_begin_anew_must_be_known(drift):
    many = SyncVectorEnv([Boat])
    many.metadata = {}
    with pytest.raises(sfol.errors.UsageError, match="begin anew in the mode None"):
        VectorRuleReward(many, drift())


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"envs": Boat()}, "the environments is of type Boat"),
        ({"reward": "drift"}, "the reward is of type str"),
        ({"mode": "both"}, "there is no mode 'both'"),
        ({"mode": "potential", "discount": 0.9}, "the signal 'way' reads 'next'"),
    ],
)
def test_what_does_not_fit_is_refused_when_it_is_made(drift, given, message):
    given = {"envs": SyncVectorEnv([Boat]), "reward": drift(), **given}
    with pytest.raises(sfol.errors.UsageError, match=message):
        VectorRuleReward(given.pop("envs"), given.pop("reward"), **given)


def test_signals_must_be_read(drift):
    with pytest.raises(sfol.errors.UsageError, match="how the signal 'push' is read"):
        VectorRuleReward(SyncVectorEnv([Boat]), drift("state", ("from: action", "description: x")))
    with pytest.raises(sfol.errors.UsageError, match="'aeb' does not say how facts are read"):
        VectorRuleReward(SyncVectorEnv([Boat]), sfol.RewardFunction("aeb"))
