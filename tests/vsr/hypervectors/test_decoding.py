import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sfol.errors import UsageError
from tests.vsr.painting import street
from vsr.classes import DESCRIPTOR_CLASSES, DYNAMIC_CLASSES, SemanticClass
from vsr.entities import Direction
from vsr.hypervectors import hrr
from vsr.hypervectors.codebook import Codebook
from vsr.hypervectors.decoding import MOST_ENTITIES, Decoder, block_likeness, template_count
from vsr.hypervectors.descriptor import Layout, SceneDescriptor
from vsr.hypervectors.fusion import Fusion

PERSON, CAR, TRUCK = DYNAMIC_CLASSES
ROAD, CROSSWALK = SemanticClass.ROAD, SemanticClass.CROSSWALK
LEFT, RIGHT, BELOW = Direction
BOOK = Codebook()
DESCRIPTOR, DECODER = SceneDescriptor(BOOK), Decoder(BOOK)


def layout(*entities) -> Layout:
    """A layout of (class, neighbours, coverage)."""
    found = np.zeros((len(entities), 6, 3), bool)
    for sides, (_, neighbours, _) in zip(found, entities, strict=True):
        for kind, direction in neighbours:
            sides[DESCRIPTOR_CLASSES.index(kind), list(Direction).index(direction)] = True
    return Layout(
        names=tuple(str(number) for number in range(len(entities))),
        kinds=np.array([DESCRIPTOR_CLASSES.index(kind) for kind, _, _ in entities]),
        neighbours=found,
        coverage=np.array([coverage for _, _, coverage in entities], np.float32),
        attention=np.zeros((len(entities), 7, 7), np.float32),
    )


def block(rows: tuple[int, int], columns: tuple[int, int], edge: float = 1.0) -> np.ndarray:
    """A block of cells, of which those of the last row are covered in part."""
    coverage = np.zeros((16, 16), np.float32)
    coverage[slice(*rows), slice(*columns)] = 1.0
    coverage[rows[1] - 1, slice(*columns)] = edge
    return coverage


NEIGHBOURS = st.frozensets(
    st.tuples(st.sampled_from(DESCRIPTOR_CLASSES), st.sampled_from(Direction)), max_size=5
)


@st.composite
def entities(draw):
    top, left = draw(st.integers(0, 12)), draw(st.integers(0, 12))
    height, width = draw(st.integers(1, 4)), draw(st.integers(1, 4))
    coverage = block((top, top + height), (left, left + width), draw(st.floats(0.3, 1.0)))
    return draw(st.sampled_from(DYNAMIC_CLASSES)), draw(NEIGHBOURS), coverage


@settings(max_examples=30)
@given(entities(), st.floats(0.1, 100.0))
def test_one_entity_is_read_whole_from_its_vector(entity, scale):
    kind, neighbours, coverage = entity
    (ssi,) = DESCRIPTOR.encode(layout(entity))
    (read,) = DECODER.decode(scale * ssi)
    assert read.kind is kind
    assert read.neighbours == neighbours
    np.testing.assert_allclose(read.coverage, scale * coverage, atol=1e-3 * scale)
    row, column = np.average(np.indices((16, 16)) + 0.5, axis=(1, 2), weights=[coverage] * 2)
    assert read.centre == pytest.approx((row, column), abs=0.05)


@pytest.mark.parametrize("book", [Codebook(1024, unitary=True), Codebook(1025)])
def test_other_symbols_are_read_as_well(book):
    entity = (CAR, {(ROAD, BELOW), (PERSON, LEFT)}, block((3, 6), (4, 8)))
    (ssi,) = SceneDescriptor(book).encode(layout(entity))
    (read,) = Decoder(book).decode(ssi)
    assert (read.kind, read.neighbours) == (CAR, entity[1])
    np.testing.assert_allclose(read.coverage, entity[2], atol=1e-3)


# Of odd widths, so that no centre lies on the border of two cells, where rounding would decide.
SCENE = (
    (PERSON, {(ROAD, BELOW)}, block((6, 9), (2, 3), 0.5)),
    (PERSON, {(CROSSWALK, BELOW), (CAR, RIGHT)}, block((6, 9), (7, 10), 0.3)),
    (CAR, {(ROAD, BELOW), (PERSON, LEFT)}, block((7, 10), (11, 14))),
    (TRUCK, set(), block((1, 6), (10, 13), 0.7)),
)


def in_scene(read):
    return {(entity.kind, entity.neighbours, entity.cell) for entity in read}


def test_a_bundle_is_read_entity_by_entity_and_no_more_is_found_than_there_is():
    (vsr,) = DESCRIPTOR.vsr([layout(*SCENE)], [[1.0, 1.0, 0.5, 0.75]])
    read = DECODER.decode(vsr, most=12)
    assert in_scene(read) == {
        (PERSON, frozenset(SCENE[0][1]), (7, 2)),
        (PERSON, frozenset(SCENE[1][1]), (7, 8)),
        (CAR, frozenset(SCENE[2][1]), (8, 12)),
        (TRUCK, frozenset(), (3, 11)),
    }
    assert [e.score for e in read] == sorted((e.score for e in read), reverse=True)


