import math
import sys
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage

from sfol.facts import Facts
from tests.vsr.painting import GROUNDING, HORIZON, SIZE, Painting, atoms, street
from vsr.classes import CLASS_COUNT, ENTITY_CLASSES, SemanticClass
from vsr.entities import Direction, find_entities
from vsr.facts import MapEvidence, Pinhole, of_kind, scene_facts
from vsr.grounding import Camera, SegmentationGrounding

PERSON, CAR, TRUCK, CROSSWALK, ROAD, SIDEWALK = (
    SemanticClass.PEDESTRIAN,
    SemanticClass.VEHICLE,
    SemanticClass.TRUCK,
    SemanticClass.CROSSWALK,
    SemanticClass.ROAD,
    SemanticClass.SIDEWALK,
)
REGIONS = ("LeftOf", "CenterOf", "RightOf")


def changed(**fields) -> SegmentationGrounding:
    return SegmentationGrounding.model_validate({**GROUNDING.model_dump(), **fields})


def test_an_empty_street():
    facts = street().facts()
    assert {str(atom) for atom in facts} == {"NoCrosswalk(ego)", "EmptyLane(ego)"}
    assert facts.bound("EmptyLane", "ego") == (1.0, 1.0)


def test_semantic_predicates_have_the_segmenters_confidence():
    painting = (
        street()
        .rectangle(PERSON, (100, 130), (50, 60))
        .rectangle(CAR, (110, 140), (80, 100))
        .rectangle(TRUCK, (90, 150), (150, 180))
        .rectangle(CROSSWALK, (160, 170), (40, 184))
    )
    probabilities = painting.one_hot * np.float32(0.8)
    probabilities[0] += np.float32(0.2)
    facts = scene_facts(find_entities(probabilities), probabilities, GROUNDING, Facts(margin=0.05))
    for atom in ("Pedestrian", "Vehicle", "Truck", "Crosswalk"):
        assert facts.bound(atom, f"{atom.lower()}1") == pytest.approx((0.76, 0.84), abs=1e-6)


def test_probabilities_and_their_class_map_give_the_same_facts():
    painting = street().rectangle(PERSON, (100, 130), (50, 60)).rectangle(CAR, (90, 150), (80, 99))
    entities = painting.entities()
    assert scene_facts(entities, painting.one_hot, GROUNDING, Facts()) == painting.facts()


def test_the_given_facts_are_filled_with_the_subject_named():
    facts = Facts()
    assert scene_facts((), street().classes, GROUNDING, facts, subject="me") is facts
    assert ("NoCrosswalk", "me") in facts


# Thirds


@pytest.mark.parametrize(
    ("kind", "left", "right", "expected"),
    [
        (PERSON, 0, 10, "LeftOf(pedestrian1, ego)"),
        (PERSON, 107, 117, "CenterOf(pedestrian1, ego)"),
        (CAR, 200, 224, "RightOf(vehicle1, ego)"),
        (TRUCK, 0, 224, "CenterOf(truck1, ego)"),
        (PERSON, 69, 79, "LeftOf(pedestrian1, ego)"),  # centre 74 < 224 / 3
        (PERSON, 70, 80, "CenterOf(pedestrian1, ego)"),  # centre 75 > 224 / 3
        (PERSON, 144, 154, "CenterOf(pedestrian1, ego)"),  # centre 149 < 448 / 3
        (PERSON, 145, 155, "RightOf(pedestrian1, ego)"),  # centre 150 > 448 / 3
    ],
)
def test_thirds_of_the_picture(kind, left, right, expected):
    facts = street().rectangle(kind, (100, 140), (left, right)).facts()
    assert atoms(facts, *REGIONS) == {expected}


def test_crosswalks_have_no_region():
    assert not atoms(street().rectangle(CROSSWALK, (150, 160), (0, 60)).facts(), *REGIONS)


