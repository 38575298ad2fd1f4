"""Who moves: ego's longitudinal model, and the pedestrians as numpy arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from env.world.cells import Traffic
from env.world.kinematics import time_to_collision
from env.world.world import PERSON_RADIUS, StreetGeometry

Array = npt.NDArray[np.float64]
Behaviour = Literal["briefly_visible", "hidden"]

PHYSICS_HZ = 100  # instants a second at which everybody moves
RUNNING_PACE = 6 / 3.6  # m/s (paper: 6 km/h)


@dataclass(frozen=True)
class EgoParameters:
    """The longitudinal model of ego, in SI units.

    dv/dt = f − drag · v² − rolling while v > 0, where f follows the pedals with a first-order lag:
    df/dt = (drive · throttle − brake · braking − f) / lag. Ego never reverses.

    Attributes:
        drive: acceleration at full throttle and rest, in m/s².
        brake: deceleration at full braking, in m/s².
        top_speed: what full throttle approaches and never exceeds, in m/s.
        rolling: deceleration by the wheels, in m/s².
        lag: time constant of the actuators, in s.
        length: of the body, in m.
        width: of the body, in m.
        height: of the body, in m.
    """

    drive: float = 3.0
    brake: float = 8.0
    top_speed: float = 40 / 3.6
    rolling: float = 0.15
    lag: float = 0.15
    length: float = 4.2
    width: float = 1.8
    height: float = 1.45

    @cached_property
    def drag(self) -> float:
        """Coefficient of air drag, in 1/m; at top speed it takes all that full throttle gives."""
        return (self.drive - self.rolling) / self.top_speed**2


class Ego(NamedTuple):
    """Ego's state.

    Attributes:
        parameters: the longitudinal model.
        position: x of the front bumper, in m.
        speed: in m/s, never negative.
        force: acceleration that the actuators give at present, in m/s².
    """

    parameters: EgoParameters = EgoParameters()
    position: float = 0.0
    speed: float = 0.0
    force: float = 0.0

    @property
    def rear(self) -> float:
        """The x of the rear bumper, in m."""
        return self.position - self.parameters.length

    def after(self, action: float, dt: float) -> Ego:
        """Return the state after one step of explicit integration.

        Args:
            action: throttle above 0, brake below, in [-1, 1].
            dt: length of the step, in s.
        """
        car = self.parameters
        wanted = action * (car.drive if action > 0.0 else car.brake)
        force = self.force + (wanted - self.force) * min(dt / car.lag, 1.0)
        acceleration = force - car.drag * self.speed**2 - car.rolling
        speed = max(self.speed + acceleration * dt, 0.0)
        position = self.position + 0.5 * (self.speed + speed) * dt
        return Ego(car, position, speed, force)


@dataclass(frozen=True)
class TrafficLevel:
    """How many pedestrians there are (paper, section "Occluded Pedestrian Crossing Scenario").

    Attributes:
        people: all of them, the target pedestrian included.
        running: share of them that runs at 6 km/h.
        crossing: share of them that crosses the road unexpectedly.
        orderly: how many others use the crosswalk.
    """

    people: int
    running: float
    crossing: float
    orderly: int


TRAFFIC: dict[Traffic, TrafficLevel] = {
    "low": TrafficLevel(10, 0.0, 0.0, 2),
    "medium": TrafficLevel(25, 0.2, 0.2, 3),
    "high": TrafficLevel(50, 0.4, 0.4, 4),
}


@dataclass(frozen=True)
class Manners:
    """When people step out, so that whoever pays attention can stop in time.

    A person steps out when ego, at its present speed v, is farther away than
    v · reaction + v² / (2 · braking) + margin. People rely on ego to brake.

    Attributes:
        reaction: time that people grant ego before it brakes, in s.
        braking: deceleration that they trust ego to have, in m/s².
        margin: distance that they want to be left, in m.
    """

    reaction: float
    braking: float
    margin: float

    def stopping_distance(self, speed: float) -> float:
        """Return how far ego is trusted to need at most, in m, from `speed` in m/s."""
        return speed * self.reaction + speed**2 / (2.0 * self.braking) + self.margin


# At the kerb people want ego to stop without effort; half a metre beside ego's way it is enough
# if ego can stop by braking well below its limit of 8 m/s².
AT_KERB = Manners(reaction=1.2, braking=3.5, margin=2.5)
BESIDE_LANE = Manners(reaction=0.4, braking=6.0, margin=0.8)
# The target pedestrian grants time, not distance, drawn for each episode. Whoever passes what hides
# it at 10 km/h can stop even so; whoever comes at 40 and reacts only to what shows can't always.
RASH_REACTION = (0.2, 0.8)  # s

_KERB_STAND = 0.35  # m from the kerb, where people wait
_CLEARANCE = 0.5  # m between ego and a person who waits beside its way
_EAGERNESS = (1.2, 2.4)  # m by which the target steps out sooner than it must
_STRIDE = 1.35  # m, of both legs together
_TURNING = 6.0  # rad/s
_LATEST_CROSSING = 24.0  # s after the start; later the street is calm
_YIELDING = 0.5  # m/s; slower than this, ego is taken to give way …
_YIELDING_WITHIN = 12.0  # … when it is not farther away than this, in m


@dataclass(frozen=True)
class Corridor:
    """The strip of road that ego sweeps.

    Attributes:
        centre: y of ego's centre line, in m.
        width: of ego's body, in m.
        margin: on each side, besides a person's radius, in m.
        horizon: for how long people's courses are followed, in s.
    """

    centre: float
    width: float
    margin: float = 0.3
    horizon: float = 4.0

    def distances(self, fronts: Array, positions: Array, velocities: Array) -> Array:
        """Return how far ego's front bumper is from everyone who is, or will be, in the way.

        Args:
            fronts: float (S,), x of the bumper at S instants, in m.
            positions: float (S, N, 2), where the people are then, in m.
            velocities: float (N, 2), in m/s.

        Returns:
            float (S, N), in m, always positive; infinite for people behind the bumper and for
            those who neither stand in the corridor nor enter it in time on their present course.
        """
        ahead = positions[..., 0] - fronts[:, None]
        offset = positions[..., 1] - self.centre
        beyond = np.abs(offset) - (self.width / 2 + PERSON_RADIUS + self.margin)
        approach = -np.sign(offset) * velocities[:, 1]
        in_the_way = (ahead > 0.0) & (beyond <= np.maximum(approach, 0.0) * self.horizon)
        beside = np.maximum(np.abs(offset) - self.width / 2, 0.0)
        # Only a contact is 0, and that is for the physics to say.
        distance = np.maximum(np.hypot(ahead, beside) - PERSON_RADIUS, 0.01)
        return np.where(in_the_way, distance, np.inf)

    def times_to_collision(
        self, fronts: Array, speeds: Array, positions: Array, velocities: Array
    ) -> Array:
        """Return the time to collision with everyone whose path crosses ego's.

        Args:
            fronts: float (S,), x of the bumper at S instants, in m.
            speeds: float (S,), of ego then, in m/s.
            positions: float (S, N, 2), where the people are then, in m.
            velocities: float (N, 2), in m/s.

        Returns:
            float (S, N), in s; infinite for people who are elsewhere when ego gets there.
        """
        gaps = positions[..., 0] - PERSON_RADIUS - fronts[:, None]
        times = time_to_collision(gaps, speeds[:, None] - velocities[:, 0])
        arrived = np.isfinite(times)
        later = positions[..., 1] + velocities[:, 1] * np.where(arrived, times, 0.0)
        meets = np.abs(later - self.centre) <= self.width / 2 + PERSON_RADIUS
        return np.where(meets, times, np.inf)


class Walkers:
    """People who walk on as they do now, whatever comes.

    Arrays are replaced, never changed, so that a shallow copy is a copy.

    Args:
        positions: float (N, 2), x and y in m.
        velocities: float (N, 2), in m/s.

    Attributes:
        positions: float (N, 2), x and y in m.
        velocities: float (N, 2), in m/s, constant between two calls of `decide`.
        headings: float (N,), in rad from the x axis.
        phases: float (N,), of the stride, in rad.
    """

    def __init__(self, positions: Array, velocities: Array) -> None:
        self.positions = positions
        self.velocities = velocities
        self.headings = np.arctan2(velocities[:, 1], velocities[:, 0])
        self.phases = np.zeros(len(positions))

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def speeds(self) -> Array:
        """Speeds, in m/s, float (N,)."""
        return np.hypot(self.velocities[:, 0], self.velocities[:, 1])

    def decide(self, ego: Ego, dt: float) -> None:
        """Let everyone choose a velocity, knowing where ego is and how fast.

        Args:
            ego: its present state.
            dt: time until they decide again, in s.
        """

    def paths(self, times: Array) -> Array:
        """Return where everyone is after these times from now, in s: float (S, N, 2), in m."""
        return self.positions + times[:, None, None] * self.velocities

    def advance(self, dt: float) -> None:
        """Walk on with the velocities that were decided.

        Args:
            dt: in s.
        """
        speeds = self.speeds
        self.positions = self.positions + self.velocities * dt
        self.phases = np.mod(self.phases + 2 * np.pi * speeds * dt / _STRIDE, 2 * np.pi)
        courses = np.arctan2(self.velocities[:, 1], self.velocities[:, 0])
        turns = np.mod(courses - self.headings + np.pi, 2 * np.pi) - np.pi
        # np.clip takes several times as long.
        turns = np.minimum(np.maximum(turns, -_TURNING * dt), _TURNING * dt)
        self.headings = np.where(speeds > 0.05, self.headings + turns, self.headings)


class Pedestrians(Walkers):
    """All people of an episode; at index 0 the target pedestrian, who crosses before ego.

    Everyone walks along a sidewalk; some turn to the road at a line of their own and cross it.
    They wait at the kerb, and once more beside ego's lane, until they trust ego to be able to
    stop; then they go, relying on ego to brake. The target also waits for ego to come near.

    Args:
        level: how many, and what they do.
        behaviour: what the target does before it crosses; None where there is no target.
        rng: source of chance; used only here, so that an episode is decided at its start.
        street: where things are.
        corridor: the strip of road that ego sweeps.
    """

    def __init__(
        self,
        level: TrafficLevel,
        behaviour: Behaviour | None,
        rng: Generator,
        street: StreetGeometry,
        corridor: Corridor,
    ) -> None:
        count = level.people
        self._street = street
        self._lane = corridor.centre
        self._passing = corridor.width / 2 + PERSON_RADIUS
        self._crossing = np.zeros(count, np.bool_)
        self._paces = np.clip(rng.normal(1.3, 0.15, count), 1.0, 1.6)
        others = 1 + rng.permutation(count - 1)
        self._paces[rng.permutation(others)[: round(level.running * count)]] = RUNNING_PACE
        self._directions = rng.choice([-1.0, 1.0], count)
        self._sides = rng.choice([-1.0, 1.0], count)
        depths = rng.uniform(1.0, street.sidewalk_width - 0.5, count)
        self._near_tracks, self._far_tracks = street.near_kerb - depths, street.far_kerb + depths
        # The x where a person turns to the road; nan for those who never cross.
        self._lines = np.full(count, np.nan)
        self._target_manners = BESIDE_LANE
        self._eagerness = 0.0
        self.positions = np.zeros((count, 2))
        self.positions[:, 0] = rng.uniform(4.0, street.length + 4.0, count)
        crossing = round(level.crossing * count)
        self._schedule_crossings(others[:crossing], others[crossing:][: level.orderly], rng)
        self.positions[:, 1] = self._tracks(self._sides)
        if behaviour is not None:
            self._place_target(behaviour, rng)
        super().__init__(self.positions, np.zeros((count, 2)))
        self.headings = np.where(self._directions > 0, 0.0, np.pi)
        self.phases = rng.uniform(0.0, 2 * np.pi, count)

    def decide(self, ego: Ego, dt: float) -> None:
        """Let everyone choose a velocity; see `Walkers.decide`."""
        self._turn()
        # Whoever walks keeps to a track of their own; whoever crosses heads for the other side.
        aside = self._tracks(self._sides) - self.positions[:, 1]
        drift = np.minimum(np.maximum(aside, -0.3), 0.3)
        self.velocities = np.empty_like(self.positions)
        self.velocities[:, 0], self.velocities[:, 1] = self._directions * self._paces, drift
        for person in np.flatnonzero(self._crossing).tolist():
            held = self._has_to_wait(person, ego, dt)
            across = -self._sides[person] * self._paces[person]
            self.velocities[person] = 0.0, 0.0 if held else across

    def _schedule_crossings(
        self, unexpected: npt.NDArray[np.int64], orderly: npt.NDArray[np.int64], rng: Generator
    ) -> None:
        """Let people start where walking takes them to their line at a time of their own."""
        street = self._street
        before, after = street.crosswalk
        near_start = rng.uniform(14.0, before - 14.0, len(unexpected))
        near_goal = rng.uniform(after + 4.0, street.goal - 4.0, len(unexpected))
        self._lines[unexpected] = np.where(
            rng.random(len(unexpected)) < 0.65, near_start, near_goal
        )
        self._lines[orderly] = rng.uniform(before + 0.6, after - 0.6, len(orderly))
        chosen = np.concatenate([unexpected, orderly])
        walk = self._paces[chosen] * rng.uniform(0.5, _LATEST_CROSSING, len(chosen))
        lines, directions = self._lines[chosen], self._directions[chosen]
        off_street = lines - directions * walk < 2.0
        self._directions[chosen] = np.where(off_street, -directions, directions)
        self.positions[chosen, 0] = lines - self._directions[chosen] * walk

    def _place_target(self, behaviour: Behaviour, rng: Generator) -> None:
        street = self._street
        line = rng.uniform(street.crosswalk[0] + 1.2, street.crosswalk[1] - 0.8)
        approach, depth = rng.uniform(2.5, 4.0), rng.uniform(1.0, 1.5)
        self._paces[0] = rng.uniform(1.2, 1.5)
        self._sides[0], self._directions[0], self._lines[0] = -1.0, 1.0, line
        # How much farther away than it needs to stop ego may be when the target steps out.
        reaction = rng.uniform(*RASH_REACTION)
        self._target_manners = replace(BESIDE_LANE, reaction=reaction, braking=np.inf)
        self._eagerness = rng.uniform(*_EAGERNESS)
        if behaviour == "briefly_visible":
            self.positions[0] = line - approach, street.near_kerb - depth
        else:
            self.positions[0] = line, street.near_kerb - _KERB_STAND - 0.05

    def _turn(self) -> None:
        """Turn round at the ends of the street, to the road at the line, and to walk after it."""
        x, y = self.positions.T
        outward = np.where(self._directions > 0, x > self._street.length + 6.0, x < 2.0)
        self._directions = np.where(outward, -self._directions, self._directions)
        starts = ~self._crossing & (self._directions * (x - self._lines) >= 0.0)
        arrives = self._crossing & (self._sides * (y - self._tracks(-self._sides)) <= 0.0)
        self._crossing = self._crossing ^ (starts | arrives)
        if arrives.any():
            self._sides = np.where(arrives, -self._sides, self._sides)
            self._lines = np.where(arrives, np.nan, self._lines)

    def _has_to_wait(self, person: int, ego: Ego, dt: float) -> bool:
        """Tell whether one who crosses stops at the kerb, beside ego's lane, or before ego itself.

        Few cross at a time, and numbers of one person are faster than arrays of all.
        """
        x, y = self.positions[person].tolist()
        if x + PERSON_RADIUS + _CLEARANCE < ego.rear:
            return False
        side, stride = float(self._sides[person]), float(self._paces[person]) * dt
        gap = x - PERSON_RADIUS - ego.position
        kerb = self._street.far_kerb if side > 0.0 else self._street.near_kerb
        to_kerb = side * (y - kerb) - _KERB_STAND
        to_lane = side * (y - self._lane) - self._passing - _CLEARANCE
        if 0.0 < to_kerb <= stride and not self._trusts(person, ego, gap, to_lane):
            return True
        if 0.0 < to_lane <= stride and gap < self._room_beside_lane(person, ego.speed):
            return True
        # In the last half metre nobody walks into a car that stands or passes there.
        return -_CLEARANCE <= to_lane <= 0.0 and gap < 0.0

    def _trusts(self, person: int, ego: Ego, gap: float, to_lane: float) -> bool:
        """Tell whether ego is as far away, in m, as one wants who steps off the kerb."""
        if person != 0:
            return gap >= AT_KERB.stopping_distance(ego.speed)
        # The target acts on the distance that ego will have when it reaches ego's lane.
        stroll = ego.speed * to_lane / float(self._paces[0])
        nearest = self._room_beside_lane(0, ego.speed) + stroll
        yields = ego.speed < _YIELDING
        farthest = _YIELDING_WITHIN if yields else nearest + self._eagerness
        return nearest <= gap <= farthest

    def _room_beside_lane(self, person: int, speed: float) -> float:
        """Return how near ego may be, in m, for one to step before it from beside its lane."""
        manners = BESIDE_LANE if person != 0 else self._target_manners
        return manners.stopping_distance(speed)

    def _tracks(self, sides: Array) -> Array:
        """Return the y of everyone's track on these sides of the street."""
        return np.where(sides > 0, self._far_tracks, self._near_tracks)
