"""The simulator's scene of a street is that of probabilities that are certain."""

import numpy as np
import pytest

from env.driving.drivers import Cautious
from env.driving.rollout import rollout
from env.perception.pipeline import ScenePipeline
from vsr.classes import CLASS_COUNT


def certain(frames):
    maps = np.stack([frame.classes for frame in frames])
    return np.moveaxis(np.eye(CLASS_COUNT, dtype=np.float32)[maps], -1, 1).copy()


def everything(scene):
    entities = [
        (entity.name, entity.kind, entity.confidence, entity.box, entity.mask.tolist())
        for entity in scene.entities
    ]
    return entities, list(scene.facts.items()), dict(scene.conclusions.derived)


@pytest.mark.parametrize("traffic", ["low", "high"])
def test_the_simulators_classes_are_as_good_as_certain_probabilities(street_of, traffic):
    street = street_of(traffic, "full")
    driven = rollout(street, Cautious(), seed=3, frames_every=20)
    frames = [step.frame for step in driven if step.frame]
    classes, probabilities = ScenePipeline("crossing"), ScenePipeline("crossing", certain)
    seen = 0
    for one, other in zip(classes.perceive(frames), probabilities.perceive(frames), strict=True):
        assert everything(one) == everything(other)
        assert np.array_equal(one.classes, other.classes)
        seen += len(one.entities)
    assert seen > 0
