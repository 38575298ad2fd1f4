import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sfol.errors import UsageError
from tests.vsr.painting import SIZE, Painting, street
from vsr import hrr
from vsr.classes import DESCRIPTOR_CLASSES, DYNAMIC_CLASSES, SemanticClass
from vsr.codebook import Codebook
from vsr.descriptor import SceneDescriptor
from vsr.entities import Direction
from vsr.grounding import SegmentationGrounding

PERSON, CAR, TRUCK, CROSSWALK = (
    SemanticClass.PEDESTRIAN,
    SemanticClass.VEHICLE,
    SemanticClass.TRUCK,
    SemanticClass.CROSSWALK,
)


def convolved(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Circular convolution by its definition."""
    d = np.arange(len(x))
    return y[(d[:, None] - d) % len(x)] @ x


def literal_ssi(entity, classes: np.ndarray, book: Codebook, window: int) -> np.ndarray:
    """The paper's equations one by one, in float64 and pixel by pixel."""
    h_class = dict(zip(DESCRIPTOR_CLASSES, book.classes.double().numpy(), strict=True))
    h_left, h_right, h_below = book.directions.double().numpy()
    cells = book.cells.double().numpy()
    top, left, bottom, right = entity.box

    def found(kind, rows, columns):
        height, width = classes.shape
        return any(
            classes[r, c] == kind
            for r in rows
            for c in columns
            if 0 <= r < height and 0 <= c < width
        )

    windows = (
        (h_left, range(top, bottom), range(left - window, left)),
        (h_right, range(top, bottom), range(right, right + window)),
        (h_below, range(bottom, bottom + window), range(left, right)),
    )
    c_i = h_class[entity.kind]
    n_i = [
        convolved(convolved(h_class[kind], direction), c_i)
        for direction, rows, columns in windows
        for kind in DESCRIPTOR_CLASSES
        if found(kind, rows, columns)
    ]
    side = classes.shape[0] // 16
    s_i = np.zeros(book.dimension)
    for r, c in zip(*np.nonzero(entity.mask), strict=True):
        s_i += cells[(top + r) // side, (left + c) // side] / side**2
    bound = convolved(c_i, sum(n_i)) if n_i else c_i
    return convolved(bound, s_i)


def scene() -> Painting:
    return (
        street()
        .rectangle(CROSSWALK, (150, 160), (40, 184))
        .rectangle(PERSON, (100, 155), (90, 104))
        .rectangle(PERSON, (110, 135), (0, 9))
        .rectangle(CAR, (110, 140), (110, 140))
        .rectangle(TRUCK, (80, 224), (190, 224))
        .rectangle(PERSON, (20, 21), (30, 31))  # in the sky: no neighbours at all
    )


def test_the_papers_equations():
    painting, book = scene(), Codebook()
    entities = painting.entities()
    ssi = SceneDescriptor(book).ssi(entities, painting.one_hot)
    assert ssi.dtype == torch.float32
    moving = [entity for entity in entities if entity.kind in DYNAMIC_CLASSES]
    assert len(ssi) == len(moving) == 5
    for vector, entity in zip(ssi, moving, strict=True):
        literal = literal_ssi(entity, painting.classes, book, window=15)
        scale = np.sqrt((literal**2).mean())
        np.testing.assert_allclose(vector, literal, rtol=0, atol=1e-5 * scale)


@settings(max_examples=25)
@given(
    st.lists(
        st.tuples(
            st.sampled_from(DESCRIPTOR_CLASSES),
            *[st.integers(0, 31)] * 2,
            *[st.integers(1, 12)] * 2,
        ),
        max_size=8,
    ),
    st.integers(1, 20),
    st.booleans(),
)
def test_the_papers_equations_on_any_map(shapes, window, unitary):
    painting, book = Painting(size=32), Codebook(dimension=33, seed=1, unitary=unitary)
    for kind, top, left, height, width in shapes:
        painting.rectangle(kind, (top, top + height), (left, left + width))
    entities = painting.entities()
    descriptor = SceneDescriptor(book, SegmentationGrounding(window=window))
    ssi = descriptor.ssi(entities, painting.classes)
    moving = [entity for entity in entities if entity.kind in DYNAMIC_CLASSES]
    literal = [literal_ssi(entity, painting.classes, book, window) for entity in moving]
    np.testing.assert_allclose(ssi, np.reshape(literal, (-1, 33)), rtol=0, atol=2e-5)


def test_a_layout_is_what_one_sees():
    painting = (
        Painting()
        .rectangle(SemanticClass.ROAD, (140, 224), (0, SIZE))
        .rectangle(CAR, (112, 140), (70, 84))
        .rectangle(PERSON, (112, 133), (84, 98))
    )
    layout = SceneDescriptor(Codebook(dimension=8)).layout(painting.entities(), painting.classes)
    kinds = [DESCRIPTOR_CLASSES[kind] for kind in layout.kinds]
    assert kinds == [PERSON, CAR]
    directions = list(Direction)
    neighbours = {
        (kinds[i], DESCRIPTOR_CLASSES[k], directions[d])
        for i, k, d in layout.neighbours.nonzero().tolist()
    }
    assert neighbours == {
        (PERSON, CAR, Direction.LEFT_OF),
        (PERSON, SemanticClass.ROAD, Direction.BELOW_OF),
        (CAR, PERSON, Direction.RIGHT_OF),
        (CAR, SemanticClass.ROAD, Direction.BELOW_OF),
    }
    expected = np.zeros((16, 16))
    expected[8, 6], expected[9, 6] = 1.0, 0.5
    np.testing.assert_allclose(layout.coverage[0], expected, atol=1e-6)


def test_a_neighbour_needs_minimum_pixels():
    painting = Painting().rectangle(PERSON, (100, 110), (100, 110))
    painting.rectangle(CAR, (100, 102), (110, 112))

    def neighbours(pixels: int) -> int:
        grounding = SegmentationGrounding(minimum_pixels=pixels)
        descriptor = SceneDescriptor(Codebook(dimension=8), grounding)
        return int(descriptor.layout(painting.entities(), painting.classes).neighbours[0].sum())

    assert (neighbours(4), neighbours(5)) == (1, 0)


def test_without_neighbours_the_entity_does_not_vanish():
    painting = Painting().rectangle(PERSON, (98, 112), (98, 112))
    book = Codebook()
    (vector,) = SceneDescriptor(book).ssi(painting.entities(), painting.classes)
    expected = hrr.bind(book.symbol("class/pedestrian"), book.symbol("cell/7/7"))
    torch.testing.assert_close(vector, expected, rtol=0, atol=1e-6)


def test_the_bundle_is_the_weighted_sum():
    painting = scene()
    descriptor = SceneDescriptor(Codebook(dimension=64))
    ssi = descriptor.ssi(painting.entities(), painting.classes)
    weights = [1.0, 0.5, 0.5, 0.75, 0.0]
    expected = sum(w * v for w, v in zip(weights, ssi, strict=True))
    torch.testing.assert_close(descriptor.bundle(ssi, weights), expected)
    torch.testing.assert_close(descriptor.bundle(ssi, torch.tensor(weights)), expected)


def test_no_entities_give_no_vectors_and_an_empty_bundle():
    descriptor = SceneDescriptor(Codebook())
    crosswalk_only = street().rectangle(CROSSWALK, (150, 160), (40, 184))
    ssi = descriptor.ssi(crosswalk_only.entities(), crosswalk_only.classes)
    assert ssi.shape == (0, 2048)
    assert torch.equal(descriptor.bundle(ssi, []), torch.zeros(2048))


def test_bad_arguments_are_refused():
    painting = scene()
    descriptor = SceneDescriptor(Codebook(dimension=8))
    ssi = descriptor.ssi(painting.entities(), painting.classes)
    with pytest.raises(UsageError, match="3 weights for 5 entities"):
        descriptor.bundle(ssi, [1.0, 1.0, 1.0])
    for side in (8, 100):
        with pytest.raises(UsageError, match=f"side of {side} px"):
            descriptor.ssi((), np.zeros((side, side), np.uint8))
