import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from torch.nn.functional import adaptive_avg_pool2d

from sfol.errors import UsageError
from vsr.classes import SemanticClass
from vsr.entities import Box, Entity
from vsr.hypervectors import attention
from vsr.hypervectors.descriptor import cell_shares


def features(frames: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(frames)
    return torch.rand(frames, 512, 7, 7, generator=generator)


def an_entity(mask: np.ndarray, top: int = 0, left: int = 0) -> Entity:
    box = Box(top, left, top + mask.shape[0], left + mask.shape[1])
    return Entity("pedestrian1", SemanticClass.PEDESTRIAN, 1.0, box, mask)


@settings(max_examples=20)
@given(
    arrays(np.float32, (3, 7, 7), elements=st.floats(0, 1, width=16)), st.permutations([0, 1, 1])
)
def test_attention_is_the_layer_times_the_map_pooled(layers, frames):
    maps = features(2)
    attended = attention.attend(maps, torch.from_numpy(layers), torch.tensor(frames))
    for vector, layer, frame in zip(attended, layers, frames, strict=True):
        literal = adaptive_avg_pool2d(maps[frame] * torch.from_numpy(layer), 2).flatten()
        torch.testing.assert_close(vector, literal, rtol=1e-5, atol=1e-6)


def test_numpy_arrays_do_as_well_and_no_entities_give_no_vectors():
    maps, layers, frames = features(1), torch.ones(2, 7, 7), torch.zeros(2, dtype=torch.int64)
    given_numpy = attention.attend(maps.numpy(), layers, frames)
    assert torch.equal(given_numpy, attention.attend(maps, layers, frames))
    assert attention.attend(maps, layers[:0], frames[:0]).shape == (0, 2048)


def test_an_entity_sees_nothing_of_where_it_is_not():
    layer, maps = torch.zeros(1, 7, 7), features(1)
    layer[0, 5, 6] = 1.0
    frames = torch.zeros(1, dtype=torch.int64)
    before = attention.attend(maps, layer, frames)
    elsewhere = torch.ones(7, 7, dtype=torch.bool)
    elsewhere[5, 6] = False
    assert torch.equal(attention.attend(maps.masked_fill(elsewhere, 9.0), layer, frames), before)
    quarters = before.reshape(512, 2, 2)
    assert not quarters[:, 0].any()
    assert not quarters[:, :, 0].any()
    assert torch.allclose(quarters[:, 1, 1], maps[0, :, 5, 6] / 16)


@settings(max_examples=20)
@given(arrays(np.bool_, (40, 30)), st.integers(0, 184), st.integers(0, 194))
def test_the_layer_is_the_mask_averaged_over_areas(mask, top, left):
    canvas = np.zeros((224, 224), np.float32)
    canvas[top : top + 40, left : left + 30] = mask
    (layer,) = cell_shares([an_entity(mask, top, left)], (224, 224), 7)
    literal = adaptive_avg_pool2d(torch.from_numpy(canvas)[None], 7)[0]
    np.testing.assert_allclose(layer, literal, atol=1e-6)


@given(st.integers(1, 40), st.integers(1, 40), st.integers(1, 16))
def test_shares_of_pictures_of_any_size_add_up_to_the_area(height, width, cells):
    rng = np.random.default_rng(height)
    mask = rng.random((height, width)) < 0.5
    (shares,) = cell_shares([an_entity(mask)], (height, width), cells)
    assert shares.sum() * height * width / cells**2 == pytest.approx(mask.sum(), abs=1e-3)
    (whole,) = cell_shares([an_entity(np.ones_like(mask))], (height, width), cells)
    np.testing.assert_allclose(whole, 1.0, atol=1e-5)


@pytest.mark.parametrize("shape", [(512, 7, 7), (1, 512, 7, 8), (1, 256, 7, 7)])
def test_other_feature_maps_are_refused(shape):
    with pytest.raises(UsageError, match="feature maps have the shape"):
        attention.attend(torch.zeros(shape), torch.ones(1, 7, 7), torch.zeros(1, dtype=torch.int64))