@given(st.integers(0, SIZE - 1), st.integers(1, 60))
def test_the_mirrored_picture_swaps_left_and_right(left, width):
    right = min(left + width, SIZE)
    here = street().rectangle(PERSON, (100, 140), (left, right)).facts()
    there = street().rectangle(PERSON, (100, 140), (SIZE - right, SIZE - left)).facts()
    swap = {"LeftOf": "RightOf", "RightOf": "LeftOf", "CenterOf": "CenterOf"}
    (one,) = (a for a in here if a.predicate in REGIONS)
    (other,) = (a for a in there if a.predicate in REGIONS)
    assert swap[one.predicate] == other.predicate


# Distances: with 168 / Z px below the horizon, 8 m is 21 px and 40 m is 4.2 px


@pytest.mark.parametrize(
    ("below", "expected"),
    [
        (30, {"IsAt(ego, crosswalk1)"}),  # 5.6 m
        (22, {"IsAt(ego, crosswalk1)"}),  # 7.6 m
        (21, {"Approaching(ego, crosswalk1)"}),  # 8 m
        (5, {"Approaching(ego, crosswalk1)"}),  # 33.6 m
        (4, {"NoCrosswalk(ego)"}),  # 42 m
        (0, {"NoCrosswalk(ego)"}),  # at the horizon
    ],
)
def test_distance_to_the_crosswalk(below, expected):
    bottom = HORIZON + below
    facts = street().rectangle(CROSSWALK, (bottom - 3, bottom), (60, 160)).facts()
    assert atoms(facts, "Approaching", "IsAt", "NoCrosswalk") == expected


def test_the_limits_of_approaching_belong_to_it():
    pinhole = Pinhole.of(GROUNDING.camera, (SIZE, SIZE))
    limits = [pinhole.distance(HORIZON + below) for below in (20, 10)]
    for below in (20, 10):
        scene = street().rectangle(CROSSWALK, (HORIZON + 5, HORIZON + below), (60, 160))
        facts = scene.facts(changed(approaching=limits))
        assert atoms(facts, "Approaching", "IsAt", "NoCrosswalk") == {
            "Approaching(ego, crosswalk1)"
        }


def test_the_papers_distances():
    focal = Camera().focal_length(SIZE)
    pinhole = Pinhole.of(Camera(), (SIZE, SIZE))
    assert pinhole.distance(HORIZON + 1) == pytest.approx(1.5 * focal)
    assert pinhole.distance(HORIZON) == math.inf
    far = street().rectangle(CROSSWALK, (113, 116), (60, 160)).facts(SegmentationGrounding())
    assert ("Approaching", "ego", "crosswalk1") in far  # 90 m
    near = street().rectangle(CROSSWALK, (117, 120), (60, 160)).facts(SegmentationGrounding())
    assert ("IsAt", "ego", "crosswalk1") in near  # 45 m


def test_pinhole_columns_and_laterals_are_inverse():
    pinhole = Pinhole.of(GROUNDING.camera, (SIZE, SIZE))
    rows = np.array([120.0, 168.0])
    columns = pinhole.columns(3.0, rows)
    assert columns == pytest.approx([112 + 3 * 8 / 1.5, 112 + 3 * 56 / 1.5])
    assert pinhole.laterals(columns, rows) == pytest.approx([3.0, 3.0])
    assert np.isinf(pinhole.laterals(columns, np.array([112.0, 100.0]))).all()


# The ground below a pedestrian


def ground(painting: Painting, grounding: SegmentationGrounding = GROUNDING) -> set[str]:
    return atoms(painting.facts(grounding), "OnRoad", "OnCrosswalk")


def test_on_the_road_the_crosswalk_and_the_sidewalk():
    scene = street().rectangle(CROSSWALK, (150, 170), (40, 184))
    assert ground(scene.rectangle(PERSON, (100, 135), (100, 108))) == {"OnRoad(pedestrian1)"}
    crossing = street().rectangle(CROSSWALK, (150, 170), (40, 184))
    assert ground(crossing.rectangle(PERSON, (130, 155), (100, 108))) == {
        "OnCrosswalk(pedestrian1)"
    }
    assert ground(street().rectangle(PERSON, (100, 135), (10, 18))) == set()


