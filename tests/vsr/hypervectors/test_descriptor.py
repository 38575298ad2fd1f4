import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn.functional import adaptive_avg_pool2d

from sfol.errors import UsageError
from tests.vsr.painting import SIZE, Painting, street
from vsr.classes import DESCRIPTOR_CLASSES, DYNAMIC_CLASSES, SemanticClass
from vsr.entities import Direction
from vsr.grounding import SegmentationGrounding
from vsr.hypervectors import hrr
from vsr.hypervectors.codebook import Codebook
from vsr.hypervectors.descriptor import SceneDescriptor
from vsr.hypervectors.fusion import Fusion

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
        for i, k, d in np.argwhere(layout.neighbours)
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


def test_vectors_of_a_saved_codebook_are_the_same(tmp_path):
    painting, book = scene(), Codebook(dimension=64)
    book.save(tmp_path / "book.safetensors")
    loaded = Codebook.load(tmp_path / "book.safetensors")
    vectors = [
        SceneDescriptor(b).ssi(painting.entities(), painting.classes) for b in (book, loaded)
    ]
    assert torch.equal(*vectors)


FEATURES = torch.rand(2, 512, 7, 7, generator=torch.Generator().manual_seed(0))
WEIGHTS = ([1.0, 0.5, 0.5, 0.75, 0.0], [0.3])


def two_frames(descriptor: SceneDescriptor):
    second = street().rectangle(CAR, (120, 150), (60, 90))
    return [
        descriptor.layout(painting.entities(), painting.classes) for painting in (scene(), second)
    ]


