import numpy as np
import pytest

from sfol.errors import MissingExtraError
from tests.vsr.painting import street
from vsr import pictures
from vsr.classes import COLOURS, SemanticClass
from vsr.entities import Direction
from vsr.hypervectors.codebook import Codebook
from vsr.hypervectors.decoding import DecodedEntity
from vsr.hypervectors.descriptor import SceneDescriptor

PERSON, CAR = SemanticClass.PEDESTRIAN, SemanticClass.VEHICLE
GRAY = np.full((224, 224), 100, np.uint8)


def near(picture: np.ndarray, colour: tuple[int, ...]) -> np.ndarray:
    """Where a picture has a colour, give or take what smoothing does."""
    return np.abs(picture.astype(int) - colour).max(axis=-1) < 12


def test_the_overlay_tints_every_class_in_its_colour():
    classes = street().rectangle(PERSON, (120, 150), (60, 70)).classes
    picture = pictures.overlay(GRAY, classes, strength=1.0)
    assert picture.dtype == np.uint8
    assert tuple(picture[130, 65]) == COLOURS[PERSON]
    assert tuple(picture[200, 100]) == COLOURS[SemanticClass.ROAD]
    assert np.array_equal(pictures.overlay(GRAY, classes, 0.0), np.stack([GRAY] * 3, axis=-1))


def test_attention_is_bright_where_entities_are():
    layers = np.zeros((2, 7, 7), np.float32)
    layers[0, 3, 2], layers[1, 6, 6] = 1.0, 0.25
    picture = pictures.attention_overlay(GRAY, layers).sum(axis=-1)
    assert picture[3 * 32 + 5, 2 * 32 + 5] > picture[223, 223] > picture[0, 0]
    assert (pictures.attention_overlay(GRAY, layers[:0]) < 100).all()


def test_a_scene_is_drawn_with_entities_attention_and_facts():
    painting = (
        street().rectangle(PERSON, (120, 150), (60, 70)).rectangle(CAR, (110, 150), (90, 140))
    )
    layers = SceneDescriptor(Codebook(8)).layout(painting.entities(), painting.classes).attention
    figure = pictures.draw_scene(
        GRAY, painting.classes, painting.entities(), layers, painting.facts()
    )
    texts = {text.get_text() for axis in figure.axes for text in axis.texts}
    assert {"pedestrian1", "vehicle1"} <= texts
    assert any("IsNear" not in text and "Pedestrian(pedestrian1)" in text for text in texts)
    picture = pictures.as_rgb(figure)
    assert picture.dtype == np.uint8
    assert picture.shape[2] == 3
    assert near(picture, COLOURS[CAR]).any()  # the outline of its box


def decoded(kind, row: int, column: int, *neighbours) -> DecodedEntity:
    coverage = np.zeros((16, 16), np.float32)
    coverage[row : row + 3, column : column + 2] = 1.0
    return DecodedEntity(kind, frozenset(neighbours), coverage, 12.3)


def test_what_was_read_is_drawn_on_the_grid_with_its_neighbours():
    beside = ((SemanticClass.ROAD, Direction.BELOW_OF), (CAR, Direction.RIGHT_OF))
    figure = pictures.draw_decoded([decoded(PERSON, 5, 3, *beside), decoded(CAR, 6, 9)], "VSR")
    texts = [text.get_text() for axis in figure.axes for text in axis.texts]
    assert texts[:2] == ["1", "2"]
    assert texts[2].splitlines() == [" 1 pedestrian (12)  → vehicle  ↓ road", " 2 vehicle (12)"]
    picture = pictures.as_rgb(figure)
    assert near(picture, COLOURS[PERSON]).sum() == pytest.approx(
        near(picture, COLOURS[CAR]).sum(), rel=0.1
    )


def test_an_empty_vector_says_so():
    (_, text) = pictures.draw_decoded([]).axes
    assert text.texts[0].get_text() == "nothing is read"


def test_without_matplotlib_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"sfol\[plot\]"):
        pictures.draw_decoded([])
