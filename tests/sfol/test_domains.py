"""Knowledge bases of other environments give what rewards written by hand would, to 1e-12.

Each reward is written here once more, in plain numpy and without rules, and compared over random
episodes: step by step as the wrapper gives it, and all steps at once.
"""

import numpy as np
import pytest

import sfol

gymnasium = pytest.importorskip("gymnasium")

from sfol.wrappers import RuleReward  # noqa: E402 (it needs gymnasium)


def falling(excess, margin):
    """Return 1 down to 0 as something is exceeded by up to a margin."""
    return np.clip(1.0 - np.maximum(excess, 0.0) / margin, 0.0, 1.0)


def episodes(env, steps, seed=0, choose=None):
    """Return the transitions of random episodes, and the rewards: lists of equal length."""
    env.action_space.seed(seed)
    chance = np.random.default_rng(seed)
    before, _ = env.reset(seed=seed)
    found = []
    for _ in range(steps):
        action = env.action_space.sample() if choose is None else choose(chance, before)
        after, value, terminated, truncated, info = env.step(action)
        found.append((before, action, after, info["original_reward"], terminated, value))
        before = env.reset()[0] if terminated or truncated else after
    return found


def stacked(parts):
    if isinstance(parts[0], dict):
        return {name: np.stack([part[name] for part in parts]) for name in parts[0]}
    return np.stack(parts)


def check(reward, by_hand, transitions, *, distinct):
    """Compare rewards with those by hand, one by one and all at once."""
    *step, values = (list(column) for column in zip(*transitions, strict=True))
    expected = [by_hand(*(np.asarray(p, np.float64) if not isinstance(p, dict) else p for p in s))
                for s in zip(*step, strict=True)]  # fmt: skip
    assert values == pytest.approx(expected, abs=1e-12, rel=0)
    many = reward.transitions(*map(stacked, step)).reward
    assert many == pytest.approx(expected, abs=1e-12, rel=0)
    assert len({round(value, 6) for value in values}) >= distinct


# -- the environments, and their rewards by hand ------------------------------------------------


def frozenlake(before, action, after, native, terminated):
    return 1.0 * (after == 15) - 0.5 * (after in (5, 7, 11, 12)) - 0.01


def test_frozenlake_is_rewarded_at_its_goal():
    env = gymnasium.make("FrozenLake-v1", is_slippery=False)
    reward = sfol.RewardFunction("frozenlake")
    found = episodes(RuleReward(env, reward), 3_000)
    check(reward, frozenlake, found, distinct=3)
    reached = [value for _, _, _, native, _, value in found if native == 1.0]
    assert reached
    assert set(reached) == {0.99}


def lunarlander(before, action, after, native, terminated):
    x, y, vx, vy, _, _, left, right = before
    x2, y2, vx2, vy2, angle2, _, left2, right2 = after
    closer = np.sqrt(x**2 + y**2) - np.sqrt(x2**2 + y2**2)
    slower = np.sqrt(vx**2 + vy**2) - np.sqrt(vx2**2 + vy2**2)
    low, sinking = falling(y2 - 0.1, 0.5), falling(vy2 + 0.5, 0.4)
    tilted = falling(0.4 - abs(angle2), 0.4)
    still = np.sqrt(vx2**2 + vy2**2) <= 0.05
    landed = bool(left2 and right2 and still and abs(x2) <= 0.2)
    end = (100.0 if landed else -100.0) * terminated
    touch = left2 + right2 - left - right
    care = -(min(low, sinking) + tilted)
    return 100 * (closer + slower) + 30 * touch + care + end - 0.15


def land(chance, seen):
    """Choose an engine so that some flights end well, and some do not."""
    if chance.random() < 0.1:
        return int(chance.integers(4))
    x, y, vx, vy, angle, spin, *legs = seen
    turn = 0.0 if any(legs) else 0.5 * (np.clip(0.5 * x + vx, -0.4, 0.4) - angle) - spin
    lift = -0.5 * vy if any(legs) else 0.5 * (0.55 * abs(x) - y) - 0.5 * vy
    if lift > max(abs(turn), 0.05):
        return 2
    return 3 if turn < -0.05 else 1 if turn > 0.05 else 0


def test_lunarlander():
    pytest.importorskip("Box2D", reason="LunarLander needs it")
    env = gymnasium.make("LunarLander-v3")
    reward = sfol.RewardFunction("lunarlander")
    found = episodes(RuleReward(env, reward), 3_000, choose=land)
    check(reward, lunarlander, found, distinct=1_000)
    ends = {native for _, _, _, native, terminated, _ in found if terminated}
    assert ends == {100, -100}


def doorkey(before, action, after, native, terminated):
    kinds, states = after[:, 0], after[:, 2]
    free = not ((kinds == 4) & (states == 2)).any()
    ready = free or not (kinds == 5).any()
    arrived = not (kinds == 8).any()
    return 1.0 * arrived - 0.01 * (3 - ready - free - arrived)


def test_doorkey():
    minigrid = pytest.importorskip("minigrid")
    gymnasium.register_envs(minigrid)
    plain = gymnasium.make("MiniGrid-DoorKey-5x5-v0")
    grid = minigrid.wrappers.ImgObsWrapper(minigrid.wrappers.FullyObsWrapper(plain))
    env = gymnasium.wrappers.ReshapeObservation(grid, (25, 3))
    reward = sfol.RewardFunction("doorkey")
    found = episodes(RuleReward(env, reward), 6_000)
    check(reward, doorkey, found, distinct=4)
    assert all((value > 0.5) == (native > 0) for _, _, _, native, _, value in found)


