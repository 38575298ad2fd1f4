"""The one loop in which drivers drive."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from env.driving.drivers import Driver
from env.perception.pipeline import Scene
from env.street.view import Street, StreetView
from sfol import Outcome
from vsr.segmentation import Frame

Ending = Literal["success", "collision", "timeout"]


@dataclass(frozen=True, eq=False)
class DrivenStep:
    """One step (s, a, s'). It holds a scene: keep numbers of it, not the step.

    Attributes:
        time: seconds since the start, at s.
        position: ego's front along the street at s, in m.
        speed: v at s, in m/s.
        scene: what perception found at s.
        frame: what the dash camera showed at s; None unless it was asked for.
        action: throttle above 0, brake below, in [-1, 1].
        outcome: the reward, and what it was made of.
        crosswalk_free: whether nobody is on the crosswalk at s'.
        info: what the environment says of the step; after the last one also how it ended.
    """

    time: float
    position: float
    speed: float
    scene: Scene
    frame: Frame | None
    action: float
    outcome: Outcome
    crosswalk_free: bool
    info: Mapping[str, Any]

    @property
    def signals(self) -> dict[str, float]:
        """The signals that the reward was computed from."""
        return {"v": self.speed, "v_next": self.info["speed"], "d": self.info["distance"]}

    @property
    def ending(self) -> Ending:
        """How the episode ended, once it has."""
        if self.info["collision"]:
            return "collision"
        return "success" if self.info["is_success"] else "timeout"


def rollout(
    street: Street, driver: Driver, seed: int, *, frames_every: int = 0
) -> Iterator[DrivenStep]:
    """Drive one episode and yield every step of it.

    Args:
        street: the environment; it is reset, and stands after the step that was yielded.
        driver: chooses the actions; it is reset.
        seed: decides everything that the environment draws.
        frames_every: of how many steps one has the camera's frame; 0: none has, and perception may
            do without it.
    """
    street.reset(seed=seed)
    driver.reset()
    step, ended = 0, False
    while not ended:
        ego, scene = street.ego, street.scene
        frame = street.frame if frames_every and step % frames_every == 0 else None
        action = driver(street)
        _, _, terminated, truncated, info = street.step(np.array([action], np.float32))
        ended = terminated or truncated
        yield DrivenStep(
            time=step * street.control_dt,
            position=ego.position,
            speed=ego.speed,
            scene=scene,
            frame=frame,
            action=action,
            outcome=street.outcome,
            crosswalk_free=_crosswalk_free(street),
            info=info,
        )
        step += 1


def _crosswalk_free(street: StreetView) -> bool:
    geometry = street.geometry
    x, y = street.people.positions.T
    before, after = geometry.crosswalk
    return not ((x >= before) & (x <= after) & ~geometry.on_sidewalk(y)).any()
