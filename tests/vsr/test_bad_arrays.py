"""Whatever arrays the public functions are given, they take them or say what they should be."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sfol.errors import SfolError, UsageError
from sfol.facts import Facts
from tests.vsr.painting import GROUNDING, Painting
from vsr.arrays import checked_array
from vsr.classes import CLASS_COUNT, SemanticClass
from vsr.entities import Box, Entity, class_map, find_entities
from vsr.facts import scene_facts
from vsr.hypervectors import hrr
from vsr.hypervectors.attention import attend
from vsr.hypervectors.codebook import Codebook
from vsr.hypervectors.decoding import Decoder
from vsr.hypervectors.descriptor import SceneDescriptor, attention_layers, cell_shares
from vsr.hypervectors.fusion import Fusion
from vsr.networks.inference import stack_gray
from vsr.pictures import attention_overlay, overlay
from vsr.segmentation import Frame, SimulatorSegmenter

SIDE = 32
PAINTING = Painting(SIDE).rectangle(SemanticClass.PEDESTRIAN, (4, 20), (8, 14))
CLASSES, SCENE = PAINTING.classes, PAINTING.one_hot
ENTITIES = PAINTING.entities()
GRAY, BODIES = np.zeros((SIDE, SIDE), np.uint8), np.zeros((SIDE, SIDE), np.int32)
DESCRIPTOR = SceneDescriptor(Codebook(), GROUNDING, "add")
LAYOUT = DESCRIPTOR.layout(ENTITIES, CLASSES)
FEATURES = np.zeros((1, 512, 7, 7), np.float32)
DECODER = Decoder(Codebook(64))
VECTOR = np.ones(64, np.float32)
FRAME = Frame(GRAY, CLASSES, BODIES)


def frame(**changes):
    return replace(FRAME, **changes)


# What is called with an array in one place, and an array that is right there.
CALLS = {
    "class_map of probabilities": (class_map, SCENE),
    "class_map of classes": (class_map, CLASSES),
    "find_entities": (find_entities, SCENE),
    "find_entities, classes": (lambda a: find_entities(SCENE, 1, a), CLASSES),
    "find_entities of a class map": (find_entities, CLASSES),
    "find_entities of a known class map": (lambda a: find_entities(a, 1, CLASSES), CLASSES),
    "find_entities of known classes": (lambda a: find_entities(a, 1, CLASSES), SCENE),
    "scene_facts": (lambda a: scene_facts(ENTITIES, a, GROUNDING, Facts()), CLASSES),
    "layout": (lambda a: DESCRIPTOR.layout(ENTITIES, a), CLASSES),
    "ssi": (lambda a: DESCRIPTOR.ssi(ENTITIES, a), SCENE),
    "vsr, weights": (lambda a: DESCRIPTOR.vsr([LAYOUT], [a], FEATURES), np.ones(1)),
    "vsr, features": (lambda a: DESCRIPTOR.vsr([LAYOUT], [[1.0]], a), FEATURES),
    "entities, features": (lambda a: DESCRIPTOR.entities([LAYOUT], a), FEATURES),
    "bundle": (lambda a: DESCRIPTOR.bundle(torch.ones(1, 4), a), np.ones(1, np.float32)),
    "Layout, kinds": (lambda a: DESCRIPTOR.encode(replace(LAYOUT, kinds=a)), LAYOUT.kinds),
    "Layout, neighbours": (lambda a: replace(LAYOUT, neighbours=a), LAYOUT.neighbours),
    "Layout, coverage": (lambda a: replace(LAYOUT, coverage=a), LAYOUT.coverage),
    "Layout, attention": (lambda a: replace(LAYOUT, attention=a), LAYOUT.attention),
    "Entity, mask": (lambda a: replace(ENTITIES[0], mask=a), ENTITIES[0].mask),
    "Frame, gray": (lambda a: stack_gray([frame(gray=a)]), GRAY),
    "Frame, classes": (lambda a: SimulatorSegmenter()([frame(classes=a)]), CLASSES),
    "Frame, instances": (lambda a: frame(instances=a), BODIES),
    "decode": (DECODER.decode, VECTOR),
    "scores": (DECODER.scores, VECTOR),
    "overlay, gray": (lambda a: overlay(a, CLASSES), GRAY),
    "overlay, classes": (lambda a: overlay(GRAY, a), CLASSES),
    "attention_overlay, gray": (lambda a: attention_overlay(a, LAYOUT.attention), GRAY),
    "attention_overlay, layers": (lambda a: attention_overlay(GRAY, a), LAYOUT.attention),
}
SPOILED = {
    "text": lambda a: a.astype(str),
    "objects": lambda a: a.astype(object),
    "complex": lambda a: a.astype(complex),
    "nothing": lambda a: None,
    "a list of words": lambda a: ["no", "numbers"],
    "one axis more": lambda a: a[None],
    "one axis fewer": lambda a: a[0] if a.ndim > 1 else np.asarray(a[0]),
    "cut": lambda a: a[..., : a.shape[-1] // 4],
    "empty": lambda a: a[..., :0],
    "longer": lambda a: np.concatenate([a, a], axis=-1),
}
# What is wrong only of floats, and only of whole numbers.
NOT_FINITE = {
    "NaN": lambda a: np.full_like(a, np.nan),
    "infinite": lambda a: np.full_like(a, np.inf),
    "one NaN": lambda a: np.where(np.arange(a.size).reshape(a.shape) == 0, np.nan, a),
}
# Where the numbers are looked at only when they are used.
NOT_LOOKED_AT = {
    "Layout, coverage",
    "Layout, attention",
    ("find_entities of known classes", "one NaN"),  # at a pixel that is no entity's
}
# What is right in other sizes, too.
RIGHT_ELSEWHERE = {
    ("class_map of probabilities", "cut"),
    ("class_map of probabilities", "longer"),
    ("class_map of classes", "cut"),
    ("class_map of classes", "longer"),
    ("find_entities", "cut"),
    ("find_entities", "longer"),
    ("find_entities of a class map", "cut"),
    ("find_entities of a class map", "longer"),
    ("scene_facts", "longer"),  # the entities are within a larger map, too
    ("layout", "longer"),
    ("ssi", "longer"),
    ("vsr, weights", "objects"),
    ("find_entities, classes", "nothing"),  # they are found, then
    ("attention_overlay, gray", "cut"),
    ("attention_overlay, gray", "longer"),
}


@pytest.mark.parametrize("name", CALLS)
def test_the_right_array_is_taken(name):
    call, array = CALLS[name]
    call(array)


@pytest.mark.parametrize(
    ("name", "spoiling"), [pair for pair in product(CALLS, SPOILED) if pair not in RIGHT_ELSEWHERE]
)
def test_a_wrong_array_is_an_error_that_names_what_it_should_be(name, spoiling):
    call, array = CALLS[name]
    with pytest.raises(SfolError):
        call(SPOILED[spoiling](array))


@pytest.mark.parametrize(
    ("name", "spoiling"),
    [
        (name, spoiling)
        for (name, (_, array)), spoiling in product(CALLS.items(), NOT_FINITE)
        if array.dtype.kind == "f" and not {name, (name, spoiling)} & NOT_LOOKED_AT
    ],
)
def test_numbers_that_are_not_finite_are_an_error(name, spoiling):
    call, array = CALLS[name]
    with pytest.raises(SfolError):
        call(NOT_FINITE[spoiling](array))


@given(
    st.sampled_from(sorted(CALLS)),
    st.sampled_from(
        [np.uint8, np.int8, np.int64, np.uint16, np.float16, np.float32, np.float64, bool]
    ),
    st.lists(st.sampled_from([0, 1, 2, 7, 27, 28, 32, 512]), max_size=4).map(tuple),
    st.sampled_from([-1, 0, 1, 27, 28, 200, 255, 1e30, np.nan]),
)
@settings(deadline=None, max_examples=300)
def test_any_array_is_taken_or_refused(name, dtype, shape, value):
    if np.prod(shape) > 1e6:
        return
    with np.errstate(all="ignore"):
        array = np.full(shape, value).astype(dtype)
    try:
        CALLS[name][0](array)
    except SfolError as error:
        assert str(error).isprintable()  # noqa: PT017


@pytest.mark.parametrize("number", [CLASS_COUNT, 200, 255])
def test_class_numbers_beyond_the_known_are_refused(number):
    beyond = CLASSES.copy()
    beyond[3, 3] = number
    for call in (
        lambda: class_map(beyond),
        lambda: scene_facts(ENTITIES, beyond, GROUNDING, Facts()),
        lambda: DESCRIPTOR.layout(ENTITIES, beyond),
        lambda: SimulatorSegmenter()([frame(classes=beyond)]),
        lambda: overlay(GRAY, beyond),
    ):
        with pytest.raises(UsageError, match="class"):
            call()


@pytest.mark.parametrize("box", [Box(-1, 0, 15, 6), Box(20, 8, 36, 14), Box(4, 28, 20, 34)])
def test_entities_of_another_map_are_refused(box):
    elsewhere = replace(ENTITIES[0], box=box)
    for call in (
        lambda: scene_facts([elsewhere], CLASSES, GROUNDING, Facts()),
        lambda: DESCRIPTOR.layout([elsewhere], CLASSES),
        lambda: cell_shares([elsewhere], CLASSES.shape, 16),
        lambda: attention_layers([elsewhere], CLASSES.shape),
    ):
        with pytest.raises(UsageError, match="is beyond a map"):
            call()


@pytest.mark.parametrize("confidence", [float("nan"), -0.1, 1.1, float("inf")])
def test_a_confidence_is_from_0_to_1(confidence):
    with pytest.raises(UsageError, match="confidence"):
        Entity("a", SemanticClass.TRUCK, confidence, Box(0, 0, 1, 1), np.ones((1, 1), bool))


@pytest.mark.parametrize("area", [0, -1, 1.5, float("nan"), None, "1"])
def test_a_minimum_area_is_a_whole_number(area):
    with pytest.raises(UsageError, match="minimum_area"):
        find_entities(SCENE, area)


def test_frames_of_two_sizes_are_no_batch():
    half = Frame(GRAY[:16], CLASSES[:16], BODIES[:16])
    for call in (SimulatorSegmenter(), stack_gray):
        with pytest.raises(UsageError, match="are no batch"):
            call([FRAME, half])


def test_layers_and_frames_of_attention_fit_the_features():
    features, layers = torch.ones(2, 512, 7, 7), torch.ones(3, 7, 7)
    attend(features, layers, torch.tensor([0, 1, 1]))
    for wrong, frames in (
        (layers, torch.tensor([0, 1])),
        (layers, torch.tensor([0, 1, 2])),
        (layers, torch.tensor([0, 1, -1])),
        (torch.ones(3, 7, 6), torch.tensor([0, 1, 1])),
    ):
        with pytest.raises(UsageError):
            attend(features, wrong, frames)


def test_a_fusion_takes_as_many_parts_as_it_uses():
    part = torch.ones(2, 4)
    for fusion, parts in (
        ("add", [part]),
        ("ssi", [part, part]),
        ("add", [part, torch.ones(2, 5)]),
    ):
        with pytest.raises(UsageError, match="parts of shapes"):
            Fusion(fusion).fuse(*parts)


TENSORS = [
    torch.ones(4), torch.ones(3), torch.ones(2, 4), torch.ones(3, 4), torch.ones(()), torch.ones(0),
    torch.ones(2, 0), torch.ones(4, dtype=torch.int64), torch.ones(4, dtype=torch.complex64),
]  # fmt: skip


@pytest.mark.parametrize("first", TENSORS)
@pytest.mark.parametrize("second", TENSORS)
def test_vectors_are_bound_bundled_and_compared_or_refused(first, second):
    for call in (hrr.bind, hrr.similarity, hrr.bundle):
        try:
            result = call(first, second)
        except SfolError as error:
            assert "shape" in str(error) or "numbers" in str(error)  # noqa: PT017
        else:
            assert result.isfinite().all()
    for call in (hrr.spectrum, hrr.exact_inverse, hrr.unitary):
        try:
            result = call(first)
        except SfolError as error:
            assert "floats of shape" in str(error)  # noqa: PT017
        else:
            assert result.isfinite().all()


def test_gradients_pass_through_weights_and_features():
    weights = torch.ones(1, requires_grad=True)
    DESCRIPTOR.bundle(torch.ones(1, 4), weights).sum().backward()
    assert weights.grad.tolist() == [4.0]
    features = torch.ones(1, 512, 7, 7, requires_grad=True)
    attend(features, torch.ones(1, 7, 7), torch.tensor([0])).sum().backward()
    assert (features.grad > 0).all()


def test_an_array_says_what_it_is_and_what_it_should_be():
    with pytest.raises(UsageError) as caught:
        checked_array(np.zeros((2, 3)), np.uint8, ("H", "W", 3), "picture")
    assert str(caught.value) == (
        "picture is float64 of shape (2, 3) (an array, uint8 of shape (H, W, 3))"
    )
    with pytest.raises(UsageError, match=r"picture is a list .*shape \(4,\)"):
        checked_array([1, 2], np.uint8, (4,), "picture")
