"""Maps that nobody expects: each has a descriptor, or an error that says what is wrong."""

import numpy as np
import pytest
import torch

from sfol.errors import UsageError
from sfol.facts import Facts
from tests.vsr.painting import GROUNDING, SIZE, Painting, atoms, street
from vsr.classes import CLASS_COUNT, DYNAMIC_CLASSES, SemanticClass
from vsr.entities import find_entities
from vsr.facts import scene_facts
from vsr.hypervectors.codebook import Codebook
from vsr.hypervectors.descriptor import SceneDescriptor

PERSON, CAR = SemanticClass.PEDESTRIAN, SemanticClass.VEHICLE


@pytest.fixture(scope="module")
def descriptor():
    return SceneDescriptor(Codebook(), GROUNDING)


def describe(descriptor: SceneDescriptor, painting: Painting):
    """Everything from map to vector: facts, layout, VSR with weights of one."""
    entities = painting.entities()
    facts = scene_facts(entities, painting.one_hot, GROUNDING, Facts())
    layout = descriptor.layout(entities, painting.one_hot)
    (vsr,) = descriptor.vsr([layout], [np.ones(len(layout.names))])
    assert vsr.shape == (2048,)
    assert vsr.isfinite().all()
    return facts, layout, vsr


@pytest.mark.parametrize("kind", [SemanticClass.SKY, SemanticClass.ROAD])
def test_no_entity(descriptor, kind):
    facts, layout, vsr = describe(descriptor, Painting().rectangle(kind, (0, SIZE), (0, SIZE)))
    assert not vsr.any()
    assert layout.names == ()
    assert {str(atom) for atom in facts} == {"NoCrosswalk(ego)", "EmptyLane(ego)"}