def test_markings_are_road():
    scene = street().rectangle(SemanticClass.ROAD_LINE, (130, 224), (100, 110))
    assert ground(scene.rectangle(PERSON, (100, 135), (102, 108))) == {"OnRoad(pedestrian1)"}


def test_a_thin_crosswalk_far_ahead_counts_more_than_the_road_before_it():
    scene = street().rectangle(CROSSWALK, (120, 124), (40, 184))
    assert ground(scene.rectangle(PERSON, (105, 122), (100, 104))) == {"OnCrosswalk(pedestrian1)"}


def test_most_pixels_decide_across_a_row():
    scene = street().rectangle(PERSON, (100, 135), (35, 44))  # 5 columns sidewalk, 4 road
    assert ground(scene) == set()
    scene = street().rectangle(PERSON, (100, 135), (36, 45))  # 4 columns sidewalk, 5 road
    assert ground(scene) == {"OnRoad(pedestrian1)"}


def test_equal_evidence_goes_to_the_crosswalk():
    scene = street().rectangle(CROSSWALK, (130, 224), (40, 104))
    assert ground(scene.rectangle(PERSON, (100, 135), (100, 108))) == {"OnCrosswalk(pedestrian1)"}


def test_hidden_feet_have_no_ground():
    scene = street().rectangle(CAR, (130, 160), (90, 130))
    assert ground(scene.rectangle(PERSON, (100, 130), (100, 108))) == set()


def test_the_window_ends_after_its_last_row():
    scene = street().rectangle(CAR, (130, 145), (90, 130)).rectangle(PERSON, (100, 130), (100, 108))
    assert ground(scene) == set()
    assert ground(scene, changed(window=16)) == {"OnRoad(pedestrian1)"}


def test_feet_at_the_lower_border_are_judged_by_what_lies_beside():
    scene = street().rectangle(PERSON, (100, SIZE), (100, 120))
    assert ground(scene) == {"OnRoad(pedestrian1)"}
    scene = street().rectangle(PERSON, (100, SIZE), (0, 20))
    assert ground(scene) == set()
    scene = street().rectangle(CROSSWALK, (200, SIZE), (40, 184))
    crossing = scene.rectangle(PERSON, (100, SIZE), (100, 120)).facts()
    assert atoms(crossing, "OnCrosswalk", "IsClear") == {"OnCrosswalk(pedestrian1)"}
    everywhere = Painting().rectangle(PERSON, (0, SIZE), (0, SIZE))
    assert ground(everywhere) == set()


def test_a_window_that_the_border_cuts_still_counts():
    scene = street().rectangle(PERSON, (100, SIZE - 2), (100, 120))
    assert ground(scene) == {"OnRoad(pedestrian1)"}


# Near vehicles


def test_near_is_within_the_window_beside():
    def near(gap: int, **fields) -> set[str]:
        scene = street().rectangle(PERSON, (110, 150), (100, 108))
        return atoms(
            scene.rectangle(CAR, (120, 160), (108 + gap, 150 + gap)).facts(changed(**fields)),
            "IsNear",
        )

    assert near(0) == near(14) == {"IsNear(pedestrian1, vehicle1)"}
    assert near(15) == set()
    assert near(14, minimum_pixels=30) == {"IsNear(pedestrian1, vehicle1)"}  # rows 120 to 149
    assert near(14, minimum_pixels=31) == set()


def test_near_names_each_vehicle_on_either_side_but_not_one_below():
    scene = (
        street()
        .rectangle(PERSON, (110, 150), (100, 108))
        .rectangle(CAR, (120, 160), (60, 95))
        .rectangle(TRUCK, (80, 170), (110, 180))
    )
    assert atoms(scene.facts(), "IsNear") == {
        "IsNear(pedestrian1, vehicle1)",
        "IsNear(pedestrian1, truck1)",
    }
    below = street().rectangle(PERSON, (110, 130), (100, 108)).rectangle(CAR, (130, 150), (90, 120))
    assert atoms(below.facts(), "IsNear") == set()