def scaled(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.sqrt((vectors**2).mean(axis=1, keepdims=True))


@pytest.mark.parametrize("method", ["add", "multiply", "ssi", "sf"])
@pytest.mark.parametrize("parts", [True, False])
@pytest.mark.parametrize("entities", [True, False])
def test_vsr_is_the_weighted_sum_of_fused_entities(method, parts, entities):
    descriptor = SceneDescriptor(Codebook(), fusion=Fusion(method, parts, entities))
    layouts = two_frames(descriptor)
    sizes = [len(layout.names) for layout in layouts]
    ssi = descriptor.encode(*layouts).double().numpy()
    layers = np.concatenate([layout.attention for layout in layouts])
    frames = np.repeat([0, 1], sizes)
    sf = np.stack(
        [
            adaptive_avg_pool2d(FEATURES[frame] * torch.from_numpy(layer), 2).flatten().double()
            for frame, layer in zip(frames, layers, strict=True)
        ]
    )
    if parts:
        ssi, sf = scaled(ssi), scaled(sf)
    fused = {"add": ssi + sf, "multiply": ssi * sf, "ssi": ssi, "sf": sf}[method]
    if entities:
        fused = scaled(fused)
    literal = [
        sum(w * e for w, e in zip(WEIGHTS[frame], fused[frames == frame], strict=True))
        for frame in (0, 1)
    ]
    features = None if method == "ssi" else FEATURES.numpy()
    vsr = descriptor.vsr(layouts, WEIGHTS, features)
    assert vsr.dtype == torch.float32
    np.testing.assert_allclose(vsr, literal, rtol=1e-4, atol=1e-5 * np.abs(literal).max())


@pytest.mark.parametrize("method", ["add", "multiply", "ssi", "sf"])
def test_every_fusion_gives_entities_of_one_scale(method):
    descriptor = SceneDescriptor(Codebook(), fusion=method)
    vectors = descriptor.entities(two_frames(descriptor), FEATURES)
    assert vectors.shape == (6, 2048)
    torch.testing.assert_close(vectors.square().mean(dim=1), torch.ones(6))


def test_many_frames_are_described_as_each_alone():
    descriptor = SceneDescriptor(Codebook(), fusion="add")
    layouts = two_frames(descriptor)
    together = descriptor.vsr(layouts, WEIGHTS, FEATURES)
    alone = [
        descriptor.vsr([layout], [weights], features[None])[0]
        for layout, weights, features in zip(layouts, WEIGHTS, FEATURES, strict=True)
    ]
    torch.testing.assert_close(together, torch.stack(alone))


def test_a_frame_without_entities_has_a_descriptor_of_zeros():
    for method in ("add", "multiply", "ssi", "sf"):
        descriptor = SceneDescriptor(Codebook(), fusion=method)
        (full, _) = two_frames(descriptor)
        empty = descriptor.layout((), street().classes)
        vsr = descriptor.vsr([empty, full], [[], WEIGHTS[0]], FEATURES)
        assert not vsr[0].any()
        assert vsr[1].any()
        assert not descriptor.vsr([empty], [[]], FEATURES[:1]).any()


def test_dead_features_leave_the_hypervector():
    descriptor = SceneDescriptor(Codebook(), fusion="add")
    (layout, _) = two_frames(descriptor)
    vectors = descriptor.entities([layout], torch.zeros(1, 512, 7, 7))
    torch.testing.assert_close(vectors, SceneDescriptor(Codebook()).entities([layout]))


def test_ssi_is_computed_on_the_descriptor_s_device():
    """On ``meta``, a device that every machine has, sums and products refuse a processor's tensors."""
    descriptor = SceneDescriptor(Codebook(), device="meta")
    vsr = descriptor.vsr(two_frames(descriptor), WEIGHTS)
    assert (vsr.device.type, vsr.shape) == ("meta", (2, 2048))


# What a GPU computes can only be seen on one: nothing on a processor stands in for its arithmetic.
@pytest.mark.skipif(not torch.cuda.is_available(), reason="compares with a GPU, and there is none")
def test_a_gpu_gives_the_same_vectors():
    here = SceneDescriptor(Codebook(), fusion="add")
    there = SceneDescriptor(Codebook(), fusion="add", device="cuda")
    layouts = two_frames(here)
    expected = here.vsr(layouts, WEIGHTS, FEATURES)
    torch.testing.assert_close(there.vsr(layouts, WEIGHTS, FEATURES).cpu(), expected)


def test_names_say_which_weight_is_whose():
    descriptor = SceneDescriptor(Codebook(dimension=8))
    painting = scene()
    layout = descriptor.layout(painting.entities(), painting.classes)
    assert layout.names == ("pedestrian1", "pedestrian2", "pedestrian3", "vehicle1", "truck1")


def test_fusions_that_cannot_be_are_refused():
    with pytest.raises(UsageError, match=r"unknown fusion 'ad'.*'add'"):
        SceneDescriptor(Codebook(), fusion="ad")
    with pytest.raises(UsageError, match="features with vectors of 1024 numbers"):
        SceneDescriptor(Codebook(dimension=1024), fusion="sf")
    descriptor = SceneDescriptor(Codebook(), fusion="add")
    layouts = two_frames(descriptor)
    with pytest.raises(UsageError, match="needs the encoder's feature maps"):
        descriptor.vsr(layouts, WEIGHTS)
    with pytest.raises(UsageError, match=r"feature maps of shape \(1, .* for 2 frames"):
        descriptor.vsr(layouts, WEIGHTS, FEATURES[:1])


def test_weights_that_do_not_fit_are_refused():
    descriptor = SceneDescriptor(Codebook(dimension=8))
    layouts = two_frames(descriptor)
    with pytest.raises(UsageError, match="4 weights for 5 entities"):
        descriptor.vsr(layouts, [WEIGHTS[0][:4], WEIGHTS[1]])
    with pytest.raises(UsageError, match="weights of 1 frames for 2 frames"):
        descriptor.vsr(layouts, WEIGHTS[:1])
    with pytest.raises(UsageError, match="not a finite number"):
        descriptor.vsr(layouts, [WEIGHTS[0], [float("nan")]])


@pytest.mark.parametrize("method", ["add", "multiply", "ssi", "sf"])
def test_no_frames_are_refused(method):
    with pytest.raises(UsageError, match="at least one frame"):
        SceneDescriptor(Codebook(), fusion=method).vsr([], [], FEATURES[:0])


def test_bad_arguments_are_refused():
    painting = scene()
    descriptor = SceneDescriptor(Codebook(dimension=8))
    ssi = descriptor.ssi(painting.entities(), painting.classes)
    with pytest.raises(UsageError, match="3 weights for 5 entities"):
        descriptor.bundle(ssi, [1.0, 1.0, 1.0])
