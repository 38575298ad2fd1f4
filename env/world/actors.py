"""Who moves: ego's longitudinal model, and the pedestrians as arrays, moved by compiled kernels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from env.world.cells import Traffic
from env.world.compiled import kernel, part
from env.world.world import PERSON_RADIUS, StreetGeometry

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
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
        (state,) = self.course(action, dt, 1).tolist()
        return Ego(self.parameters, *state)

    def course(self, action: float, dt: float, steps: int) -> Array:
        """Return what follows from the same action for some steps of explicit integration.

        Args:
            action: throttle above 0, brake below, in [-1, 1].
            dt: length of a step, in s.
            steps: S, how many.

        Returns:
            float (S, 3): position, speed and force after each.
        """
        car = self.parameters
        wanted = action * (car.drive if action > 0.0 else car.brake)
        forces = _Forces(wanted, min(dt / car.lag, 1.0), car.drag, 2.0, car.rolling)
        return _course((self.position, self.speed, self.force), tuple(forces), dt, steps)


class _Forces(NamedTuple):
    """What moves ego during a step, as of `EgoParameters`.

    Attributes:
        wanted: what the force comes nearer to, in m/s².
        share: of the way there, in a step.
        drag: coefficient of air drag, in 1/m.
        exponent: of the speed in the drag, 2. A constant would be compiled to a product, whose last
            bit may differ from that of Python's power.
        rolling: deceleration by the wheels, in m/s².
    """

    wanted: float
    share: float
    drag: float
    exponent: float
    rolling: float


@kernel
def _course(state: tuple[float, ...], pull: tuple[float, ...], dt: float, steps: int) -> Array:
    """Integrate the longitudinal model; see `Ego.course`.

    Args:
        state: position, speed and force at first.
        pull: `_Forces` of all steps.
        dt: length of a step, in s.
        steps: S, how many.

    Returns:
        float (S, 3): position, speed and force after each.
    """
    forces, (position, speed, force) = _Forces(*pull), state
    states = np.empty((steps, 3))
    for step in range(steps):
        force = force + (forces.wanted - force) * forces.share
        drag = forces.drag * math.pow(speed, forces.exponent)
        faster = max(speed + (force - drag - forces.rolling) * dt, 0.0)
        position = position + 0.5 * (speed + faster) * dt
        speed = faster
        states[step, 0], states[step, 1], states[step, 2] = position, speed, force
    return states


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


class Corridor(NamedTuple):
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
        """Return how far ego's front bumper is from the nearest who is, or will be, in the way.

        Args:
            fronts: float (S,), x of the bumper at S instants, in m.
            positions: float (S, N, 2), where the people are then, in m.
            velocities: float (N, 2), in m/s.

        Returns:
            float (S,), in m, always positive; infinite where all people are behind the bumper, or
            neither stand in the corridor nor enter it in time on their present course.
        """
        return _distances(tuple(self), fronts, positions, velocities)

    def times_to_collision(
        self, fronts: Array, speeds: Array, positions: Array, velocities: Array
    ) -> Array:
        """Return the least time to collision with anyone whose path crosses ego's.

        It is gap / closing speed, infinite where nothing closes: at rest, when moving apart, and
        for who is passed already.

        Args:
            fronts: float (S,), x of the bumper at S instants, in m.
            speeds: float (S,), of ego then, in m/s.
            positions: float (S, N, 2), where the people are then, in m.
            velocities: float (N, 2), in m/s.

        Returns:
            float (S,), in s; infinite where all people are elsewhere when ego gets there.

        Source: paper, section "Model Evaluation".
        """
        return _times_to_collision(tuple(self), fronts, speeds, positions, velocities)

    def alongside(
        self, fronts: Array, positions: Array, length: float, reach: float
    ) -> npt.NDArray[np.int64]:
        """Return who is within reach of ego's body, or nearly so, and when.

        Args:
            fronts: float (S,), x of the bumper at S instants, in m.
            positions: float (S, N, 2), where the people are then, in m.
            length: of ego's body, in m.
            reach: on each side of the body, in m.

        Returns:
            int64 (K, 2), instants and people, in this order.
        """
        return _alongside(tuple(self), fronts, positions, length, reach)


@kernel
def _distances(
    strip: tuple[float, ...], fronts: Array, positions: Array, velocities: Array
) -> Array:
    """Return the distance to the nearest in the way at each instant; see `Corridor.distances`."""
    corridor = Corridor(*strip)
    half, nearest = corridor.width / 2, np.full(len(fronts), np.inf)
    for instant in range(len(fronts)):
        for person in range(len(velocities)):
            ahead = positions[instant, person, 0] - fronts[instant]
            offset = positions[instant, person, 1] - corridor.centre
            beyond = abs(offset) - (half + PERSON_RADIUS + corridor.margin)
            approach = -np.sign(offset) * velocities[person, 1]
            if ahead > 0.0 and beyond <= max(approach, 0.0) * corridor.horizon:
                beside = max(abs(offset) - half, 0.0)
                # Only a contact is 0, and that is for the physics to say.
                distance = max(math.hypot(ahead, beside) - PERSON_RADIUS, 0.01)
                nearest[instant] = min(nearest[instant], distance)
    return nearest


@kernel
def _times_to_collision(
    strip: tuple[float, ...], fronts: Array, speeds: Array, positions: Array, velocities: Array
) -> Array:
    """Return the least time at each instant; see `Corridor.times_to_collision`."""
    corridor = Corridor(*strip)
    reach, least = corridor.width / 2 + PERSON_RADIUS, np.full(len(fronts), np.inf)
    for instant in range(len(fronts)):
        for person in range(len(velocities)):
            gap = positions[instant, person, 0] - PERSON_RADIUS - fronts[instant]
            closing = speeds[instant] - velocities[person, 0]
            if closing > 0.0 and gap >= 0.0:
                time = gap / closing
                later = positions[instant, person, 1] + velocities[person, 1] * time
                if abs(later - corridor.centre) <= reach:
                    least[instant] = min(least[instant], time)
    return least


@kernel
def _alongside(
    strip: tuple[float, ...], fronts: Array, positions: Array, length: float, reach: float
) -> npt.NDArray[np.int64]:
    """Return instants and people, (K, 2); see `Corridor.alongside`."""
    corridor = Corridor(*strip)
    instants, people, _ = positions.shape
    found, count = np.empty((instants * people, 2), np.int64), 0
    for instant in range(instants):
        first, last = fronts[instant] - length - reach, fronts[instant] + reach
        for person in range(people):
            offset = positions[instant, person, 1] - corridor.centre
            beside = abs(offset) < corridor.width / 2 + reach
            if beside and first < positions[instant, person, 0] < last:
                found[count, 0], found[count, 1] = instant, person
                count += 1
    return found[:count]


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
        courses = np.arctan2(self.velocities[:, 1], self.velocities[:, 0])
        poses = self.positions, self.headings, self.phases
        self.positions, self.headings, self.phases = _walk(
            poses, self.velocities, courses, float(dt)
        )


@kernel
def _walk(
    poses: tuple[Array, Array, Array], velocities: Array, courses: Array, dt: float
) -> tuple[Array, Array, Array]:
    """Return where everyone is, faces and strides after some time.

    Args:
        poses: positions, float (N, 2), in m; headings and phases, float (N,), in rad.
        velocities: float (N, 2), in m/s.
        courses: float (N,), their directions, in rad; people turn to them.
        dt: in s.

    Returns:
        The poses then.
    """
    positions, headings, phases = poses
    walked, faced, strode = np.empty_like(positions), headings.copy(), np.empty_like(phases)
    for person in range(len(positions)):
        speed = math.hypot(velocities[person, 0], velocities[person, 1])
        for axis in range(2):
            walked[person, axis] = positions[person, axis] + velocities[person, axis] * dt
        strode[person] = (phases[person] + 2 * np.pi * speed * dt / _STRIDE) % (2 * np.pi)
        if speed > 0.05:
            turn = (courses[person] - headings[person] + np.pi) % (2 * np.pi) - np.pi
            faced[person] += min(max(turn, -_TURNING * dt), _TURNING * dt)
    return walked, faced, strode


class _Habits(NamedTuple):
    """What somebody keeps for an episode, each float (N,).

    Attributes:
        paces: in m/s.
        near_tracks: y of their way along the sidewalk on ego's side, in m.
        far_tracks: y of that on the other.
    """

    paces: Array
    near_tracks: Array
    far_tracks: Array


class _Courses(NamedTuple):
    """Where people are bound, each (N,).

    Attributes:
        crossing: whether they cross the road.
        directions: 1 for those who walk along x, -1 against it.
        sides: 1 for the far side of the street, -1 for the near one.
        lines: the x where they turn to the road; nan for those who never cross.
    """

    crossing: Flags
    directions: Array
    sides: Array
    lines: Array


class _Road(NamedTuple):
    """What people cross, in m.

    Attributes:
        end: x where they turn round.
        near_kerb: y of the kerb on ego's side.
        far_kerb: y of the other.
        lane: y of ego's centre line.
        passing: from there to where ego's body touches nobody.
    """

    end: float
    near_kerb: float
    far_kerb: float
    lane: float
    passing: float


class _Threat(NamedTuple):
    """Ego as people see it, in m and m/s.

    Attributes:
        front: x of its front bumper.
        rear: x of the other.
        speed: of it.
        at_kerb: how far away one wants it who steps off the kerb.
        beside_lane: how far who stands beside its lane.
        before_target: how far the target does.
        eagerness: how much farther away it may be when the target steps out.
        dt: time until people choose again, in s.
    """

    front: float
    rear: float
    speed: float
    at_kerb: float
    beside_lane: float
    before_target: float
    eagerness: float
    dt: float


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
        self._road = _Road(
            street.length + 6.0,
            street.near_kerb,
            street.far_kerb,
            corridor.centre,
            corridor.width / 2 + PERSON_RADIUS,
        )
        paces = np.clip(rng.normal(1.3, 0.15, count), 1.0, 1.6)
        others = 1 + rng.permutation(count - 1)
        paces[rng.permutation(others)[: round(level.running * count)]] = RUNNING_PACE
        directions = rng.choice([-1.0, 1.0], count)
        sides = rng.choice([-1.0, 1.0], count)
        depths = rng.uniform(1.0, street.sidewalk_width - 0.5, count)
        self._habits = _Habits(paces, street.near_kerb - depths, street.far_kerb + depths)
        nobody, nowhere = np.zeros(count, np.bool_), np.full(count, np.nan)
        self._courses = _Courses(nobody, directions, sides, nowhere)
        self._target_manners = BESIDE_LANE
        self._eagerness = 0.0
        self.positions = np.zeros((count, 2))
        self.positions[:, 0] = rng.uniform(4.0, street.length + 4.0, count)
        crossing = round(level.crossing * count)
        self._schedule_crossings(others[:crossing], others[crossing:][: level.orderly], rng)
        habits = self._habits
        self.positions[:, 1] = np.where(sides > 0, habits.far_tracks, habits.near_tracks)
        if behaviour is not None:
            self._place_target(behaviour, rng)
        super().__init__(self.positions, np.zeros((count, 2)))
        self.headings = np.where(self._courses.directions > 0, 0.0, np.pi)
        self.phases = rng.uniform(0.0, 2 * np.pi, count)

    def decide(self, ego: Ego, dt: float) -> None:
        """Let everyone choose a velocity; see `Walkers.decide`."""
        threat = _Threat(
            ego.position,
            ego.rear,
            ego.speed,
            AT_KERB.stopping_distance(ego.speed),
            BESIDE_LANE.stopping_distance(ego.speed),
            self._target_manners.stopping_distance(ego.speed),
            self._eagerness,
            float(dt),
        )
        self.velocities, crossing, directions, sides, lines = _choose(
            self.positions,
            tuple(self._habits),
            tuple(self._courses),
            tuple(self._road),
            tuple(threat),
        )
        self._courses = _Courses(crossing, directions, sides, lines)

    def _schedule_crossings(
        self, unexpected: npt.NDArray[np.int64], orderly: npt.NDArray[np.int64], rng: Generator
    ) -> None:
        """Let people start where walking takes them to their line at a time of their own."""
        street = self._street
        before, after = street.crosswalk
        near_start = rng.uniform(14.0, before - 14.0, len(unexpected))
        near_goal = rng.uniform(after + 4.0, street.goal - 4.0, len(unexpected))
        paces, (_, directions, _, lines) = self._habits.paces, self._courses
        lines[unexpected] = np.where(rng.random(len(unexpected)) < 0.65, near_start, near_goal)
        lines[orderly] = rng.uniform(before + 0.6, after - 0.6, len(orderly))
        chosen = np.concatenate([unexpected, orderly])
        walk = paces[chosen] * rng.uniform(0.5, _LATEST_CROSSING, len(chosen))
        off_street = lines[chosen] - directions[chosen] * walk < 2.0
        directions[chosen] = np.where(off_street, -directions[chosen], directions[chosen])
        self.positions[chosen, 0] = lines[chosen] - directions[chosen] * walk

    def _place_target(self, behaviour: Behaviour, rng: Generator) -> None:
        street = self._street
        line = rng.uniform(street.crosswalk[0] + 1.2, street.crosswalk[1] - 0.8)
        approach, depth = rng.uniform(2.5, 4.0), rng.uniform(1.0, 1.5)
        self._habits.paces[0] = rng.uniform(1.2, 1.5)
        courses = self._courses
        courses.sides[0], courses.directions[0], courses.lines[0] = -1.0, 1.0, line
        # How much farther away than it needs to stop ego may be when the target steps out.
        reaction = rng.uniform(*RASH_REACTION)
        self._target_manners = replace(BESIDE_LANE, reaction=reaction, braking=np.inf)
        self._eagerness = rng.uniform(*_EAGERNESS)
        if behaviour == "briefly_visible":
            self.positions[0] = line - approach, street.near_kerb - depth
        else:
            self.positions[0] = line, street.near_kerb - _KERB_STAND - 0.05


@kernel
def _choose(
    positions: Array,
    kept: tuple[Array, ...],
    courses: tuple[Any, ...],
    crossed: tuple[float, ...],
    approach: tuple[float, ...],
) -> tuple[Array, Flags, Array, Array, Array]:
    """Let everyone choose a velocity.

    Args:
        positions: float (N, 2), in m.
        kept: the `_Habits`.
        courses: `_Courses`, where people were bound.
        crossed: the `_Road`.
        approach: the `_Threat`.

    Returns:
        Velocities, float (N, 2), in m/s, and where people are bound now, as of `_Courses`.
    """
    habits, road, threat = _Habits(*kept), _Road(*crossed), _Threat(*approach)
    crossing, directions, sides, lines = courses
    bound = _Courses(crossing.copy(), directions.copy(), sides.copy(), lines.copy())
    velocities = np.empty_like(positions)
    for person in range(len(positions)):
        place = positions[person, 0], positions[person, 1]
        _turn(bound, habits, road, person, place)
        side, pace = bound.sides[person], habits.paces[person]
        if bound.crossing[person]:
            # Whoever crosses heads for the other side.
            held = _has_to_wait(person, place, (side, pace), road, threat)
            velocities[person, 0] = 0.0
            velocities[person, 1] = 0.0 if held else -side * pace
        else:
            # Whoever walks keeps to a track of their own.
            aside = _track(habits, person, side) - place[1]
            velocities[person, 0] = bound.directions[person] * pace
            velocities[person, 1] = min(max(aside, -0.3), 0.3)
    return velocities, bound.crossing, bound.directions, bound.sides, bound.lines


@part
def _turn(
    bound: _Courses, habits: _Habits, road: _Road, person: int, place: tuple[float, float]
) -> None:
    """Turn round at the ends of the street, to the road at the line, and to walk after it."""
    x, y = place
    direction, side = bound.directions[person], bound.sides[person]
    if (direction > 0.0 and x > road.end) or (direction < 0.0 and x < 2.0):
        direction = -direction
        bound.directions[person] = direction
    if bound.crossing[person]:
        if side * (y - _track(habits, person, -side)) <= 0.0:
            bound.crossing[person] = False
            bound.sides[person], bound.lines[person] = -side, np.nan
    elif direction * (x - bound.lines[person]) >= 0.0:
        bound.crossing[person] = True


@part
def _track(habits: _Habits, person: int, side: float) -> float:
    """Return the y of one's track on a side of the street."""
    return habits.far_tracks[person] if side > 0.0 else habits.near_tracks[person]


