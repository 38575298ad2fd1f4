"""Drivers do what they are for, and look at nothing else than they say."""

from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest

import sfol
from env.driving.drivers import DRIVERS, Cautious, Crawl, Oracle, TTCBrake
from env.driving.rollout import rollout
from env.evaluation.evaluate import Drive, evaluate, summarize
from env.evaluation.parallel import cores
from env.street.crossing import OccludedCrossing
from env.world.cells import CELLS


@pytest.fixture(scope="module")
def fast_street():
    """A street without camera: what is seen is found by rays."""
    street = OccludedCrossing(
        traffic="medium", occlusion="full", perception="truth", observation="state"
    )
    yield street
    street.close()


@pytest.fixture(scope="module")
def empty_street():
    """A street with people where a test puts them, who stay there."""
    street = OccludedCrossing(
        traffic="low", occlusion="full", perception="truth", observation="state"
    )
    yield street
    street.close()


def place(street, people=(), speed=0.0, position=0.0):
    """Reset the street with these people, (x, y from ego's centre line), and nobody else about."""
    street.reset(seed=0)
    positions = np.tile([-20.0, -8.0], (len(street.people), 1))
    for index, (x, y) in enumerate(people):
        positions[index] = x, street.corridor.centre + y
    street.people.positions = positions
    street.people.velocities = np.zeros_like(positions)
    street.people.decide = lambda ego, dt: None
    street.ego = type(street.ego)(street.ego.parameters, position, speed)
    street._look()
    return street


def last(street, driver, seed):
    *_, transition = rollout(street, driver, seed)
    return transition


def test_the_cautious_driver_reaches_the_goal_by_the_camera(street_of):
    assert last(street_of("low", "full"), Cautious(), seed=11).ending == "success"


@pytest.mark.parametrize("name", ["cautious", "oracle"])
def test_careful_drivers_reach_the_goal(fast_street, name):
    driver = DRIVERS[name]()
    for seed in (20, 21):
        assert last(fast_street, driver, seed).ending == "success"


@pytest.mark.parametrize("name", ["never_moves", "crawl"])
def test_who_never_arrives_runs_out_of_time(fast_street, name):
    transition = last(fast_street, DRIVERS[name](), seed=20)
    assert transition.ending == "timeout"
    assert transition.info["position"] <= 31.0


def test_drivers_go_by_name():
    names = {"full_throttle", "never_moves", "crawl", "ttc_brake", "cautious", "oracle"}
    assert set(DRIVERS) == names
    for make in DRIVERS.values():
        assert make.__doc__
        make().reset()


def test_crawl_keeps_to_its_pace(empty_street):
    street = place(empty_street)
    for _ in range(40):
        street.step(np.array([Crawl()(street)], np.float32))
    assert street.ego.speed == pytest.approx(0.5, abs=0.01)


def test_the_cautious_driver_stops_before_somebody_on_the_road(empty_street):
    street = place(empty_street, [(30.0, 0.0)])
    for _ in range(120):
        street.step(np.array([Cautious()(street)], np.float32))
    assert street.ego.speed < 0.1
    assert 26.0 < street.ego.position < 29.5


@pytest.mark.parametrize(
    ("people", "speed", "brakes"),
    [
        ([], 10.0, False),
        ([(30.0, 0.0)], 10.0, True),  # a second away
        ([(60.0, 0.0)], 10.0, False),  # far away
        ([(30.0, 0.0)], 2.0, False),  # far away at this speed
        ([(30.0, 3.0)], 10.0, False),  # on the road beside the corridor
        ([(22.0, 0.0)], 0.0, True),  # right before the bumper
    ],
)
def test_the_ttc_brake_brakes_for_who_is_near_in_time_and_in_the_way(
    empty_street, people, speed, brakes
):
    street = place(empty_street, people, speed, position=20.0)
    assert TTCBrake()(street) == (-1.0 if brakes else 1.0)


def test_the_ttc_brake_does_not_see_who_is_hidden(empty_street):
    near_kerb = empty_street.world.geometry.near_kerb
    street = place(empty_street, [(61.0, near_kerb + 1.0 - empty_street.corridor.centre)])
    street.ego = type(street.ego)(street.ego.parameters, 45.0, 10.0)
    street._look()
    assert not [e for e in street.scene.entities if e.name.startswith("pedestrian")]
    assert TTCBrake(margin=5.0)(street) == 1.0


@pytest.mark.parametrize("driver", [TTCBrake(), Cautious()], ids=["ttc_brake", "cautious"])
def test_drivers_by_camera_look_at_nothing_but_the_camera_and_their_speed(fast_street, driver):
    street = fast_street
    street.reset(seed=20)
    for _ in range(60):
        shown = SimpleNamespace(
            scene=street.scene,
            lens=street.lens,
            ego=SimpleNamespace(speed=street.ego.speed, parameters=street.ego.parameters),
            corridor=SimpleNamespace(width=street.corridor.width),
            pipeline=SimpleNamespace(grounding=street.pipeline.grounding),
        )
        action = driver(shown)
        assert action == driver(street)
        street.step(np.array([action], np.float32))


def test_the_oracle_changes_nothing_by_looking(fast_street):
    street = fast_street
    street.reset(seed=20)
    for _ in range(50):
        before = street.people.positions.copy(), street.people.velocities.copy(), street.ego
        action = Oracle()(street)
        assert np.array_equal(before[0], street.people.positions)
        assert np.array_equal(before[1], street.people.velocities)
        assert before[2] == street.ego
        street.step(np.array([action], np.float32))


def test_the_oracle_knows_who_is_hidden(empty_street):
    """Somebody will step out from behind the truck, and nobody could see it."""
    speeds = [t.info["speed"] for t in rollout(empty_street, Oracle(), seed=0)]
    assert min(speeds[30:]) < 0.8 * max(speeds)


@pytest.mark.long
@pytest.mark.parametrize("cell", CELLS, ids=str)
def test_every_episode_can_be_survived_and_many_are_not_by_luck(cell):
    """Fair: who knows everything always gets through, and soon. Hard: who looks at nothing, or
    only reacts to what shows, often doesn't."""
    kb = sfol.KnowledgeBase.load("crossing")
    names = ("oracle", "full_throttle", "ttc_brake", "crawl")
    drives = [Drive(name, cell, kb, episodes=60, seed=500, perception="truth") for name in names]
    driven = evaluate(drives, workers=cores())
    summaries = {name: summarize([e.result for e in islice(driven, 60)]) for name in names}
    assert summaries["oracle"].success.share == 1.0
    assert summaries["oracle"].time_to_goal.mean < 25.0
    assert summaries["full_throttle"].collision.share >= 0.3
    assert summaries["crawl"].timeout.share == 1.0
    if cell.occlusion == "full":
        assert summaries["ttc_brake"].collision.count > 0