def test_coverage_carries_the_weight():
    plain = SceneDescriptor(BOOK, fusion=Fusion("ssi", False, False))
    weights = [1.0, 0.25, 0.5, 0.75]
    (vsr,) = plain.vsr([layout(*SCENE)], [weights])
    by_cell = {entity.cell: entity for entity in DECODER.decode(vsr, most=4)}
    for weight, cell, (_, _, coverage) in zip(
        weights, [(7, 2), (7, 8), (8, 12), (3, 11)], SCENE, strict=True
    ):
        np.testing.assert_allclose(by_cell[cell].coverage, weight * coverage, atol=1e-3)


def test_as_many_as_wanted_are_read_and_the_clearest_first():
    (vsr,) = DESCRIPTOR.vsr([layout(*SCENE)], [[1.0, 0.1, 0.1, 0.1]])
    (read,) = DECODER.decode(vsr)
    assert (read.kind, read.cell) == (PERSON, (7, 2))


def test_two_that_say_the_same_and_touch_are_read_as_one():
    below = {(ROAD, BELOW)}
    touching = (PERSON, below, block((6, 8), (2, 4))), (PERSON, below, block((6, 8), (4, 6)))
    apart = (PERSON, below, block((6, 8), (2, 4))), (PERSON, below, block((6, 8), (9, 11)))
    for scene, count in ((touching, 1), (apart, 2)):
        (vsr,) = DESCRIPTOR.vsr([layout(*scene)], [[1.0, 1.0]])
        assert len(DECODER.decode(vsr, most=5)) == count


def test_noise_and_nothing_hold_no_entities():
    assert DECODER.decode(torch.zeros(2048), most=3) == ()
    noise = torch.randn(2048, generator=torch.Generator().manual_seed(0))
    assert DECODER.decode(noise, most=3) == ()
    assert len(DECODER.decode(noise, most=3, least_score=0.0)) > 0


def test_an_entity_is_read_in_noise_of_its_own_size():
    entity = (CAR, {(ROAD, BELOW), (PERSON, LEFT)}, block((3, 6), (4, 7)))
    (vsr,) = DESCRIPTOR.vsr([layout(entity)], [[1.0]])
    noise = torch.randn(2048, generator=torch.Generator().manual_seed(0))
    (read,) = DECODER.decode(vsr + noise)
    assert (read.kind, read.neighbours, read.cell) == (CAR, entity[1], (4, 5))


def test_scores_are_standard_normal_in_noise_and_high_for_what_is_there():
    noise = torch.randn(2048, generator=torch.Generator().manual_seed(1))
    scores = DECODER.scores(noise)
    assert scores.shape == (3, 19, 16, 16)
    assert abs(scores.mean()) < 0.05
    assert scores.std() == pytest.approx(1.0, abs=0.05)
    symbols = (BOOK.classes[1], BOOK.classes[1], BOOK.classes[3], BOOK.directions[2])
    product = BOOK.cells[9, 8]
    for symbol in symbols:
        product = hrr.bind(product, symbol)
    there = DECODER.scores(product)
    assert np.unravel_index(there.argmax(), there.shape) == (1, 3 * 3 + 2, 9, 8)
    assert there.max() == pytest.approx(np.sqrt(2048), rel=1e-3)  # each phase fits


def test_a_map_is_read_back_from_its_descriptor():
    painting = (
        street()
        .rectangle(CROSSWALK, (150, 160), (40, 184))
        .rectangle(PERSON, (100, 155), (90, 104))
        .rectangle(CAR, (112, 147), (112, 147))
    )
    ssi = DESCRIPTOR.ssi(painting.entities(), painting.classes)
    person, car = (DECODER.decode(vector)[0] for vector in ssi)
    assert (person.kind, person.cell) == (PERSON, (9, 6))
    assert {(CROSSWALK, BELOW), (ROAD, BELOW), (CAR, RIGHT)} <= person.neighbours
    assert (car.kind, car.cell) == (CAR, (9, 9))


@pytest.mark.parametrize(
    ("vector", "message"),
    [
        (torch.zeros(1024), "2048 finite numbers"),
        (torch.zeros(1, 2048), "2048 finite numbers"),
        (torch.full((2048,), float("nan")), "not a finite number"),
        (torch.zeros(2048, dtype=torch.complex64), "are complex"),
    ],
)
def test_what_is_no_vector_of_the_codebook_is_refused(vector, message):
    with pytest.raises(UsageError, match=message):
        DECODER.decode(vector)
    with pytest.raises(UsageError, match=message):
        DECODER.scores(vector.numpy())


@pytest.mark.parametrize("most", [-1, MOST_ENTITIES + 1])
def test_more_entities_than_a_vector_holds_are_not_looked_for(most):
    with pytest.raises(UsageError, match="0 to 100"):
        DECODER.decode(torch.ones(2048), most)


def test_blocks_are_most_like_themselves():
    assert block_likeness(np.stack([block((3, 6), (4, 8)), block((0, 16), (2, 3))])) == (
        pytest.approx([1.0, 1.0])
    )
    (ragged,) = block_likeness(block((3, 6), (4, 8), 0.1)[None])
    assert 0.9 < ragged < 1.0


def test_templates_are_counted():
    blocks = sum(17 - side for side in (1, 2, 3, 4, 6, 8, 12, 16)) ** 2
    assert template_count(0) == 3 * blocks
    assert template_count(2) == 3 * blocks * (1 + 18 + 18 * 17 // 2)
