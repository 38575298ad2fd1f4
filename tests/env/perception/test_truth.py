"""Perception without a picture says what the picture says, and sees no more than it shows."""

import numpy as np
import pytest

from env.driving.drivers import Cautious
from env.perception.truth import TruthPerception
from env.street.crossing import OccludedCrossing
from env.tools.agreement import SLACK, USEFUL_RANGE, claims, compare, sights, stopping_distance
from env.world.actors import EgoParameters, Walkers
from sfol.errors import UsageError
from vsr.classes import SemanticClass


@pytest.fixture(scope="module", params=["partial", "full"])
def street(request, street_of):
    street = street_of("low", request.param)
    street.reset(seed=1)
    return street


def facts_of(street, front, *people):
    """Return what the truth says with these people, (x, y) each, and nobody else."""
    positions = np.tile([-50.0, -8.0], (len(street.world.heights), 1))
    positions[: len(people)] = np.reshape(people, (-1, 2))
    walkers = Walkers(positions, np.zeros_like(positions))
    truth = TruthPerception(street.world, street.lens, street.pipeline)
    return {str(atom) for atom in truth.perceive(front, walkers).facts}


def test_the_useful_range_is_longer_than_the_way_to_a_stand():
    car = EgoParameters()
    # v² / (2 · braking) without lag, drag and rolling, which change it by less than a metre
    assert stopping_distance(car) == pytest.approx(car.top_speed**2 / (2 * car.brake), abs=1.0)
    assert stopping_distance(car) + 10.0 <= USEFUL_RANGE


def test_truth_and_simulator_agree():
    found = compare(sights(12, every=8))
    for claim, agreement in found.items():
        if len(claim) == 1 and agreement.truth >= 30 and agreement.simulator >= 30:
            assert agreement.precision >= 0.9, claim
            assert agreement.recall >= 0.9, claim
    assert {claim[0] for claim in found} >= {
        *("Pedestrian", "Vehicle", "Truck", "Crosswalk", "LeftOf", "CenterOf", "RightOf"),
        *("OnRoad", "OnCrosswalk", "IsNear", "Occludes", "Approaching", "IsAt", "IsClear"),
        *("NoCrosswalk", "EmptyLane"),
    }


def test_a_person_on_the_road_is_on_the_road(street):
    facts = facts_of(street, 30.0, (42.0, street.corridor.centre))
    assert {"OnRoad(pedestrian1)", "CenterOf(pedestrian1, ego)"} <= facts


def test_a_person_on_the_crosswalk_takes_it(street):
    middle = sum(street.world.geometry.crosswalk) / 2
    facts = facts_of(street, 45.0, (middle, street.corridor.centre))
    assert "OnCrosswalk(pedestrian1)" in facts
    assert "IsClear(crosswalk1)" not in facts
    assert "IsClear(crosswalk1)" in facts_of(street, 45.0)


def test_a_person_on_the_sidewalk_is_on_neither(street):
    facts = facts_of(street, 30.0, (48.0, street.world.geometry.far_kerb + 1.5))
    assert {"Pedestrian(pedestrian1)", "LeftOf(pedestrian1, ego)"} <= facts
    assert not facts & {"OnRoad(pedestrian1)", "OnCrosswalk(pedestrian1)"}


def test_whom_the_camera_cannot_show_is_not_seen(street):
    lane = street.corridor.centre
    behind, aside = (20.0, lane), (33.0, lane + 6.0)
    assert not any(fact.startswith("Pedestrian") for fact in facts_of(street, 30.0, behind, aside))


def test_a_truck_hides_who_waits_behind_it(street_of):
    waiting = (61.0, street_of("low", "full").world.geometry.near_kerb - 0.4)
    for occlusion, seen in (("full", False), ("partial", True)):
        street = street_of("low", occlusion)
        street.reset(seed=1)
        facts = facts_of(street, 44.0, waiting)
        assert ("Pedestrian(pedestrian1)" in facts) is seen


