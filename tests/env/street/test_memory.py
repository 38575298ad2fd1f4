"""A street under rules over time: each of its episodes is one of the rules."""

import numpy as np
import pytest

import sfol
from env.driving.drivers import Cautious
from env.driving.rollout import rollout
from env.street.crossing import OccludedCrossing
from sfol.errors import UsageError

STEPS = 40


@pytest.fixture
def street():
    made = OccludedCrossing(perception="truth", observation="none", rules="steady", traffic="high")
    yield made
    made.close()


def weights(street, seed):
    found = []
    for step in rollout(street, Cautious(), seed):
        found.append((step.scene.facts, step.signals, step.outcome))
        if len(found) == STEPS:
            return found
    raise AssertionError("the episode is too short")


def test_each_episode_is_one_of_the_rules(street):
    episode = sfol.RewardFunction("steady").episode()
    for seed in (3, 4, 3):
        episode.reset()
        for facts, signals, outcome in weights(street, seed):
            expected = episode.step(facts, **signals)
            assert outcome.reward == expected.reward
            assert outcome.weights == expected.weights
        assert outcome.weights["safety"] > 0.0


def test_the_scene_has_conclusions_with_the_past_in_mind(street):
    street.reset(seed=3)
    for _ in range(STEPS):
        street.step(np.array([0.5], np.float32))
    assert street.scene.conclusions.memory.step == STEPS + 1


def test_steps_of_another_length_are_refused():
    with pytest.raises(UsageError) as caught:
        OccludedCrossing(rules="steady", control_hz=20)
    assert "a step of the street takes 0.05 s" in caught.value.message
    assert "time: {step: 0.05, unit: s}" in caught.value.suggestion
    OccludedCrossing(rules="crossing", control_hz=20, perception="none").close()


def test_perceptions_that_look_at_one_scene_begin_with_it(street):
    street.reset(seed=3)
    scene = street.pipeline.scene((), sfol.Facts.parse("NoCrosswalk(ego). EmptyLane(ego)."))
    assert street.pipeline.reward.weights(scene.conclusions)["efficiency"] == pytest.approx(1 / 3)