# Occlusion


def crossing() -> Painting:
    """A crosswalk from 12 px to 18 px below the horizon, from 14 m to 9.3 m ahead."""
    return street().rectangle(CROSSWALK, (HORIZON + 12, HORIZON + 18), (72, 152))


def test_a_vehicle_hides_the_right_part_of_a_crosswalk():
    facts = crossing().rectangle(CAR, (100, 140), (130, 160)).facts()
    assert atoms(facts, "Occludes") == {"Occludes(vehicle1, crosswalk1)"}


def test_what_is_hidden_leaves_no_pixels_but_the_road_goes_on():
    # the crosswalk is seen only up to the truck, which hides the rest of it
    scene = crossing().rectangle(ROAD, (HORIZON + 12, HORIZON + 18), (140, 184))
    scene.rectangle(TRUCK, (80, 135), (145, 200))
    assert atoms(scene.facts(), "Occludes") == {"Occludes(truck1, crosswalk1)"}
    # … unless the road ends before the truck: 1.5 m to the right are 18 px at most
    assert atoms(scene.facts(changed(road=[-5, 1.5])), "Occludes") == set()


def test_what_is_seen_of_a_crosswalk_counts_wherever_the_road_is_said_to_be():
    for columns in ((76, 86), (140, 150)):
        scene = crossing().rectangle(CAR, (100, 140), columns)
        facts = scene.facts(changed(road=[-0.1, 0.1]))
        assert atoms(facts, "Occludes") == {"Occludes(vehicle1, crosswalk1)"}


def test_a_vehicle_behind_the_crosswalk_hides_nothing():
    for bottom in (HORIZON + 12, HORIZON + 13):  # its lower edge may touch the far row
        facts = crossing().rectangle(CAR, (100, bottom), (100, 120)).facts()
        assert atoms(facts, "Occludes") == set()


def test_a_low_vehicle_before_the_crosswalk_leaves_it_visible():
    facts = crossing().rectangle(CAR, (HORIZON + 20, HORIZON + 40), (100, 140)).facts()
    assert atoms(facts, "Occludes") == set()


def test_a_vehicle_beside_the_road_hides_nothing():
    facts = crossing().rectangle(CAR, (100, 140), (184, 224)).facts()
    assert atoms(facts, "Occludes") == set()


def test_a_pedestrian_hides_no_crosswalk():
    assert not atoms(crossing().rectangle(PERSON, (100, 140), (100, 110)).facts(), "Occludes")


@pytest.mark.parametrize(
    ("rows", "columns", "hidden"),
    [
        ((110, 130), (80, 90), True),  # behind the right part, its left side visible
        ((90, 110), (100, 108), True),  # behind the roof
        ((100, 110), (80, 90), False),  # touches it at a corner alone
        ((110, 130), (78, 88), False),  # further away, but two pixels apart
        ((120, 150), (80, 90), False),  # stands before the car
        ((120, 150), (100, 110), False),  # stands before the car, seen against it
    ],
)
def test_a_vehicle_hides_a_pedestrian(rows, columns, hidden):
    scene = street().rectangle(CAR, (110, 145), (90, 130)).rectangle(PERSON, rows, columns)
    expected = {"Occludes(vehicle1, pedestrian1)"} if hidden else set()
    assert atoms(scene.facts(), "Occludes") == expected


# Explicit negation


def test_a_crosswalk_is_clear_until_someone_stands_on_it():
    assert atoms(crossing().facts(), "IsClear") == {"IsClear(crosswalk1)"}
    walker = crossing().rectangle(PERSON, (100, HORIZON + 15), (100, 106))
    assert atoms(walker.facts(), "IsClear") == set()
    waiting = crossing().rectangle(PERSON, (100, 140), (10, 18))
    assert atoms(waiting.facts(), "IsClear") == {"IsClear(crosswalk1)"}


