"""Speed of every stage from camera to reward, in one run, so that ratios mean something."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from multiprocessing import active_children
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np
import torch

from env.driving.drivers import Cautious
from env.driving.rollout import rollout
from env.driving.setup import load_setup
from env.learning.vector_streets import make_streets
from env.street.crossing import OccludedCrossing
from env.world.camera import DashCamera
from env.world.cells import Cell, Traffic
from sfol.tools.bench import median
from vsr.entities import find_entities
from vsr.facts import scene_facts
from vsr.hypervectors.codebook import Codebook
from vsr.hypervectors.descriptor import SceneDescriptor

_BRAKE = np.array([-1.0], np.float32)
_STRETCH = 100  # steps that are timed together, so that an episode's reset has its share
_FRAMES = 20  # the same, where every step is seen and described


def measure() -> dict[str, Any]:
    """Return the median cost of every stage on a busy street, before the crosswalk.

    Returns:
        Times in ms; the ratio of a whole step to a frame of pybullet's TinyRenderer; steps a
        second with truth and state, random actions, resets included; decisions a second of the
        main setup's training without its updates, by where its facts come from, and the memory of
        one of its workers in MB, where a page that n processes share counts for 1/n (Linux alone).
    """
    street = OccludedCrossing(traffic="high", occlusion="full")
    try:
        _drive_to(street, position=25.0)
        stages = _stages(street)
    finally:
        street.close()
    return {
        **stages,
        "truth_steps_per_second_low": _steps_per_second("low"),
        "truth_steps_per_second_high": _steps_per_second("high"),
        **_training("simulator"),
        **_training("unet"),
    }


def _training(perception: str) -> dict[str, float]:
    """Return how fast all streets of the main setup are driven, random actions, and in what memory.

    That is all of a training but for policy and updates.
    """
    setup = load_setup("add").model_copy(update={"perception": perception})
    streets = make_streets(setup, [Cell("medium", "full")], seed=0)
    rng = np.random.default_rng(0)
    streets.reset()

    def drive() -> None:
        for pedals in rng.uniform(-0.3, 1.0, (_FRAMES, setup.streets, 1)).astype(np.float32):
            streets.step(pedals)

    try:
        pace = round(_FRAMES * setup.streets / median(drive), 1)
        memory = max(_memory_of(worker) for worker in active_children())
    finally:
        streets.close()
    return {
        f"training_steps_per_second_{perception}": pace,
        f"worker_mb_{perception}": round(memory),
    }


def _memory_of(process: BaseProcess) -> float:
    lines = Path(f"/proc/{process.pid}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024


def _steps_per_second(traffic: Traffic) -> int:
    """Return the pace of perception ``truth`` and observation ``state``, resets included."""
    street = OccludedCrossing(
        traffic=traffic, occlusion="full", perception="truth", observation="state"
    )
    seeds, rng = count(), np.random.default_rng(0)
    street.reset(seed=next(seeds))

    def drive() -> None:
        for pedal in rng.uniform(-0.7, 1.0, (_STRETCH, 1)).astype(np.float32):
            *_, terminated, truncated, _ = street.step(pedal)
            if terminated or truncated:
                street.reset(seed=next(seeds))

    try:
        return round(_STRETCH / median(drive))
    finally:
        street.close()


def _drive_to(street: OccludedCrossing, position: float) -> None:
    next(step for step in rollout(street, Cautious(), seed=0) if step.info["position"] >= position)


def _stages(street: OccludedCrossing) -> dict[str, Any]:
    frame, position = street.frame, street.ego.position
    tiny = DashCamera(street.world, street.lens, "tiny")
    grounding = street.pipeline.grounding
    classes = frame.classes
    entities = find_entities(classes, grounding.minimum_area)
    facts = scene_facts(entities, classes, grounding, street.pipeline.reward.facts())
    descriptor = SceneDescriptor(Codebook(), grounding)
    signals = {"v": 6.0, "v_next": 5.5, "d": 9.0}

    def describe() -> None:
        with torch.inference_mode():
            descriptor.ssi(entities, classes)

    stages: dict[str, Callable[[], object]] = {
        "tiny_renderer_ms": lambda: tiny.capture(position),
        "camera_ms": lambda: street.camera.capture(position),
        "perception_ms": lambda: street.pipeline.perceive([frame]),
        "reward_ms": lambda: street.pipeline.reward.evaluate(facts, **signals),
        "descriptor_ssi_ms": describe,
        "step_ms": lambda: street.step(_BRAKE),  # a car that stands can go on for 60 s
    }
    times = {name: round(1e3 * median(stage), 2) for name, stage in stages.items()}
    return {
        "entities_in_view": len(entities),
        **times,
        "step_over_tiny_renderer": round(times["step_ms"] / times["tiny_renderer_ms"], 2),
    }
