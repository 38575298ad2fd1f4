"""What one driven episode leaves behind: the record that metrics, report and figures read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from env.driving.rollout import Ending


@dataclass(frozen=True)
class SeenEntity:
    """An entity in one camera frame, as the report draws it.

    Attributes:
        name: the constant that stands for it in the facts, such as ``pedestrian3``.
        kind: ``pedestrian``, ``vehicle``, ``truck`` or ``crosswalk``.
        confidence: mean softmax over its pixels, 0 to 1.
        box: top, left, bottom, right in pixels; bottom and right are exclusive.
        weight: its weight in the descriptor, from the knowledge base's ``entity_weights``.
        facts: the atoms that name it, as text.
    """

    name: str
    kind: str
    confidence: float
    box: tuple[int, int, int, int]
    weight: float
    facts: tuple[str, ...]


@dataclass(frozen=True)
class Step:
    """One transition (s, a, s'): what was seen before the action and what came of it.

    Attributes:
        time: seconds since the start, at s.
        position: ego's front along the street at s, in m.
        speed: v at s, in m/s.
        speed_next: v at s', in m/s.
        action: throttle above 0, brake below, in [-1, 1].
        distance: the reward's privileged d, in m; infinity when nobody is in the way.
        ttc: smallest time to collision during the step, in s; infinity when there is none.
        frame: grayscale camera image at s, uint8 (224, 224).
        classes: the class that perception gave each of its pixels, uint8 (224, 224).
        entities: what perception found in that frame.
        facts: the facts of s, as text that ``sfol.Facts.parse`` reads.
        reward: R of the transition.
        terms: each weighted, signed term; they sum to the reward.
        weights: each weight of the knowledge base.
        confidences: each head's confidence for the subject.
        descriptor: the SSI part of the scene descriptor, float32 (2048,).
    """

    time: float
    position: float
    speed: float
    speed_next: float
    action: float
    distance: float
    ttc: float
    frame: npt.NDArray[np.uint8]
    classes: npt.NDArray[np.uint8]
    entities: tuple[SeenEntity, ...]
    facts: str
    reward: float
    terms: dict[str, float]
    weights: dict[str, float]
    confidences: dict[str, float]
    descriptor: npt.NDArray[np.float32]


@dataclass(frozen=True)
class Episode:
    """A driven episode, from reset to its end.

    Attributes:
        driver: name of the driver or policy.
        traffic: ``low``, ``medium`` or ``high``.
        occlusion: ``partial`` or ``full``.
        behaviour: how the crossing pedestrian behaves, as the environment names it.
        seed: the seed given to ``reset``.
        control_dt: seconds a step.
        steps: its transitions in order.
        ending: how it ended.
        info: the last step's ``info``.
    """

    driver: str
    traffic: str
    occlusion: str
    behaviour: str
    seed: int
    control_dt: float
    steps: tuple[Step, ...]
    ending: Ending
    info: dict[str, Any]