def test_people_who_touch_in_the_picture_are_one(street):
    lane = street.corridor.centre
    facts = facts_of(street, 30.0, (40.0, lane), (42.0, lane + 0.2), (40.0, lane + 3.0))
    assert sum(fact.startswith("Pedestrian") for fact in facts) == 2


def test_distances_to_the_crosswalk_make_the_same_predicates(street):
    def about(front):
        names = ("NoCrosswalk", "Approaching", "IsAt")
        return {f.split("(")[0] for f in facts_of(street, front) if f.startswith(names)}

    assert [about(front) for front in (5.0, 35.0, 50.0, 70.0)] == [
        {"NoCrosswalk"},
        {"Approaching"},
        {"IsAt"},
        {"NoCrosswalk"},
    ]


def test_the_parked_vehicle_hides_the_crosswalk(street):
    kind = "truck" if street.occlusion == "full" else "vehicle"
    facts = facts_of(street, 40.0)
    assert {f"Occludes({kind}1, crosswalk1)", f"{kind.capitalize()}({kind}1)"} <= facts
    assert "EmptyLane(ego)" in facts


def test_what_is_said_again_is_concluded_as_if_anew(street):
    truth = TruthPerception(street.world, street.lens, street.pipeline)
    people = Walkers(np.tile([45.0, street.corridor.centre], (10, 1)), np.zeros((10, 2)))
    first = truth.perceive(30.0, people)
    known = str(first.facts)
    first.facts.add("OnRoad", "somebody_else")
    for front, alike in ((30.0, True), (31.0, True), (50.0, False), (30.0, True)):
        scene = truth.perceive(front, people)
        anew = TruthPerception(street.world, street.lens, street.pipeline).perceive(front, people)
        assert scene.facts == anew.facts
        assert scene.conclusions.derived == anew.conclusions.derived
        assert (str(scene.facts) == known) is alike


def test_truth_draws_no_picture(monkeypatch):
    with OccludedCrossing(traffic="low", perception="truth", observation="state") as street:
        monkeypatch.setattr(street.world, "render", lambda *_: pytest.fail("it draws"))
        street.reset(seed=0)
        for _ in range(20):
            street.step(np.ones(1, np.float32))
        with pytest.raises(UsageError, match="makes no class map"):
            _ = street.scene.classes


def test_the_same_people_walk_whatever_is_perceived(street_of):
    street = street_of("low", "full")
    with OccludedCrossing(
        traffic="low", occlusion="full", perception="truth", observation="state"
    ) as light:
        for each in (street, light):
            each.reset(seed=3)
            for _ in range(10):
                each.step(np.ones(1, np.float32))
        assert np.array_equal(street.people.positions, light.people.positions)
        assert street.ego == light.ego
        assert np.array_equal(street.frame.gray, light.frame.gray)


def test_the_cautious_driver_needs_no_picture():
    driver = Cautious()
    with OccludedCrossing(
        traffic="low", occlusion="full", perception="truth", observation="state"
    ) as street:
        endings = []
        for seed in range(3):
            street.reset(seed=seed)
            ended = False
            while not ended:
                action = np.array([driver(street)], np.float32)
                *_, terminated, truncated, info = street.step(action)
                ended = terminated or truncated
            endings.append(info["is_success"])
    assert all(endings)


def test_claims_are_about_what_is_within_reach(street):
    street.reset(seed=1)
    near, far = (claims(street.scene, street, reach) for reach in (1.0, 300.0))
    assert near < far
    assert ("Pedestrian",) in far - near
    assert SLACK > 0.0
    assert SemanticClass.PEDESTRIAN in {entity.kind for entity in street.scene.entities}


def test_states_lie_in_their_space_and_name_ego_s_speed():
    with OccludedCrossing(traffic="high", perception="truth", observation="state") as street:
        state, _ = street.reset(seed=0)
        for _ in range(60):
            assert street.observation_space.contains(state)
            assert state[0] == np.float32(street.ego.speed / street.ego.parameters.top_speed)
            state, *_, ended, _, _ = street.step(np.ones(1, np.float32))
            if ended:
                break
