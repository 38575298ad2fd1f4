"""The one loop in which drivers drive."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from env.driving.drivers import Driver
from env.perception.pipeline import Scene
from env.street.crossing import OccludedCrossing
from vsr.segmentation import Frame

Ending = Literal["success", "collision", "timeout"]


@dataclass(frozen=True, eq=False)
class Transition:
    """One step (s, a, s'). It holds a scene: keep numbers of it, not transitions.

    Attributes:
        time: seconds since the start, at s.
        position: ego's front along the street at s, in m.
        speed: v at s, in m/s.
        scene: what perception found at s.
        frame: what the dash camera showed at s; None unless frames were asked for.
        action: throttle above 0, brake below, in [-1, 1].
        reward: R.
        crosswalk_free: whether nobody is on the crosswalk at s'.
        info: what the environment says of the step; after the last one also how it ended.
    """

    time: float
    position: float
    speed: float
    scene: Scene
    frame: Frame | None
    action: float
    reward: float
    crosswalk_free: bool
    info: Mapping[str, Any]

    @property
    def signals(self) -> dict[str, float]:
        """The signals that the reward was computed from."""
        return {"v": self.speed, "v_next": self.info["speed"], "d": self.info["distance"]}

    def parts(self, prefix: str) -> dict[str, float]:
        """Return the numbers of `info` whose names begin so, without the prefix."""
        return {
            key.removeprefix(prefix): float(value)
            for key, value in self.info.items()
            if key.startswith(prefix)
        }

    @property
    def ending(self) -> Ending:
        """How the episode ended, once it has."""
        if self.info["collision"]:
            return "collision"
        return "success" if self.info["is_success"] else "timeout"


def rollout(
    street: OccludedCrossing, driver: Driver, seed: int, *, frames: bool = False
) -> Iterator[Transition]:
    """Drive one episode and yield every step of it.

    Args:
        street: the environment; it is reset, and stands after the step that was yielded.
        driver: chooses the actions; it is reset.
        seed: decides everything that the environment draws.
        frames: whether the transitions have the camera's frames; perception may do without.
    """
    street.reset(seed=seed)
    driver.reset()
    step, ended = 0, False
    while not ended:
        ego, scene = street.ego, street.scene
        frame = street.frame if frames else None
        action = driver(street)
        _, reward, terminated, truncated, info = street.step(np.array([action], np.float32))
        ended = terminated or truncated
        yield Transition(
            time=step * street.control_dt,
            position=ego.position,
            speed=ego.speed,
            scene=scene,
            frame=frame,
            action=action,
            reward=float(reward),
            crosswalk_free=_crosswalk_free(street),
            info=info,
        )
        step += 1


def _crosswalk_free(street: OccludedCrossing) -> bool:
    geometry = street.world.geometry
    x, y = street.people.positions.T
    before, after = geometry.crosswalk
    return not ((x >= before) & (x <= after) & ~geometry.on_sidewalk(y)).any()