def fetch(before, action, after, native, terminated):
    distance = np.sqrt(((after["achieved_goal"] - after["desired_goal"]) ** 2).sum())
    # `below` falls to 0.1 over its margin; where it would be under 0, it is 0.
    nearly = max(1.0 - 0.9 * max(distance - 0.05, 0.0) / 0.2, 0.0)
    return 1.0 * (distance <= 0.05) + 0.2 * nearly - 1.2


@pytest.fixture(params=["FetchReach-v4", "FetchPickAndPlace-v4"])
def robot(request):
    robotics = pytest.importorskip("gymnasium_robotics")
    gymnasium.register_envs(robotics)
    return RuleReward(gymnasium.make(request.param), sfol.RewardFunction("fetch"))


def go(chance, seen):
    """Choose to move towards the goal, more or less."""
    straight = 5 * (seen["desired_goal"] - seen["observation"][:3])
    return np.append(straight + chance.normal(0, 0.3, 3), 1.0).clip(-1, 1).astype(np.float32)


def test_fetch(robot):
    reward = sfol.RewardFunction("fetch")
    found = episodes(robot, 150, choose=go)
    check(reward, fetch, found, distinct=2)  # a block that nobody takes stays where it is


def test_hindsight_pays_the_rules_in_fetch(robot):
    pytest.importorskip("stable_baselines3", reason="HER is stable-baselines3's")
    from stable_baselines3 import SAC, HerReplayBuffer  # noqa: PLC0415

    model = SAC(
        "MultiInputPolicy",
        robot,
        replay_buffer_class=HerReplayBuffer,
        learning_starts=200,
        policy_kwargs={"net_arch": [8]},
        seed=0,
    )
    model.learn(150)
    np.random.seed(0)
    batch = model.replay_buffer.sample(64)
    goals = ("achieved_goal", "desired_goal")
    parts = [batch.next_observations[name].numpy().astype(np.float64) for name in goals]
    expected = [
        fetch(None, None, dict(zip(goals, pair, strict=True)), None, None)
        for pair in zip(*parts, strict=True)
    ]
    assert batch.rewards.numpy()[:, 0] == pytest.approx(expected, abs=1e-5)  # it has float32
    assert (batch.rewards.numpy() > -1.2).sum() > 40  # most goals were replaced by what was near


def highway(before, action, after, native, terminated):
    own = after[0]
    fast = falling(max(30 - 80 * own[3], 80 * own[3] - 40), 10)
    tailgating = 0.0
    for there, x, y, *_ in after[1:]:
        if there and x > 0 and x != own[1] and abs(12 * y) < 2:
            tailgating = max(tailgating, min(fast, falling(200 * x - 15, 15)))
    return fast - 0.5 * tailgating - 5.0 * terminated


def test_highway():
    highway_env = pytest.importorskip("highway_env")
    gymnasium.register_envs(highway_env)
    env = gymnasium.make("highway-fast-v0", config={"vehicles_count": 10})
    reward = sfol.RewardFunction("highway")
    found = episodes(RuleReward(env, reward), 150)
    check(reward, highway, found, distinct=30)
    assert any(terminated for *_, terminated, _ in found)


def spread(after):
    velocity_and_place, rest = after[:4], after[4:].reshape(-1, 2)
    assert velocity_and_place.shape == (4,)
    landmarks, others = rest[:3], rest[3:5]
    near = falling(np.sqrt((landmarks**2).sum(1)) - 0.1, 1.5)
    gaps = np.sqrt(((others[:, None] - landmarks[None]) ** 2).sum(2))
    shared = np.minimum(near, falling(gaps - 0.1, 0.3).max(0))
    colliding = (np.sqrt((others**2).sum(1)) < 0.3).any()
    return near.max() - 0.5 * shared.max() - 0.5 * colliding


def test_spread():
    mpe2 = pytest.importorskip("mpe2", reason="simple_spread is one of its environments")
    from mpe2 import simple_spread_v3  # noqa: PLC0415
    from pettingzoo.test import parallel_api_test  # noqa: PLC0415

    from sfol.wrappers.pettingzoo import ParallelRuleReward  # noqa: PLC0415

    assert mpe2
    reward = sfol.RewardFunction("spread")
    env = ParallelRuleReward(simple_spread_v3.parallel_env(), reward)
    parallel_api_test(env, num_cycles=30)
    seen, values, collisions = [], [], 0
    for seed in range(12):
        env.reset(seed=seed)
        while env.agents:
            actions = {agent: env.action_space(agent).sample() for agent in env.agents}
            observations, rewards, _, _, infos = env.step(actions)
            for agent, value in rewards.items():
                seen.append(observations[agent])
                values.append(value)
                collisions += infos[agent]["confidence_colliding"]
    expected = [spread(np.asarray(after, np.float64)) for after in seen]
    assert values == pytest.approx(expected, abs=1e-12, rel=0)
    many = reward.transitions(np.stack(seen), None, np.stack(seen)).reward
    assert many == pytest.approx(expected, abs=1e-12, rel=0)
    assert collisions
