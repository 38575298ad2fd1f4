"""Scripted drivers: anchors to compare a policy with.

Each says what it may look at. Those that go by the camera know the entities and facts of its scene,
its lens, and their own speed, and nothing else of the street.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from env.street.view import StreetView
from env.world.actors import PHYSICS_HZ, Ego, EgoParameters, Walkers
from env.world.kinematics import STANDSTILL
from env.world.world import PERSON_RADIUS
from vsr.classes import SemanticClass
from vsr.entities import Entity

Array = npt.NDArray[np.float64]


class Driver(Protocol):
    """Whoever chooses the pedals."""

    def reset(self) -> None:
        """Forget the episode before."""
        ...

    def __call__(self, street: StreetView) -> float:
        """Return an action in [-1, 1]: throttle above 0, brake below.

        Args:
            street: the environment; what a driver may look at in it is the driver's own rule.
        """
        ...


class _Forgetful:
    """A driver without memory."""

    def reset(self) -> None:
        """Do nothing: there is nothing to forget."""


class FullThrottle(_Forgetful):
    """Always accelerates. Sees nothing."""

    def __call__(self, street: StreetView) -> float:
        """Return full throttle."""
        return 1.0


class NeverMoves(_Forgetful):
    """Always brakes. Sees nothing."""

    def __call__(self, street: StreetView) -> float:
        """Return full braking."""
        return -1.0


@dataclass(frozen=True)
class Crawl(_Forgetful):
    """Creeps on for ever. Knows its own speed and sees nothing.

    Attributes:
        pace: in m/s.
    """

    pace: float = 0.5

    def __call__(self, street: StreetView) -> float:
        """Return the pedal that leads to its pace."""
        return _pedal(street.ego, self.pace)


@dataclass(frozen=True)
class TTCBrake(_Forgetful):
    """Drives at the speed limit and brakes fully when a collision is near. Sees the camera's scene.

    That is a plain emergency brake: it reacts to who is in its corridor now, and expects nobody.

    Attributes:
        ttc: time to collision at which it brakes, in s.
        margin: of the corridor on either side of ego, in m.
        keep: distance to people below which it brakes at any speed, in m.
    """

    ttc: float = 1.5
    margin: float = 0.8
    keep: float = 2.5

    def __call__(self, street: StreetView) -> float:
        """Return full braking or full throttle, which the speed limit ends."""
        reach = self.keep + self.ttc * street.ego.speed
        half = street.corridor.width / 2 + self.margin
        return -1.0 if any(d <= reach for d in _distances_of_people(street, -half, half)) else 1.0


@dataclass(frozen=True)
class Cautious(_Forgetful):
    """Drives so that it can stop within what it sees. Sees the camera's scene.

    It stops for people on the road, creeps towards a crosswalk that something hides, and passes
    every crosswalk slowly.

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

    def __call__(self, street: StreetView) -> float:
        """Return the pedal that leads to the speed from which it can still stop."""
        limits = [*self._limits_of_people(street), *self._limits_of_crosswalks(street)]
        return _pedal(street.ego, min([self.cruise, *limits]))

    def _limits_of_people(self, street: StreetView) -> Iterator[float]:
        for ahead in _distances_of_people(street, *street.pipeline.grounding.road):
            yield self._speed_to_stop_within(ahead - self.margin)

    def _limits_of_crosswalks(self, street: StreetView) -> Iterator[float]:
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


