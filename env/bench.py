"""Speed of every stage from camera to reward, in one run, so that ratios mean something."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from env.crossing import OccludedCrossing
from env.drivers import Cautious
from sfol.bench import median
from vsr.codebook import Codebook
from vsr.descriptor import SceneDescriptor
from vsr.entities import class_map, find_entities
from vsr.facts import scene_facts
from vsr.segmentation import SimulatorSegmenter

_BRAKE = np.array([-1.0], np.float32)


def measure() -> dict[str, Any]:
    """Return the median cost of every stage on a busy street, before the crosswalk.

    Returns:
        Times in ms, and the ratio of a whole step to a camera frame.
    """
    street = OccludedCrossing(traffic="high", occlusion="full")
    try:
        _drive_to(street, position=25.0)
        return _stages(street)
    finally:
        street.close()


def _drive_to(street: OccludedCrossing, position: float) -> None:
    driver = Cautious()
    street.reset(seed=0)
    while street.ego.position < position:
        street.step(np.array([driver(street)], np.float32))


def _stages(street: OccludedCrossing) -> dict[str, Any]:
    frame, position = street.frame, street.ego.position
    grounding = street.pipeline.grounding
    segmenter = SimulatorSegmenter()
    (probabilities,) = segmenter([frame])
    classes = class_map(probabilities)
    entities = find_entities(probabilities, grounding.minimum_area, classes)
    facts = scene_facts(entities, classes, grounding, street.pipeline.reward.facts())
    descriptor = SceneDescriptor(Codebook(), grounding)
    signals = {"v": 6.0, "v_next": 5.5, "d": 9.0}

    def perceive() -> None:
        seen = class_map(probabilities)
        found = find_entities(probabilities, grounding.minimum_area, seen)
        scene_facts(found, seen, grounding, street.pipeline.reward.facts())

    def describe() -> None:
        with torch.inference_mode():
            descriptor.ssi(entities, classes)

    stages: dict[str, Callable[[], object]] = {
        "camera_ms": lambda: street.camera.capture(position),
        "segmenter_ms": lambda: segmenter([frame]),
        "entities_and_facts_ms": perceive,
        "reward_ms": lambda: street.pipeline.reward.evaluate(facts, **signals),
        "descriptor_ssi_ms": describe,
        "step_ms": lambda: street.step(_BRAKE),  # a car that stands can go on for 60 s
    }
    times = {name: round(1e3 * median(stage), 2) for name, stage in stages.items()}
    return {
        "entities_in_view": len(entities),
        **times,
        "step_over_camera": round(times["step_ms"] / times["camera_ms"], 2),
    }