@pytest.mark.parametrize("row", [0, 112, SIZE - 1])
@pytest.mark.parametrize("column", [0, 112, SIZE - 1])
def test_one_pixel(descriptor, row, column):
    painting = street().rectangle(PERSON, (row, row + 1), (column, column + 1))
    facts, layout, vsr = describe(descriptor, painting)
    assert "Pedestrian(pedestrian1)" in atoms(facts, "Pedestrian")
    assert layout.coverage[0, row // 14, column // 14] == pytest.approx(1 / 196)
    assert np.count_nonzero(layout.coverage) == 1
    # interpolated between the cells around it, a pixel is still as large as it is
    assert 1 <= np.count_nonzero(layout.attention) <= 4
    assert layout.attention.sum() == pytest.approx(1 / 32**2)
    assert vsr.square().mean().item() == pytest.approx(1.0, rel=1e-4)


def test_one_entity_everywhere(descriptor):
    _, layout, vsr = describe(descriptor, Painting().rectangle(CAR, (0, SIZE), (0, SIZE)))
    assert np.allclose(layout.coverage, 1.0)
    assert not layout.neighbours.any()
    assert vsr.square().mean().item() == pytest.approx(1.0, rel=1e-4)


def test_two_hundred_entities(descriptor):
    painting = street()
    for number in range(200):
        row, column = divmod(number, 20)
        top, left = 20 * row + 5, 11 * column + 2
        painting.rectangle(PERSON, (top, top + 12), (left, left + 6))
    facts, layout, vsr = describe(descriptor, painting)
    assert len(layout.names) == len(set(layout.names)) == 200
    assert len(atoms(facts, "Pedestrian")) == 200
    # unlike vectors add up like noise, and like ones faster
    assert vsr.square().mean().sqrt() > np.sqrt(200) * 0.9


def test_touching_entities_of_one_class_are_one(descriptor):
    two = street().rectangle(PERSON, (120, 150), (60, 70)).rectangle(PERSON, (120, 150), (70, 80))
    one = street().rectangle(PERSON, (120, 150), (60, 80))
    assert describe(descriptor, two)[1].names == ("pedestrian1",)
    assert torch.equal(describe(descriptor, two)[2], describe(descriptor, one)[2])


def test_touching_entities_of_two_classes_are_neighbours(descriptor):
    painting = street().rectangle(PERSON, (120, 150), (60, 70)).rectangle(CAR, (120, 150), (70, 99))
    facts, layout, _ = describe(descriptor, painting)
    assert layout.names == ("pedestrian1", "vehicle1")
    assert layout.neighbours[0, 1].tolist() == [False, True, False]  # the car is right of her
    assert layout.neighbours[1, 0].tolist() == [True, False, False]
    assert "IsNear(pedestrian1, vehicle1)" in atoms(facts, "IsNear")


@pytest.mark.parametrize(
    ("rows", "columns"),
    [
        ((0, 30), (100, 120)),
        ((200, SIZE), (100, 120)),
        ((100, 130), (0, 9)),
        ((100, 130), (215, SIZE)),
    ],
)
def test_entities_cut_by_the_border(descriptor, rows, columns):
    _, layout, vsr = describe(descriptor, Painting().rectangle(CAR, rows, columns))
    area = (rows[1] - rows[0]) * (columns[1] - columns[0])
    assert layout.coverage.sum() * 196 == pytest.approx(area, rel=1e-4)
    assert not layout.neighbours.any()
    assert vsr.any()


@pytest.mark.parametrize("size", [1, 7, 10, 16, 100, 225, 300])
def test_maps_of_any_size(descriptor, size):
    painting = Painting(size).rectangle(PERSON, (0, size), (0, size))
    _, layout, vsr = describe(descriptor, painting)
    assert np.allclose(layout.coverage, 1.0, atol=1e-4)
    assert vsr.any()


def spoiled(value: float, where=(1, 3, 3)) -> np.ndarray:
    probabilities = street().one_hot
    probabilities[where] = value
    return probabilities


@pytest.mark.parametrize(
    "bad",
    [
        spoiled(np.nan),
        spoiled(np.inf),
        spoiled(-1.0),
        spoiled(0.5),
        spoiled(0.5, np.s_[:]),
        spoiled(0.0, np.s_[:]),
        spoiled(np.nan, np.s_[:]),
    ],
    ids=["nan", "infinity", "negative", "one pixel", "all", "zero", "all nan"],
)
def test_maps_that_are_no_probabilities_are_refused_by_every_stage(descriptor, bad):
    entities = street().rectangle(PERSON, (120, 150), (60, 70)).entities()
    stages = (
        lambda: find_entities(bad),
        lambda: scene_facts(entities, bad, GROUNDING, Facts()),
        lambda: descriptor.ssi(entities, bad),
        lambda: descriptor.layout(entities, bad),
    )
    for stage in stages:
        with pytest.raises(UsageError, match="do not sum to one") as caught:
            stage()
        assert "softmax" in str(caught.value)


@pytest.mark.parametrize("shape", [(CLASS_COUNT, 0, 0), (27, 8, 8), (CLASS_COUNT, 8), (0, 0)])
def test_maps_of_other_shapes_are_refused(descriptor, shape):
    with pytest.raises(UsageError, match=r"a segmentation map is .* of shape"):
        descriptor.ssi((), np.zeros(shape, np.float32))


def test_probabilities_that_are_all_alike_show_the_first_class(descriptor):
    even = np.full((CLASS_COUNT, SIZE, SIZE), 1 / CLASS_COUNT, np.float32)
    assert find_entities(even) == ()
    assert descriptor.ssi((), even).shape == (0, 2048)


def test_unsure_maps_have_entities_of_little_confidence(descriptor):
    probabilities = np.full((CLASS_COUNT, SIZE, SIZE), 0.9 / 27, np.float32)
    probabilities[PERSON] = 0.1
    (person,) = find_entities(probabilities)
    assert person.confidence == pytest.approx(0.1)
    assert person.kind in DYNAMIC_CLASSES
    assert descriptor.ssi([person], probabilities).isfinite().all()