@dataclass(frozen=True)
class Oracle(_Forgetful):
    """Drives as fast as it can without touching anybody. Sees the state of the world.

    It knows everybody's mind as well: it plays the street on, with people who decide as they will,
    and takes the first of its pedals after which braking still ends without a contact. Whatever it
    does, that braking stays its way out, so it never hits anybody.

    Attributes:
        pedals: what it would like to do, best first.
        brake: the way out; half of what ego has, so that people aren't frightened.
    """

    pedals: tuple[float, ...] = (1.0, 0.5, 0.0)
    brake: float = -0.5

    def __call__(self, street: StreetView) -> float:
        """Return the first pedal after which ego can stop before everybody."""
        return next((p for p in self.pedals if self._leaves_a_way_out(street, p)), self.brake)

    def _leaves_a_way_out(self, street: StreetView, pedal: float) -> bool:
        ego, people = street.ego, copy.copy(street.people)
        while True:
            ego, positions, walked = _play_on(ego, people, pedal, street.control_dt)
            if _touch(ego.parameters, positions, walked, street.corridor.centre):
                return False
            pedal = self.brake
            if ego.speed < STANDSTILL:
                return True


DRIVERS: dict[str, type[Driver]] = {
    "full_throttle": FullThrottle,
    "never_moves": NeverMoves,
    "crawl": Crawl,
    "ttc_brake": TTCBrake,
    "cautious": Cautious,
    "oracle": Oracle,
}

_GROUNDS = ("OnRoad", "OnCrosswalk")
_SKIN = 0.05  # m that the oracle keeps from everybody


def _pedal(ego: Ego, target: float) -> float:
    """Return the pedal that leads ego to a speed in m/s; 0 makes it stop."""
    if target < STANDSTILL:
        return -min(0.3 + ego.speed / 4.0, 1.0)
    car = ego.parameters
    wanted = 2.0 * (target - ego.speed) + car.rolling + car.drag * ego.speed**2  # m/s²
    return max(min(wanted / (car.drive if wanted > 0.0 else car.brake), 1.0), -1.0)


def _seen(street: StreetView, *kinds: SemanticClass) -> Iterator[Entity]:
    return (entity for entity in street.scene.entities if entity.kind in kinds)


def _distances_of_people(street: StreetView, left: float, right: float) -> Iterator[float]:
    """Return how far before the bumper people on the road are, between two lines beside ego.

    Args:
        street: what the camera shows of it.
        left: y of a line, in m to the right of ego's centre line; negative for the left.
        right: that of the other.
    """
    for person in _seen(street, SemanticClass.PEDESTRIAN):
        if not any(street.scene.facts.bound(ground, person.name) for ground in _GROUNDS):
            continue
        ahead = _distance(street, person)
        first, last = (_lateral(street, column, ahead) for column in person.box[1::2])
        if first < right and last > left:
            yield ahead


def _distance(street: StreetView, entity: Entity) -> float:
    """Return how far before ego's bumper an entity meets the ground, by the pinhole's rows."""
    pinhole = street.lens.pinhole
    row = max(entity.bottom, pinhole.horizon + 0.5)  # nobody stands above the horizon
    return pinhole.distance(row) - street.lens.setback


def _lateral(street: StreetView, column: float, ahead: float) -> float:
    """Return how far right of ego's centre line a column is at a distance before the bumper."""
    return street.lens.pinhole.lateral(column, ahead + street.lens.setback)


def _play_on(ego: Ego, people: Walkers, pedal: float, seconds: float) -> tuple[Ego, Array, Array]:
    """Move people on with ego.

    Returns:
        Ego at the end; at every instant S of the physics, its position, float (S,), and where
        people are, float (S, N, 2).
    """
    people.decide(ego, seconds)
    steps = round(seconds * PHYSICS_HZ)
    course = ego.course(pedal, 1.0 / PHYSICS_HZ, steps)
    walked = people.paths(np.arange(1, steps + 1) / PHYSICS_HZ)
    people.advance(seconds)
    return Ego(ego.parameters, *course[-1].tolist()), course[:, 0], walked


def _touch(car: EgoParameters, positions: Array, walked: Array, lane: float) -> bool:
    reach = PERSON_RADIUS + _SKIN
    beyond_front = walked[..., 0] - positions[:, None]
    beside = np.abs(walked[..., 1] - lane) < car.width / 2 + reach
    return bool((beside & (beyond_front < reach) & (beyond_front > -car.length - reach)).any())