@part
def _has_to_wait(
    person: int,
    place: tuple[float, float],
    gait: tuple[float, float],
    road: _Road,
    threat: _Threat,
) -> bool:
    """Tell whether one who crosses stops at the kerb, beside ego's lane, or before ego itself.

    Args:
        person: who.
        place: x and y, in m.
        gait: the side that one comes from, and one's pace in m/s.
        road: what one crosses.
        threat: ego.
    """
    (x, y), (side, pace) = place, gait
    if x + PERSON_RADIUS + _CLEARANCE < threat.rear:
        return False
    stride, gap = pace * threat.dt, x - PERSON_RADIUS - threat.front
    kerb = road.far_kerb if side > 0.0 else road.near_kerb
    to_kerb = side * (y - kerb) - _KERB_STAND
    to_lane = side * (y - road.lane) - road.passing - _CLEARANCE
    if 0.0 < to_kerb <= stride and not _trusts(person, pace, gap, to_lane, threat):
        return True
    # How near ego may be for one to step before it from beside its lane.
    room = threat.beside_lane if person != 0 else threat.before_target
    if 0.0 < to_lane <= stride and gap < room:
        return True
    # In the last half metre nobody walks into a car that stands or passes there.
    return -_CLEARANCE <= to_lane <= 0.0 and gap < 0.0


@part
def _trusts(person: int, pace: float, gap: float, to_lane: float, threat: _Threat) -> bool:
    """Tell whether ego is as far away, in m, as one wants who steps off the kerb."""
    if person != 0:
        return gap >= threat.at_kerb
    # The target acts on the distance that ego will have when it reaches ego's lane.
    nearest = threat.before_target + threat.speed * to_lane / pace
    yields = threat.speed < _YIELDING
    farthest = _YIELDING_WITHIN if yields else nearest + threat.eagerness
    return nearest <= gap <= farthest
