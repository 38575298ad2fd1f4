"""Variants of the street for further evaluation: nobody crosses, or Euro NCAP's child does."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.random import Generator

from env.street.crossing import OccludedCrossing
from env.world.actors import TRAFFIC, Ego, Pedestrians, Walkers
from env.world.world import PERSON_RADIUS
from sfol.knowledge_base import KnowledgeBase

CHILD_PACE = 5 / 3.6  # m/s (Euro NCAP: 5 km/h)
LEAD = 4.0  # s from the start to the impact, if nobody brakes (Euro NCAP: at least 4 s)

_BEYOND_CAR = 1.0  # m from the parked car's front to the child's path
_ELSEWHERE = (-100.0, 0.0)  # where the street's other people are, far behind ego


class QuietStreet(OccludedCrossing):
    """The same street, but everybody stays on the sidewalks: whoever brakes, brakes for nothing."""

    def _populate(self, rng: Generator) -> Walkers:
        level = replace(TRAFFIC[self.traffic], crossing=0.0, orderly=0)
        return Pedestrians(level, None, rng, self.world.geometry, self.corridor)


@dataclass(frozen=True)
class Approach:
    """How ego comes towards the child.

    Attributes:
        speed: of ego, in km/h.
        impact: where ego's front would hit the child, as a share of ego's width from the near side.
    """

    speed: float
    impact: float


class ChildCrossing(OccludedCrossing):
    """A test like Euro NCAP's CPNCO: a child crosses from behind a parked car and a truck.

    The child walks at 5 km/h, looks at nobody and never stops. Ego starts at its test speed, 4 s
    before it would hit the child; full throttle holds that speed and never exceeds it. Nobody else
    is about. Unlike Euro NCAP's, the street has a crosswalk there.

    Args:
        perception: as of `OccludedCrossing`.
        rules: as of `OccludedCrossing`.

    Attributes:
        approach: of the next episode; may be set before a reset.

    Source: Euro NCAP, test protocol for vulnerable road users, scenario CPNCO.
    """

    def __init__(
        self,
        *,
        perception: str = "simulator",
        rules: KnowledgeBase | str | Path = "crossing",
    ) -> None:
        super().__init__(
            traffic="low",
            occlusion="cpnco",
            perception=perception,
            observation="state",
            rules=rules,
        )
        self.approach = Approach(speed=40.0, impact=0.5)

    @property
    def child_line(self) -> float:
        """The x of the child's path, in m."""
        street = self.world.geometry
        return street.crosswalk[0] - street.parked_gap + _BEYOND_CAR

    def _populate(self, rng: Generator) -> Walkers:
        count = TRAFFIC[self.traffic].people
        positions = np.tile(_ELSEWHERE, (count, 1))
        velocities = np.zeros((count, 2))
        hit = self.corridor.centre + (self.approach.impact - 0.5) * self.corridor.width
        positions[0] = self.child_line, hit - CHILD_PACE * LEAD
        velocities[0] = 0.0, CHILD_PACE
        return Walkers(positions, velocities)

    def _start(self) -> Ego:
        speed = self.approach.speed / 3.6
        car = replace(self._ego_parameters, top_speed=speed)
        front = self.child_line - PERSON_RADIUS - speed * LEAD
        return Ego(car, front, speed, force=car.drive)
