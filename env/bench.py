"""Speed of every stage, measured in one run, so that ratios mean something on a noisy machine."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch

import sfol
from env.crossing import OccludedCrossing
from vsr.codebook import Codebook
from vsr.descriptor import SceneDescriptor
from vsr.entities import find_entities
from vsr.facts import scene_facts
from vsr.segmentation import SimulatorSegmenter

SIGNALS = {"v": 6.0, "v_next": 5.5, "d": 9.0}


def measure() -> dict[str, Any]:
    """Return the median cost of every stage.

    Returns:
        Times in the unit that the key names, and ratios of times taken in this run.
    """
    return {"imports": _imports(), "reward": _reward(), "street": _street()}


def street_facts(pedestrians: int) -> sfol.Facts:
    """Return the facts of a plausible scene: pedestrians, two vehicles and a crosswalk."""
    facts = sfol.Facts()
    facts.add("Crosswalk", "crosswalk1", confidence=0.9)
    facts.add("Approaching", "ego", "crosswalk1")
    for i in range(2):
        facts.add("Vehicle", f"vehicle{i}", confidence=0.9)
        facts.add("RightOf", f"vehicle{i}", "ego")
    facts.add("Occludes", "vehicle0", "crosswalk1")
    sides = ("LeftOf", "CenterOf", "RightOf")
    for i in range(pedestrians):
        name = f"pedestrian{i}"
        facts.add("Pedestrian", name, confidence=0.8)
        facts.add(sides[i % 3], name, "ego")
        if i % 4 < 2:
            facts.add(("OnRoad", "OnCrosswalk")[i % 4], name)
    return facts


def _reward() -> dict[str, float]:
    reward = sfol.RewardFunction("aeb")
    result = {}
    for count in (1, 10, 25, 50):
        prepared = partial(reward.evaluate, street_facts(count), **SIGNALS)
        call = _median(prepared, 300)
        whole = _median(partial(_build_and_evaluate, reward, count), 300)
        result[f"{count}_pedestrians_prepared_us"] = round(call * 1e6, 1)
        result[f"{count}_pedestrians_with_facts_us"] = round(whole * 1e6, 1)
    return result


def _build_and_evaluate(reward: sfol.RewardFunction, pedestrians: int) -> None:
    reward.evaluate(street_facts(pedestrians), **SIGNALS)


def _street() -> dict[str, float]:
    street = OccludedCrossing(traffic="high", occlusion="full")
    street.reset(seed=0)
    for _ in range(60):  # to where there is much to see
        street.step(np.array([0.5], np.float32))
    frame, position = street.frame, street.ego.position
    segmenter = SimulatorSegmenter()
    grounding = street.pipeline.grounding
    (probabilities,) = segmenter([frame])
    entities = find_entities(probabilities, grounding.minimum_area)
    descriptor = SceneDescriptor(Codebook(), grounding)

    def perceive() -> None:
        found = find_entities(probabilities, grounding.minimum_area)
        scene_facts(found, probabilities, grounding, sfol.Facts())

    def describe() -> None:
        with torch.inference_mode():
            descriptor.ssi(entities, frame.classes)

    camera = _median(lambda: street.camera.capture(position), 40)
    step = _median(lambda: street.step(np.zeros(1, np.float32)), 40)
    result = {
        "entities_in_view": len(entities),
        "camera_ms": round(camera * 1e3, 2),
        "segmenter_ms": round(_median(lambda: segmenter([frame]), 40) * 1e3, 2),
        "entities_and_facts_ms": round(_median(perceive, 40) * 1e3, 2),
        "descriptor_ssi_ms": round(_median(describe, 40) * 1e3, 2),
        "step_ms": round(step * 1e3, 2),
        "step_over_camera": round(step / camera, 2),
    }
    street.close()
    return result


def _imports() -> dict[str, float]:
    numpy_pydantic = _median(lambda: _run("import numpy, pydantic"), 5)
    whole = _median(lambda: _run("import sfol"), 5)
    return {
        "numpy_and_pydantic_ms": round(numpy_pydantic * 1e3),
        "sfol_ms": round(whole * 1e3),
        "sfol_more_ms": round((whole - numpy_pydantic) * 1e3),
    }


def _run(code: str) -> None:
    subprocess.run([sys.executable, "-c", code], check=True)


def _median(call: Callable[[], object], times: int) -> float:
    call()
    samples = []
    for _ in range(times):
        start = time.perf_counter()
        call()
        samples.append(time.perf_counter() - start)
    return statistics.median(samples)
