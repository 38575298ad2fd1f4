"""Wrappers and rules over time: an episode of the environment is one of the rules."""

import numpy as np
import pytest

import sfol
from sfol.errors import UsageError
from tests.sfol import boat
from tests.sfol.harbour import harbour_text

gymnasium = pytest.importorskip("gymnasium")

from sfol.wrappers import FIRED, RuleReward, VectorRuleReward  # noqa: E402 (it needs gymnasium)


@pytest.fixture
def drift(tmp_path):
    return lambda facts_at="state": boat.load(tmp_path, facts_at, *boat.OVER_TIME)


@pytest.mark.parametrize("facts_at", ["state", "next"])
def test_each_episode_begins_with_an_empty_memory(drift, facts_at):
    reward = drift(facts_at)
    env = RuleReward(boat.Boat(), reward)
    env.report_fired()
    fired = 0
    for seed in range(5):
        before, _ = env.reset(seed=seed)
        before = {"boat": (before["boat"][0].copy(),), "age": before["age"]}
        episode, ended = reward.episode(), False
        while not ended:
            after, value, lost, late, info = env.step(1)
            native = info["original_reward"]
            expected = episode.transition(before, 1, after, native, lost, late)
            assert value == expected.reward
            assert info["weight_far"] == expected.weights["far"]
            fired += info[FIRED]["far"]
            before = {"boat": (after["boat"][0].copy(),), "age": after["age"]}
            ended = lost or late
    assert fired > 5


def test_facts_may_be_made_by_a_function(tmp_path):
    path = tmp_path / "harbour.yaml"
    path.write_text(harbour_text("previously(Near(X))"))
    scenes = iter(["Near(pilot).", "", "Near(pilot).", "", ""])
    env = RuleReward(
        gymnasium.make("CartPole-v1"),
        sfol.RewardFunction(path),
        facts=lambda *_: sfol.Facts.parse(next(scenes)),
    )
    env.reset(seed=0)
    assert [env.step(0)[1] for _ in range(3)] == [0.0, 1.0, 0.0]
    env.reset(seed=0)  # reads the last scene


def test_many_environments_are_refused_at_once(drift):
    make = [boat.Boat, boat.Boat]
    with pytest.raises(UsageError, match="each environment its own past") as caught:
        VectorRuleReward(gymnasium.vector.SyncVectorEnv(make), drift())
    assert "RuleReward" in caught.value.suggestion
    reward = drift()
    envs = gymnasium.vector.SyncVectorEnv([lambda: RuleReward(boat.Boat(), reward)] * 2)
    envs.reset(seed=0)
    assert np.isfinite(envs.step([1, 1])[1]).all()


def test_a_potential_is_refused(drift):
    with pytest.raises(UsageError, match="a potential is one of a state alone") as caught:
        RuleReward(boat.Boat(), drift(), mode="potential", potential="far", discount=0.9)
    assert "mode='add'" in caught.value.suggestion


def test_hindsight_is_refused(tmp_path):
    from tests.sfol.test_wrappers_goals import REACH, Plane  # noqa: PLC0415 (as above)

    path = tmp_path / "reach.yaml"
    path.write_text(REACH.replace("At(X, goal).", "At(X, goal), previously(At(X, goal))."))
    env = RuleReward(Plane(), sfol.RewardFunction(path))
    env.reset(seed=0)
    with pytest.raises(UsageError, match="with another past") as caught:
        env.compute_reward(np.zeros(2), np.zeros(2), {})
    assert "learn without hindsight" in caught.value.suggestion
