"""Many streets, perceived together: the same as each one perceived by itself."""

import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

from env.crossing import OccludedCrossing
from env.description import Describer
from env.pipeline import ScenePipeline
from env.vector import DescribedStreets
from sfol.errors import UsageError

STEPS = 12
ROUNDING = 1e-5  # a batch is added up in another order


def bare_street():
    """A street that leaves perception to others; episodes are cut off soon."""
    return OccludedCrossing(traffic="low", observation="frame", perception="none", max_seconds=0.5)


def whole_street():
    return OccludedCrossing(traffic="low", observation="vsr", fusion="ssi", max_seconds=0.5)


def described(venv):
    pipeline = ScenePipeline()
    return DescribedStreets(venv, pipeline, Describer(pipeline, "ssi"))


@pytest.mark.parametrize("processes", [False, True])
def test_streets_perceived_together_are_as_each_by_itself(processes):
    makers = [bare_street, bare_street]
    together = described(
        SubprocVecEnv(makers, start_method="spawn") if processes else DummyVecEnv(makers)
    )
    alone = DummyVecEnv([whole_street, whole_street])
    try:
        for streets in (together, alone):
            streets.seed(5)
        np.testing.assert_allclose(together.reset(), alone.reset(), atol=ROUNDING)
        ended = 0
        for step in range(STEPS):
            actions = np.array([[1.0], [0.5]], np.float32) * (-1) ** (step // 8)
            observations, rewards, dones, infos = together.step(actions)
            expected, expected_rewards, expected_dones, expected_infos = alone.step(actions)
            np.testing.assert_allclose(observations, expected, atol=ROUNDING)
            np.testing.assert_allclose(rewards, expected_rewards, rtol=1e-6)
            np.testing.assert_array_equal(dones, expected_dones)
            for info, other in zip(infos, expected_infos, strict=True):
                assert info.keys() == other.keys()
                if "terminal_observation" in info:
                    last, expected = (i.pop("terminal_observation") for i in (info, other))
                    np.testing.assert_allclose(last, expected, atol=ROUNDING)
                    ended += 1
                np.testing.assert_equal(info, other)
        assert ended == 2 * (STEPS // 5)
    finally:
        together.close()
        alone.close()


def test_the_terms_in_the_info_sum_to_the_reward():
    streets = described(DummyVecEnv([bare_street]))
    try:
        streets.seed(1)
        streets.reset()
        _, rewards, _, (info,) = streets.step(np.array([[1.0]], np.float32))
        terms = [value for name, value in info.items() if name.startswith("reward_")]
        assert sum(terms) == pytest.approx(float(rewards[0]))
    finally:
        streets.close()


def test_a_fusion_with_features_needs_an_encoder():
    with pytest.raises(UsageError, match="needs an encoder"):
        Describer(ScenePipeline(), "add")
