import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sfol.errors import UsageError
from tests.vsr.painting import SIZE, Painting, street
from vsr.classes import CLASS_COUNT, SemanticClass
from vsr.entities import Box, Direction, Entity, class_map, find_entities

PERSON, CAR, TRUCK, CROSSWALK = (
    SemanticClass.PEDESTRIAN,
    SemanticClass.VEHICLE,
    SemanticClass.TRUCK,
    SemanticClass.CROSSWALK,
)


def names(entities):
    return [entity.name for entity in entities]


@given(arrays(np.float32, (CLASS_COUNT, 4, 5), elements=st.floats(0, 1, width=16)))
def test_class_map_is_argmax(weights):
    weights += 1e-3
    probabilities = weights / weights.sum(axis=0)
    assert np.array_equal(class_map(probabilities), probabilities.argmax(axis=0))


def test_a_class_map_stays_as_it_is():
    classes = street().classes
    assert class_map(classes) is classes


def test_an_empty_street_has_no_entities():
    assert street().entities() == ()


def test_every_kind_is_found_nearest_first():
    found = (
        street()
        .rectangle(PERSON, (110, 130), (50, 58))
        .rectangle(PERSON, (110, 150), (80, 95))
        .rectangle(CAR, (115, 128), (100, 120))
        .rectangle(TRUCK, (90, 160), (150, 200))
        .rectangle(CROSSWALK, (170, 180), (40, 184))
        .entities()
    )
    assert names(found) == ["pedestrian1", "pedestrian2", "vehicle1", "truck1", "crosswalk1"]
    assert found[0].box == Box(top=110, left=80, bottom=150, right=95)
    assert found[0].centre == (130.0, 87.5)
    assert found[0].bottom == 150
    assert found[0].area == 40 * 15
    assert found[0].kind is PERSON
    assert found[0].confidence == 1.0


def test_equally_near_entities_count_from_the_left():
    found = (
        street()
        .rectangle(PERSON, (100, 130), (90, 95))
        .rectangle(PERSON, (110, 130), (50, 58))
        .entities()
    )
    assert [entity.box.left for entity in found] == [50, 90]


def test_confidence_is_the_mean_probability_of_the_cluster():
    probabilities = np.full((CLASS_COUNT, 16, 16), 0.0, np.float32)
    probabilities[SemanticClass.ROAD] = 1.0
    for column, sure in enumerate((0.6, 0.8, 0.9)):
        probabilities[PERSON, 4, 4 + column] = sure
        probabilities[SemanticClass.ROAD, 4, 4 + column] = 1 - sure
    (person,) = find_entities(probabilities)
    assert person.confidence == pytest.approx((0.6 + 0.8 + 0.9) / 3, abs=1e-6)


def test_diagonal_neighbours_are_two_clusters_and_masks_keep_the_shape():
    painting = street().rectangle(CAR, (120, 125), (60, 70)).rectangle(CAR, (125, 130), (70, 75))
    assert names(painting.entities()) == ["vehicle1", "vehicle2"]
    bend = painting.rectangle(CAR, (125, 126), (60, 75)).entities()
    assert names(bend) == ["vehicle1"]
    assert bend[0].area == 50 + 15 + 20
    assert bend[0].mask.shape == (10, 15)


def test_small_clusters_are_no_entities():
    painting = street().rectangle(PERSON, (120, 123), (60, 63))
    assert names(painting.entities(minimum_area=9)) == ["pedestrian1"]
    assert painting.entities(minimum_area=10) == ()


def test_a_crosswalk_cut_apart_is_one():
    (crosswalk, *rest) = [
        entity
        for entity in street()
        .rectangle(CROSSWALK, (150, 160), (40, 184))
        .rectangle(CAR, (120, 175), (80, 110))
        .rectangle(CROSSWALK, (120, 123), (60, 160))
        .entities()
        if entity.kind is CROSSWALK
    ]
    assert crosswalk.box == Box(150, 40, 160, 184)
    assert crosswalk.area == 10 * (144 - 30)
    assert not crosswalk.mask[:, 40:70].any()
    assert names(rest) == ["crosswalk2"]


