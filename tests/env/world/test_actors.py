"""How ego and people move, without a camera."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from env.world.actors import (
    AT_KERB,
    BESIDE_LANE,
    RASH_REACTION,
    RUNNING_PACE,
    TRAFFIC,
    Corridor,
    Ego,
    EgoParameters,
    Pedestrians,
    Walkers,
)
from env.world.world import StreetGeometry

STREET = StreetGeometry()
CAR = EgoParameters()
CORRIDOR = Corridor(STREET.ego_lane, CAR.width)
DT = 0.1


def crowd(traffic="high", behaviour="hidden", seed=0):
    rng = np.random.default_rng(seed)
    return Pedestrians(TRAFFIC[traffic], behaviour, rng, STREET, CORRIDOR)


def walk(people, ego_at, seconds):
    """Yield the people after each step, ego being where `ego_at(time)` puts it."""
    for step in range(round(seconds / DT)):
        people.decide(ego_at(step * DT), DT)
        people.advance(DT)
        yield people


def driven(action, seconds, ego=None):
    ego = ego or Ego()
    for _ in range(round(seconds * 100)):
        ego = ego.after(action, 0.01)
    return ego


def test_full_throttle_approaches_the_top_speed_and_never_exceeds_it():
    assert driven(1.0, 3.0).speed > 6.5
    assert 0.99 * CAR.top_speed < driven(1.0, 60.0).speed <= CAR.top_speed


def test_full_braking_takes_eight_metres_per_second_squared():
    fast = Ego(speed=10.0)
    stopped = driven(-1.0, 5.0, fast)
    assert stopped.speed == 0.0
    # 10²/(2·8) m and the lag of 0.15 s, less what drag and rolling do
    assert 6.0 < stopped.position < 10.0**2 / 16 + 10.0 * 0.15


def test_ego_never_reverses():
    assert driven(-1.0, 2.0) == Ego(force=driven(-1.0, 2.0).force)


def test_ego_rolls_to_a_stop():
    assert driven(0.0, 30.0, Ego(speed=2.0)).speed == 0.0


@pytest.mark.parametrize(("traffic", "count"), [("low", 10), ("medium", 25), ("high", 50)])
def test_traffic_has_the_paper_s_numbers(traffic, count):
    people, level = crowd(traffic), TRAFFIC[traffic]
    paces = people._habits.paces
    assert len(people) == count
    assert np.count_nonzero(paces == RUNNING_PACE) == round(level.running * count)
    target_and_orderly = 1 + level.orderly
    crossing = np.count_nonzero(~np.isnan(people._courses.lines))
    assert crossing == round(level.crossing * count) + target_and_orderly


@pytest.mark.parametrize("behaviour", ["briefly_visible", "hidden"])
def test_nobody_teleports(behaviour):
    for seed in range(5):
        people = crowd(behaviour=behaviour, seed=seed)
        before = people.positions
        for _ in walk(people, lambda t: Ego(position=5.0 * t, speed=5.0), 40.0):
            moved = np.linalg.norm(people.positions - before, axis=1)
            assert moved.max() <= np.hypot(RUNNING_PACE, 0.3) * DT + 1e-9
            before = people.positions


def test_people_stay_on_the_street():
    people = crowd()
    for _ in walk(people, lambda t: Ego(position=2.0 * t, speed=2.0), 60.0):
        x, y = people.positions.T
        assert STREET.start < x.min()
        assert x.max() < STREET.end
        assert STREET.near_wall < y.min()
        assert y.max() < STREET.far_wall


def test_crossings_end():
    """A driver who waits long enough finds the road free."""
    for seed in range(5):
        people = crowd(seed=seed)
        for _ in walk(people, lambda t: Ego(), 45.0):
            pass
        others = people.positions[1:]
        assert STREET.on_sidewalk(others[:, 1]).all()


def test_the_target_waits_for_ego():
    people = crowd("low", "hidden")
    start = people.positions[0]
    for _ in walk(people, lambda t: Ego(), 20.0):
        pass
    assert np.array_equal(people.positions[0], start)
    assert STREET.on_sidewalk(start[1:])


def test_the_target_crosses_before_a_slow_ego():
    people = crowd("low", "hidden")
    for _ in walk(people, lambda t: Ego(position=min(2.0 * t, 57.0), speed=2.0), 40.0):
        pass
    assert people.positions[0, 1] > STREET.far_kerb


def test_the_target_crosses_before_an_ego_that_gives_way():
    people = crowd("low", "hidden")
    for _ in walk(people, lambda t: Ego(position=52.0), 12.0):
        pass
    assert people.positions[0, 1] > STREET.far_kerb


def test_nobody_but_the_target_enters_the_lane_unless_ego_can_stop():
    """Whoever comes within half a metre of ego's way leaves ego its stopping distance."""
    entries = 0
    for seed in range(8):
        people, ego = crowd(seed=seed), Ego()
        line = CAR.width / 2 + 0.3 + 0.5
        beside = np.abs(people.positions[:, 1] - CORRIDOR.centre) <= line
        while ego.position < STREET.goal:
            people.decide(ego, DT)
            gaps = people.positions[:, 0] - 0.3 - ego.position
            need = BESIDE_LANE.stopping_distance(ego.speed)
            ego = driven(1.0, DT, ego)
            people.advance(DT)
            now = np.abs(people.positions[:, 1] - CORRIDOR.centre) <= line
            entered = now & ~beside & (gaps > -CAR.length)
            entered[0] = False
            assert (gaps[entered] >= need).all()
            entries += np.count_nonzero(entered)
            beside = now
    assert entries > 0