def test_each_crosswalk_is_clear_by_itself():
    scene = crossing().rectangle(CROSSWALK, (170, 190), (40, 184))
    scene.rectangle(PERSON, (130, 180), (100, 110))
    assert atoms(scene.facts(), "IsClear") == {"IsClear(crosswalk2)"}


def test_a_hidden_part_counts_only_where_the_base_says_so():
    scene = crossing().rectangle(CAR, (100, 140), (130, 160))
    assert atoms(scene.facts(), "IsClear") == {"IsClear(crosswalk1)"}
    assert atoms(scene.facts(changed(clear_requires_unoccluded=True)), "IsClear") == set()
    free = crossing().facts(changed(clear_requires_unoccluded=True))
    assert atoms(free, "IsClear") == {"IsClear(crosswalk1)"}


@pytest.mark.parametrize(
    ("columns", "empty"),
    [
        ((100, 124), False),  # straight ahead
        ((145, 180), False),  # its left edge is 33 px right of the middle at 28 px: 1.77 m …
        ((147, 180), True),
        ((40, 76), True),  # the lane on the left
    ],
)
def test_the_lane_is_empty_unless_a_vehicle_meets_the_road_in_it(columns, empty):
    # 28 px below the horizon, a metre is 18.7 px wide, half the lane 32.7 px (pixel middles)
    bottom = HORIZON + 28
    scene = street().rectangle(CAR, (100, bottom), columns)
    grounding = changed(lane_half_width=1.8)
    assert (("EmptyLane", "ego") in scene.facts(grounding)) is empty


def test_the_side_of_a_parked_vehicle_that_recedes_is_not_in_the_lane():
    # seen along its left side: the outline rises towards the vanishing point
    scene = street()
    for column in range(130, 200):
        rise = (column - 112) // 2  # 3 m to the right all along
        scene.rectangle(TRUCK, (90, HORIZON + rise), (column, column + 1))
    assert ("EmptyLane", "ego") in scene.facts()


def test_people_do_not_fill_the_lane_and_floating_vehicles_neither():
    assert ("EmptyLane", "ego") in street().rectangle(PERSON, (100, 140), (107, 117)).facts()
    assert ("EmptyLane", "ego") in street().rectangle(CAR, (50, 100), (107, 117)).facts()


# Bounds


def test_bounds_come_from_the_knowledge_base():
    scene = street().rectangle(PERSON, (100, 135), (100, 108))
    facts = scene.facts(changed(bounds={"OnRoad": [0.9, 1.0], "EmptyLane": [0.5, 0.6]}))
    assert facts.bound("OnRoad", "pedestrian1") == (0.9, 1.0)
    assert facts.bound("EmptyLane", "ego") == (0.5, 0.6)
    assert facts.bound("CenterOf", "pedestrian1", "ego") == (1.0, 1.0)


# Anything at all

_SHAPES = st.lists(
    st.tuples(
        st.sampled_from([PERSON, CAR, TRUCK, CROSSWALK, ROAD, SIDEWALK]),
        *[st.integers(0, SIZE - 1)] * 2,
        *[st.integers(1, 80)] * 2,
    ),
    max_size=12,
)


def painted(shapes) -> Painting:
    painting = street()
    for kind, top, left, height, width in shapes:
        painting.rectangle(kind, (top, top + height), (left, left + width))
    return painting


@given(_SHAPES)
def test_every_scene_gives_consistent_facts(shapes):
    painting = painted(shapes)
    facts = painting.facts()
    for entity in painting.entities():
        mentioned = [atom.predicate for atom in facts if entity.name in atom.arguments]
        assert {"OnRoad", "OnCrosswalk"} - set(mentioned)
        assert {"Approaching", "IsAt"} - set(mentioned)
        regions = sum(predicate in REGIONS for predicate in mentioned)
        assert regions == (entity.kind is not CROSSWALK)


# Pairs, and how much work they are