def test_crosswalks_that_share_no_row_are_two():
    painting = street().rectangle(CROSSWALK, (150, 160), (40, 60))
    painting.rectangle(CROSSWALK, (160, 170), (100, 120))
    assert names(painting.entities()) == ["crosswalk1", "crosswalk2"]


def test_the_pieces_of_a_crosswalk_are_enough_together():
    painting = (
        street()
        .rectangle(CROSSWALK, (120, 122), (40, 44))
        .rectangle(CROSSWALK, (121, 123), (50, 54))
        .rectangle(CROSSWALK, (122, 124), (60, 64))
    )
    assert painting.entities(minimum_area=24)[0].box == Box(120, 40, 124, 64)


@pytest.mark.parametrize("row", [0, 100, SIZE - 1])
@pytest.mark.parametrize("column", [0, 100, SIZE - 1])
def test_one_pixel_is_an_entity_even_at_the_border(row, column):
    (person,) = Painting().rectangle(PERSON, (row, row + 1), (column, column + 1)).entities()
    assert person.box == Box(row, column, row + 1, column + 1)
    assert person.area == 1


def test_the_whole_map_can_be_one_entity():
    (car,) = Painting().rectangle(CAR, (0, SIZE), (0, SIZE)).entities()
    assert car.area == SIZE * SIZE


def test_windows_lie_along_the_box_and_end_at_the_border():
    entity = Entity("pedestrian1", PERSON, 1.0, Box(10, 5, 20, 8), np.ones((10, 3), bool))
    assert entity.beside(Direction.LEFT_OF, 15) == (slice(10, 20), slice(0, 5))
    assert entity.beside(Direction.RIGHT_OF, 15) == (slice(10, 20), slice(8, 23))
    assert entity.beside(Direction.BELOW_OF, 15) == (slice(20, 35), slice(5, 8))


@given(
    st.tuples(*[st.integers(-6, 20)] * 2, *[st.integers(0, 12)] * 2),
    arrays(np.bool_, (4, 5)),
)
def test_the_part_of_an_entity_on_a_rectangle(window, mask):
    top, left, height, width = window
    canvas = np.zeros((60, 60), bool)
    canvas[20 + 5 : 20 + 9, 20 + 7 : 20 + 12] = mask
    entity = Entity("vehicle1", CAR, 1.0, Box(5, 7, 9, 12), mask)
    part = entity.on((slice(top, top + height), slice(left, left + width)))
    assert np.array_equal(part, canvas[20 + top :, 20 + left :][:height, :width])


def one_hot(value: float = 1.0) -> np.ndarray:
    probabilities = np.zeros((CLASS_COUNT, 16, 16), np.float32)
    probabilities[1] = value
    return probabilities


def spoiled(value: float) -> np.ndarray:
    probabilities = one_hot()
    probabilities[1, 3, 3] = value
    return probabilities


def negative() -> np.ndarray:
    probabilities = spoiled(1.5)
    probabilities[2, 3, 3] = -0.5
    return probabilities


@pytest.mark.parametrize(
    "bad",
    [
        one_hot()[:27],
        one_hot()[None],
        one_hot()[:, :0],
        one_hot().astype(np.int64),
        one_hot(0.5),
        spoiled(np.nan),
        spoiled(np.inf),
        spoiled(1.01),
        negative(),
        np.full((16, 16), CLASS_COUNT, np.uint8),
        np.zeros((0, 16), np.uint8),
        np.zeros((1, 16, 16), np.uint8),
    ],
)
def test_bad_maps_are_refused(bad):
    with pytest.raises(UsageError):
        class_map(bad)


def test_bad_arguments_are_refused():
    with pytest.raises(UsageError, match="minimum_area"):
        find_entities(one_hot(), 0)
    with pytest.raises(UsageError, match="does not belong"):
        find_entities(one_hot(), classes=np.zeros((8, 8), np.uint8))
    with pytest.raises(UsageError, match="a class map is int64"):
        find_entities(one_hot(), classes=np.zeros((16, 16), np.int64))


def test_rounding_within_the_tolerance_is_taken():
    found = find_entities(
        np.where(np.arange(CLASS_COUNT)[:, None, None] == PERSON, one_hot(0)[:1] + 1.0005, 0)
    )
    assert found[0].confidence == 1.0