def test_the_stopping_distance_granted_is_one_that_ego_has():
    for speed in (2.0, 5.0, 8.0, CAR.top_speed):
        ego = driven(1.0, 0.2, Ego(speed=speed, force=CAR.drive))
        ego = driven(-1.0, 5.0, ego)
        assert ego.position < BESIDE_LANE.stopping_distance(speed)


def braking_distance(speed):
    """Return how far ego goes that drives on for a step and then brakes fully, in m."""
    ego = driven(1.0, DT, Ego(speed=speed, force=CAR.drive))
    return driven(-1.0, 5.0, ego).position


def test_the_target_leaves_room_to_a_slow_ego_and_not_always_to_a_fast_one():
    def least_room(speed):
        return RASH_REACTION[0] * speed + BESIDE_LANE.margin

    assert braking_distance(10 / 3.6) < least_room(10 / 3.6)
    assert braking_distance(40 / 3.6) > least_room(40 / 3.6)


def test_the_target_steps_before_ego_as_near_as_it_dares():
    grants = []
    for seed in range(30):
        people, ego = crowd("low", "hidden", seed), Ego()
        line = CAR.width / 2 + 0.3 + 0.5
        while ego.position < STREET.goal:
            people.decide(ego, DT)
            before = abs(people.positions[0, 1] - CORRIDOR.centre)
            gap, speed = people.positions[0, 0] - 0.3 - ego.position, ego.speed
            ego = driven(1.0, DT, ego)
            people.advance(DT)
            if before > line >= abs(people.positions[0, 1] - CORRIDOR.centre) and gap > 0:
                grants.append((gap - BESIDE_LANE.margin) / speed)
    assert min(grants) >= RASH_REACTION[0]
    assert max(grants) - min(grants) > 0.4
    assert len(grants) > 10


def test_where_there_is_no_target_and_nobody_crosses_everybody_stays_on_the_sidewalks():
    calm = replace(TRAFFIC["high"], crossing=0.0, orderly=0)
    people = Pedestrians(calm, None, np.random.default_rng(1), STREET, CORRIDOR)
    for _ in walk(people, lambda t: Ego(position=5.0 * t, speed=5.0), 30.0):
        assert STREET.on_sidewalk(people.positions[:, 1]).all()


def test_walkers_walk_on_whatever_comes():
    people = Walkers(np.array([[60.0, -8.0], [3.0, 4.0]]), np.array([[0.0, 1.4], [1.0, 0.0]]))
    for _ in walk(people, lambda t: Ego(position=60.0), 3.0):
        pass
    assert people.positions == pytest.approx(np.array([[60.0, -3.8], [6.0, 4.0]]))
    assert people.speeds == pytest.approx([1.4, 1.0])


def test_a_shallow_copy_of_people_walks_its_own_way():
    people = crowd()
    other = copy.copy(people)
    before = {name: np.copy(value) for name, value in vars(people).items() if is_array(value)}
    for _ in walk(other, lambda t: Ego(position=4.0 * t, speed=4.0), 30.0):
        pass
    assert all(np.array_equal(before[n], vars(people)[n], equal_nan=True) for n in before)
    assert not np.array_equal(people.positions, other.positions)


def is_array(value):
    return isinstance(value, np.ndarray)


def test_nobody_walks_into_a_standing_car():
    ego = Ego(position=63.0)
    for seed in range(5):
        people = crowd(seed=seed)
        for _ in walk(people, lambda t: ego, 30.0):
            x, y = people.positions.T
            inside = (x > ego.rear - 0.3) & (x < ego.position + 0.3)
            assert (np.abs(y - CORRIDOR.centre)[inside] > CAR.width / 2 + 0.3).all()


def at(x, y, vx=0.0, vy=0.0):
    return np.array([[[x, CORRIDOR.centre + y]]]), np.array([[vx, vy]])