def literally(classes, grounding, person, vehicle):
    """Pixels of a vehicle beside a person, and before one, counted on a map of its own."""
    own = np.zeros(classes.shape, bool)
    own[vehicle.box.area] = vehicle.mask
    sides = (Direction.LEFT_OF, Direction.RIGHT_OF)
    beside = sum(int(own[person.beside(side, grounding.window)].sum()) for side in sides)
    body = np.zeros(classes.shape, bool)
    body[person.box.area] = person.mask
    touching = int((own & ndimage.binary_dilation(body)).sum())
    return beside, touching if vehicle.bottom > person.bottom else 0


@given(_SHAPES)
def test_each_pair_is_counted_as_if_it_were_alone(shapes):
    painting = painted(shapes)
    entities, classes = painting.entities(), painting.classes
    pinhole = Pinhole.of(GROUNDING.camera, classes.shape)
    evidence = MapEvidence(entities, classes, GROUNDING, pinhole)
    vehicles = of_kind(entities, CAR, TRUCK)
    for person in of_kind(entities, PERSON):
        beside, before = evidence.beside(person), evidence.before(person)
        for vehicle in vehicles:
            found = beside.get(vehicle, 0), before.get(vehicle, 0)
            assert found == literally(classes, GROUNDING, person, vehicle)
        assert list(beside) == [vehicle for vehicle in vehicles if vehicle in beside]


def noise(rows: int) -> np.ndarray:
    """A class map in which hardly a pixel is like the next one."""
    return np.random.default_rng(0).integers(0, CLASS_COUNT, (rows, 60), dtype=np.uint8)


def calls(function) -> int:
    """Return how many functions, of Python and of C, are called by one."""
    counted: Counter[str] = Counter()
    sys.setprofile(lambda frame, event, argument: counted.update([event]))
    try:
        function()
    finally:
        sys.setprofile(None)
    return counted["call"] + counted["c_call"]


def test_twice_the_noise_is_hardly_more_than_twice_the_work():
    work = []
    for rows in (40, 80, 160):
        classes = noise(rows)
        scene = np.eye(CLASS_COUNT, dtype=np.float32)[classes].transpose(2, 0, 1)

        def read(scene=scene, classes=classes):
            return scene_facts(find_entities(scene, 1, classes), classes, GROUNDING, Facts())

        read()  # what is kept for the next time is kept
        work.append(calls(read))
    assert work[0] > 1000
    assert work[1] <= 2.5 * work[0]
    assert work[2] <= 2.5 * work[1]


def _same_scene(classes: np.ndarray, minimum_area: int) -> None:
    one_hot = np.eye(CLASS_COUNT, dtype=np.float32)[classes].transpose(2, 0, 1).copy()
    certain, probable = find_entities(classes, minimum_area), find_entities(one_hot, minimum_area)
    assert [_whole(entity) for entity in certain] == [_whole(entity) for entity in probable]
    assert {entity.confidence for entity in certain} <= {1.0}
    read = [
        scene_facts(entities, scene, GROUNDING, Facts())
        for entities, scene in ((certain, classes), (probable, one_hot))
    ]
    assert list(read[0].items()) == list(read[1].items())


def _whole(entity):
    return entity.name, entity.kind, entity.confidence, entity.box, entity.mask.tolist()


_SEEN = [SemanticClass.ROAD, SemanticClass.SIDEWALK, SemanticClass.ROAD_LINE, *ENTITY_CLASSES]


@given(
    arrays(np.uint8, (20, 28), elements=st.sampled_from(_SEEN).map(int)),
    st.sampled_from([1, 2, 5]),
    st.sampled_from([1, 4, 9]),
)
def test_a_class_map_says_what_its_certain_probabilities_say(drawn, coarseness, minimum_area):
    _same_scene(np.kron(drawn, np.ones((coarseness, coarseness), np.uint8)), minimum_area)


@pytest.mark.parametrize("kinds", [range(CLASS_COUNT), _SEEN])
def test_a_class_map_of_noise_says_what_its_certain_probabilities_say(kinds):
    rng = np.random.default_rng(0)
    _same_scene(rng.choice(np.array(kinds, np.uint8), (SIZE, SIZE)), 1)
