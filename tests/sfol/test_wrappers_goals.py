"""Environments with goals: a goal that is replaced afterwards is paid by the rules, too."""

import numpy as np
import pytest

import sfol
from sfol.errors import UsageError

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.spaces import Box, Dict  # noqa: E402 (it needs gymnasium)

from sfol.wrappers import (  # noqa: E402 (it needs gymnasium)
    RuleReward,
    Transition,
    VectorRuleReward,
)

REACH = """\
version: 1
name: reach
description: Be where one should be.
subject: hand
background: [Hand(hand)]
predicates:
  Hand(X): X is a hand.
  At(X, Y): X is at the place Y.
rules:
  there: there(X) :- Hand(X), At(X, goal).
semantics: {conjunction: minimum}
grounding: {margin: 0}
observation:
  hand: {key: achieved_goal, fields: [x, y]}
  goal: {key: desired_goal, fields: [x, y]}
facts_at: next
facts:
  At(hand, goal): below(hypot(hand.x - goal.x, hand.y - goal.y), 0.1, margin=1, value_at_margin=0)
weights:
  there: {normalizer: 1, coefficients: {there: 1.0}}
terms:
  there: {weight: there, formula: 3}
  time: {weight: 1, formula: -1}
"""
# It also reads what goals do not say: the hand before a step, the action, and how the step ended.
CAREFUL = (
    REACH.replace(
        "weights:\n",
        """\
signals:
  closer:
    unit: m
    from: hypot(hand.x - goal.x, hand.y - goal.y)
      - hypot(next.hand.x - next.goal.x, next.hand.y - next.goal.y)
  effort: {unit: m, from: "action.dx**2 + action.dy**2"}
  over: {unit: "1", from: terminated}
  own: {unit: "1", from: native}
weights:
""",
    ).replace("observation:\n", "observation:\n  action: {fields: [dx, dy]}\n")
    + """\
  work: {weight: 1, formula: closer - effort + 5 * over + 0.5 * own}
"""
)