@pytest.mark.parametrize(
    ("x", "y", "vy", "distance"),
    [
        (60.0, 0.0, 0.0, 9.7),  # in the corridor
        (60.0, 4.0, -1.0, np.hypot(10.0, 3.1) - 0.3),  # in it after 2.5 s
        (60.0, -4.0, 1.0, np.hypot(10.0, 3.1) - 0.3),  # from the other side
        (60.0, 4.0, 1.0, np.inf),  # walks away
        (60.0, 4.0, 0.0, np.inf),  # stands on the sidewalk
        (60.0, 6.0, -1.0, np.inf),  # in it after 4.5 s
        (49.0, 0.0, 0.0, np.inf),  # behind the bumper
        (50.2, 0.0, 0.0, 0.01),  # closer than any contact has been found
    ],
)
def test_distance_counts_who_is_or_will_be_in_the_way(x, y, vy, distance):
    positions, velocities = at(x, y, vy=vy)
    found = CORRIDOR.distances(np.array([50.0]), positions, velocities)
    assert found.item() == pytest.approx(distance)


@pytest.mark.parametrize(
    ("y", "vy", "speed", "ttc"),
    [
        (0.0, 0.0, 5.0, 9.7 / 5.0),
        (0.0, 0.0, 0.0, np.inf),  # at rest
        (3.0, -1.5, 5.0, 9.7 / 5.0),  # will be there
        (3.0, 0.0, 5.0, np.inf),  # stands beside
        (0.0, 1.5, 5.0, np.inf),  # will have left
    ],
)
def test_time_to_collision_counts_who_is_there_when_ego_is(y, vy, speed, ttc):
    positions, velocities = at(60.0, y, vy=vy)
    found = CORRIDOR.times_to_collision(np.array([50.0]), np.array([speed]), positions, velocities)
    assert found.item() == pytest.approx(ttc)


# The compiled functions, against plain Python and numpy, to the bit


def euler(ego, action, dt):
    car = ego.parameters
    wanted = action * (car.drive if action > 0.0 else car.brake)
    force = ego.force + (wanted - ego.force) * min(dt / car.lag, 1.0)
    acceleration = force - car.drag * ego.speed**2 - car.rolling
    speed = max(ego.speed + acceleration * dt, 0.0)
    return Ego(car, ego.position + 0.5 * (ego.speed + speed) * dt, speed, force)


@pytest.mark.parametrize("action", [-1.0, -0.3, 0.0, 0.7, 1.0])
def test_ego_s_course_is_explicit_integration(action):
    rng = np.random.default_rng(0)
    for speed, force in rng.uniform([0.0, -8.0], [12.0, 3.0], (100, 2)).tolist():
        ego = Ego(speed=speed, force=force)
        course = ego.course(action, 0.01, 50)
        assert ego.after(action, 0.01) == Ego(CAR, *course[0].tolist())
        for state in course.tolist():
            ego = euler(ego, action, 0.01)
            assert list(ego[1:]) == state


def reference_walk(people, dt):
    vx, vy = people.velocities.T
    speeds = np.hypot(vx, vy)
    phases = np.mod(people.phases + 2 * np.pi * speeds * dt / 1.35, 2 * np.pi)
    turns = np.mod(np.arctan2(vy, vx) - people.headings + np.pi, 2 * np.pi) - np.pi
    turned = people.headings + np.clip(turns, -6.0 * dt, 6.0 * dt)
    headings = np.where(speeds > 0.05, turned, people.headings)
    return people.positions + people.velocities * dt, headings, phases


def reference_choice(people, ego, dt):
    """Return velocities and courses, as the docstrings of `Pedestrians` and its helpers say."""
    (x, y), (paces, near, far) = people.positions.T, people._habits
    crossing, directions, sides, lines = people._courses
    outward = np.where(directions > 0, x > STREET.length + 6.0, x < 2.0)
    directions = np.where(outward, -directions, directions)
    starts = ~crossing & (directions * (x - lines) >= 0.0)
    arrives = crossing & (sides * (y - np.where(sides > 0, near, far)) <= 0.0)
    crossing = crossing ^ (starts | arrives)
    sides, lines = np.where(arrives, -sides, sides), np.where(arrives, np.nan, lines)

    gaps, lane = x - 0.3 - ego.position, CORRIDOR.centre
    to_kerb = sides * (y - np.where(sides > 0, STREET.far_kerb, STREET.near_kerb)) - 0.35
    to_lane = sides * (y - lane) - (CORRIDOR.width / 2 + 0.3) - 0.5
    rooms = np.full(len(people), BESIDE_LANE.stopping_distance(ego.speed))
    rooms[0] = people._target_manners.stopping_distance(ego.speed)
    trusts = gaps >= AT_KERB.stopping_distance(ego.speed)
    nearest = rooms[0] + ego.speed * to_lane[0] / paces[0]
    farthest = 12.0 if ego.speed < 0.5 else nearest + people._eagerness
    trusts[0] = nearest <= gaps[0] <= farthest
    waits = (to_kerb > 0.0) & (to_kerb <= paces * dt) & ~trusts
    waits |= (to_lane > 0.0) & (to_lane <= paces * dt) & (gaps < rooms)
    waits |= (to_lane >= -0.5) & (to_lane <= 0.0) & (gaps < 0.0)
    waits &= x + 0.3 + 0.5 >= ego.rear
    aside = np.clip(np.where(sides > 0, far, near) - y, -0.3, 0.3)
    across = np.where(waits, 0.0, -sides * paces)
    velocities = np.stack(
        [np.where(crossing, 0.0, directions * paces), np.where(crossing, across, aside)], axis=1
    )
    return velocities, (crossing, directions, sides, lines)


