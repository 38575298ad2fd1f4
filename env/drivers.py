"""Scripted drivers: anchors to compare a policy with."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from env.actors import EgoParameters
from env.metrics import STANDSTILL
from vsr.classes import SemanticClass
from vsr.entities import Entity

if TYPE_CHECKING:
    from env.crossing import OccludedCrossing


class Driver(Protocol):
    """Whoever chooses the pedals."""

    def reset(self) -> None:
        """Forget the episode before."""
        ...

    def __call__(self, street: OccludedCrossing) -> float:
        """Return an action in [-1, 1]: throttle above 0, brake below.

        Args:
            street: the environment; what a driver may look at in it is the driver's own rule.
        """
        ...


class FullThrottle:
    """Sees nothing and always accelerates."""

    def reset(self) -> None:
        """Do nothing: there is nothing to forget."""

    def __call__(self, street: OccludedCrossing) -> float:
        """Return full throttle."""
        return 1.0


@dataclass(frozen=True)
class Cautious:
    """Drives so that it can stop within what it sees.

    It knows the entities and facts of the camera's scene, the lens, and its own speed, and nothing
    else. It stops for people on the road, creeps towards a crosswalk that something hides, and
    passes every crosswalk slowly.

    Attributes:
        cruise: speed on a free road, in m/s.
        creep: speed at a crosswalk and where the view is not free, in m/s.
        braking: deceleration that it plans with, in m/s².
        reaction: time that it takes to be slow, in s.
        margin: distance that it keeps to people, in m.
        near: distance of a crosswalk from which it is passed slowly, in m.
    """

    cruise: float = 9.0
    creep: float = 2.0
    braking: float = 3.0
    reaction: float = 0.4
    margin: float = 2.0
    near: float = 8.0

    def reset(self) -> None:
        """Do nothing: it drives by what it sees now."""

    def __call__(self, street: OccludedCrossing) -> float:
        """Return the pedal that leads to the speed from which it can still stop."""
        limits = [*self._limits_of_people(street), *self._limits_of_crosswalks(street)]
        return _pedal(street.ego.speed, min([self.cruise, *limits]))

    def _limits_of_people(self, street: OccludedCrossing) -> Iterator[float]:
        left, right = street.pipeline.grounding.road
        for person in _seen(street, SemanticClass.PEDESTRIAN):
            if not any(street.scene.facts.bound(g, person.name) for g in _GROUNDS):
                continue
            ahead = _distance(street, person)
            first, last = (_lateral(street, column, ahead) for column in person.box[1::2])
            if first < right and last > left:
                yield self._speed_to_stop_within(ahead - self.margin)

    def _limits_of_crosswalks(self, street: OccludedCrossing) -> Iterator[float]:
        for crosswalk in _seen(street, SemanticClass.CROSSWALK):
            ahead = _distance(street, crosswalk)
            hidden = any(
                street.scene.facts.bound("Occludes", vehicle.name, crosswalk.name)
                for vehicle in _seen(street, SemanticClass.VEHICLE, SemanticClass.TRUCK)
            )
            if hidden or ahead < self.near:
                yield max(self.creep, self._speed_to_stop_within(ahead))

    def _speed_to_stop_within(self, distance: float) -> float:
        # v · reaction + v² / (2 · braking) = distance, solved for v
        b, t = self.braking, self.reaction
        return b * (math.sqrt(t * t + 2.0 * max(distance, 0.0) / b) - t)


DRIVERS: dict[str, type[FullThrottle] | type[Cautious]] = {
    "full_throttle": FullThrottle,
    "cautious": Cautious,
}

_GROUNDS = ("OnRoad", "OnCrosswalk")


def _pedal(speed: float, target: float) -> float:
    if target < STANDSTILL:
        return -min(0.3 + speed / 4.0, 1.0)
    wanted = 2.0 * (target - speed)  # m/s²
    car = EgoParameters()
    return max(min(wanted / (car.drive if wanted > 0.0 else car.brake), 1.0), -1.0)


def _seen(street: OccludedCrossing, *kinds: SemanticClass) -> Iterator[Entity]:
    return (entity for entity in street.scene.entities if entity.kind in kinds)


def _distance(street: OccludedCrossing, entity: Entity) -> float:
    """Return how far before ego's bumper an entity meets the ground, by the pinhole's rows."""
    lens = street.camera.parameters
    below = max(entity.bottom - lens.size / 2, 0.5)
    return lens.focal_length * lens.height / below - lens.setback


def _lateral(street: OccludedCrossing, column: float, ahead: float) -> float:
    """Return how far right of ego's centre line a column is at a distance before the bumper."""
    lens = street.camera.parameters
    return (column - lens.size / 2) * (ahead + lens.setback) / lens.focal_length