class Plane(gymnasium.Env):
    """A point that moves to a place; its own reward is −1 or 0, and it uses its arrays again."""

    observation_space = Dict(
        {
            name: Box(-5, 5, (2,), np.float64)
            for name in ("observation", "achieved_goal", "desired_goal")
        }
    )
    action_space = Box(-1, 1, (2,), np.float32)

    def __init__(self):
        self.place, self.goal = np.zeros(2), np.zeros(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.time = 0
        self.place[:] = 0.0
        self.goal[:] = self.np_random.uniform(-1, 1, 2)
        return self.observed(), {}

    def step(self, action):
        self.time += 1
        self.place += 0.3 * np.asarray(action, dtype=np.float64)
        observation = self.observed()
        reward = float(self.compute_reward(self.place, self.goal, {}))
        return observation, reward, reward == 0.0, self.time >= 10, {}

    def observed(self):
        return {
            "observation": self.place,
            "achieved_goal": self.place,
            "desired_goal": self.goal,
        }

    @staticmethod
    def compute_reward(achieved, desired, info):
        return -(np.linalg.norm(achieved - desired, axis=-1) > 0.2).astype(np.float64)


class Copying(Plane):
    """As stable-baselines3 expects, which keeps the last observation of an episode as it is."""

    def observed(self):
        return {name: part.copy() for name, part in super().observed().items()}


@pytest.fixture
def load(tmp_path):
    def loaded(text):
        path = tmp_path / "rules.yaml"
        path.write_text(text)
        return sfol.RewardFunction(path)

    return loaded


def reaching(achieved, desired):
    """Return the reward of REACH, written by hand."""
    distance = np.hypot(*(achieved - desired).T)
    return 3 * np.clip(1 - np.maximum(distance - 0.1, 0.0), 0.0, 1.0) - 1


def working(before, action, achieved, desired, terminated):
    """Return the reward of CAREFUL, written by hand."""
    closer = np.hypot(*(before - desired).T) - np.hypot(*(achieved - desired).T)
    effort = (np.asarray(action, dtype=np.float64) ** 2).sum(-1)
    own = Plane.compute_reward(achieved, desired, {})
    return reaching(achieved, desired) + closer - effort + 5.0 * terminated + 0.5 * own


def drive(env, seed, steps=40):
    """Yield transitions, copied, with the rewards."""
    chance = np.random.default_rng(seed)
    before, _ = env.reset(seed=seed)
    before = {name: part.copy() for name, part in before.items()}
    for _ in range(steps):
        action = chance.uniform(-1, 1, 2).astype(np.float32)
        after, value, terminated, truncated, info = env.step(action)
        after = {name: part.copy() for name, part in after.items()}
        yield before, action, after, value, terminated, info
        if terminated or truncated:
            after = {name: part.copy() for name, part in env.reset()[0].items()}
        before = after


def test_a_goal_that_is_replaced_is_paid_by_the_rules(load):
    env = RuleReward(Plane(), load(REACH))
    others = np.random.default_rng(1).uniform(-1, 1, (40, 2))
    for (_, _, after, value, _, info), other in zip(drive(env, 0), others, strict=True):
        achieved = after["achieved_goal"]
        assert env.compute_reward(achieved, after["desired_goal"], info) == value
        assert value == pytest.approx(reaching(achieved, after["desired_goal"]), abs=1e-12)
        given = env.compute_reward(achieved, other, {})
        assert given == pytest.approx(reaching(achieved, other), abs=1e-12)
        assert "sfol.transition" not in info
    assert env.compute_reward(others, others[::-1], [{}] * 40) == pytest.approx(
        reaching(others, others[::-1]), abs=1e-12
    )


@pytest.mark.parametrize("mode", ["replace", "add"])
def test_what_goals_do_not_say_is_in_info(load, mode):
    env = RuleReward(Plane(), load(CAREFUL), mode=mode)
    others = np.random.default_rng(1).uniform(-1, 1, (40, 2))
    expected, infos, places = [], [], []
    for (before, action, after, value, terminated, info), other in zip(
        drive(env, 0), others, strict=True
    ):
        achieved, start = after["achieved_goal"], before["achieved_goal"]
        own = {"replace": 0.0, "add": Plane.compute_reward(achieved, other, {})}[mode]
        expected.append(own + working(start, action, achieved, other, terminated))
        assert env.compute_reward(achieved, after["desired_goal"], info) == value
        given = env.compute_reward(achieved, other, info)
        assert given == pytest.approx(expected[-1], abs=1e-12)
        infos.append(info)
        places.append(achieved)
        assert isinstance(info["sfol.transition"], Transition)
    rewards = env.compute_reward(np.array(places), others, np.array(infos))
    assert rewards.dtype == np.float64
    assert env.compute_reward(others[:0], others[:0], np.array([])).shape == (0,)
    assert rewards == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("potential", [None, "there"])
def test_a_potential_is_of_the_goal_that_replaces(load, potential):
    env = RuleReward(Plane(), load(REACH), mode="potential", potential=potential, discount=0.9)

    def phi(place, goal):
        return reaching(place, goal) if potential is None else (reaching(place, goal) + 1) / 3

    expected, infos, places, goals = [], [], [], []
    for before, _, after, value, terminated, info in drive(env, 2):
        achieved, start = after["achieved_goal"], before["achieved_goal"]
        goal = -achieved
        assert env.compute_reward(achieved, after["desired_goal"], info) == pytest.approx(
            value, abs=1e-12
        )
        own = Plane.compute_reward(achieved, goal, {})
        expected.append(own + 0.9 * (not terminated) * phi(achieved, goal) - phi(start, goal))
        assert env.compute_reward(achieved, goal, info) == pytest.approx(expected[-1], abs=1e-12)
        infos.append(info)
        places.append(achieved)
        goals.append(goal)
    rewards = env.compute_reward(np.array(places), np.array(goals), infos)
    assert rewards == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("text", [REACH, CAREFUL])
def test_all_rewards_that_hindsight_samples_are_the_rules(load, text):
    pytest.importorskip("stable_baselines3", reason="HER is stable-baselines3's")
    from stable_baselines3 import SAC, HerReplayBuffer  # noqa: PLC0415 (few tests need it)

    env = RuleReward(Copying(), load(text))
    keeps = text == CAREFUL
    model = SAC(
        "MultiInputPolicy",
        env,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"copy_info_dict": keeps},
        learning_starts=300,
        seed=0,
    )
    model.learn(200)
    buffer = model.replay_buffer
    np.random.seed(0)
    batch = buffer.sample(64)
    before, after = (
        {name: part.numpy().astype(np.float64) for name, part in parts.items()}
        for parts in (batch.observations, batch.next_observations)
    )
    achieved, desired = after["achieved_goal"], after["desired_goal"]
    given = batch.rewards.numpy()[:, 0]
    if keeps:
        action = batch.actions.numpy()
        # A step within 0.2 m of its own goal ended its episode; hindsight leaves that as it was.
        ended = batch.dones.numpy()[:, 0]
        expected = working(before["achieved_goal"], action, achieved, desired, ended)
    else:
        expected = reaching(achieved, desired)
    assert given == pytest.approx(expected, abs=1e-5)  # the buffer has float32
    goals = {tuple(goal) for goal in buffer.observations["desired_goal"][:200, 0].tolist()}
    replaced = [tuple(goal) not in goals for goal in batch.observations["desired_goal"].tolist()]
    assert sum(replaced) > 40
    assert (abs(given - Plane.compute_reward(achieved, desired, {})) > 0.01).sum() > 60


def test_vectorised_environments_do_not_pay_for_other_goals_themselves(load):
    others = np.zeros(2), np.ones(2), {}
    native = gymnasium.vector.SyncVectorEnv([Plane, Plane])
    assert native.call("compute_reward", *others) == (-1.0, -1.0)
    envs = VectorRuleReward(native, load(REACH))
    with pytest.raises(UsageError, match="know nothing of the rules") as caught:
        envs.call("compute_reward", *others)
    assert "RuleReward" in str(caught.value)
    envs.reset(seed=0)
    assert envs.call("time") == (0, 0)
    ruled = gymnasium.vector.SyncVectorEnv([lambda: RuleReward(Plane(), load(REACH))])
    assert ruled.call("compute_reward", *others) == (pytest.approx(reaching(*others[:2])),)


def test_stable_baselines3_accepts_it(load):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(RuleReward(Copying(), load(REACH)))


def test_what_is_missing_is_said(load):
    env = RuleReward(Plane(), load(CAREFUL))
    with pytest.raises(UsageError, match=r"the reward reads '\w+'.*'sfol.transition'") as caught:
        env.compute_reward(np.zeros(2), np.zeros(2), {})
    assert "copy_info_dict=True" in str(caught.value)
    plain = RuleReward(gymnasium.make("CartPole-v1"), sfol.RewardFunction("cartpole"))
    with pytest.raises(UsageError, match="has no goals"):
        plain.compute_reward(np.zeros(2), np.zeros(2), {})
    made = RuleReward(
        Plane(), load(REACH), facts=lambda observation, info, env: sfol.Facts(margin=0.0)
    )
    with pytest.raises(UsageError, match="made by functions"):
        made.compute_reward(np.zeros(2), np.zeros(2), {})