@pytest.mark.parametrize("traffic", ["low", "high"])
@pytest.mark.parametrize("behaviour", ["briefly_visible", "hidden"])
def test_people_choose_and_walk_as_in_plain_numpy(traffic, behaviour):
    for seed in range(3):
        people, ego = crowd(traffic, behaviour, seed), Ego(speed=6.0)
        for step in range(400):
            velocities, courses = reference_choice(people, ego, DT)
            people.decide(ego, DT)
            assert np.array_equal(people.velocities, velocities)
            for found, expected in zip(people._courses, courses, strict=True):
                assert np.array_equal(found, expected, equal_nan=True)
            poses = reference_walk(people, DT)
            people.advance(DT)
            for found, expected in zip(
                (people.positions, people.headings, people.phases), poses, strict=True
            ):
                assert np.array_equal(found, expected)
            ego = driven([0.5, -0.4, -1.0][step // 40 % 3], DT, ego)


def moments(seed):
    """Return fronts, speeds, positions and velocities of 5 instants and 30 people."""
    rng = np.random.default_rng(seed)
    fronts, speeds = rng.uniform(40.0, 50.0, 5), rng.choice([0.0, 3.0, 10.0], 5)
    positions = rng.uniform([35.0, -6.0], [70.0, 4.0], (5, 30, 2))
    velocities = rng.choice([-1.3, 0.0, 1.3, 5.0], (30, 2))
    return fronts, speeds, positions, velocities


@pytest.mark.parametrize("seed", range(20))
def test_the_corridor_measures_as_in_plain_numpy(seed):
    fronts, speeds, positions, velocities = moments(seed)
    x, offset = positions[..., 0], positions[..., 1] - CORRIDOR.centre
    ahead, half = x - fronts[:, None], CAR.width / 2
    approach = np.maximum(-np.sign(offset) * velocities[:, 1], 0.0)
    counts = (ahead > 0.0) & (np.abs(offset) - (half + 0.3 + 0.3) <= approach * 4.0)
    far = np.maximum(np.hypot(ahead, np.maximum(np.abs(offset) - half, 0.0)) - 0.3, 0.01)
    nearest = np.where(counts, far, np.inf).min(axis=1)
    assert np.array_equal(CORRIDOR.distances(fronts, positions, velocities), nearest)

    gaps, closing = x - 0.3 - fronts[:, None], speeds[:, None] - velocities[:, 0]
    closes = (closing > 0.0) & (gaps >= 0.0)
    times = np.divide(gaps, closing, out=np.full(gaps.shape, np.inf), where=closes)
    later = positions[..., 1] + velocities[:, 1] * np.where(closes, times, 0.0)
    meets = np.abs(later - CORRIDOR.centre) <= half + 0.3
    least = np.where(meets, times, np.inf).min(axis=1)
    found = CORRIDOR.times_to_collision(fronts, speeds, positions, velocities)
    assert np.array_equal(found, least)

    near = np.abs(offset) < half + 0.4
    near &= (x < fronts[:, None] + 0.4) & (x > fronts[:, None] - CAR.length - 0.4)
    assert near.any()
    assert np.array_equal(CORRIDOR.alongside(fronts, positions, CAR.length, 0.4), np.argwhere(near))


@pytest.mark.parametrize(("gap", "speed"), [(-1.0, 5.0), (5.0, 0.0), (5.0, -2.0)])
def test_nothing_collides_that_is_passed_or_moves_apart(gap, speed):
    positions, velocities = at(50.3 + gap, 0.0)
    found = CORRIDOR.times_to_collision(np.array([50.0]), np.array([speed]), positions, velocities)
    assert found.tolist() == [np.inf]


def test_nobody_is_nowhere():
    fronts, nobody = np.zeros(3), np.zeros((3, 0, 2))
    assert CORRIDOR.distances(fronts, nobody, np.zeros((0, 2))).tolist() == [np.inf] * 3
