"""Spatial attention: what an encoder's feature map says about each single entity."""

from __future__ import annotations

from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from sfol.errors import UsageError
from vsr.hypervectors.floats import as_floats

CHANNELS = 512  # of the last stage of a ResNet18
SIZE = 7  # rows and columns of its feature map for pictures of 224 px
POOLED = 2  # so that an entity has 512·2·2 = 2048 numbers, as many as its hypervector
FEATURES = CHANNELS * POOLED * POOLED


def attend(features: NDArray[Any] | Tensor, layers: Tensor, frames: Tensor) -> Tensor:
    """Return SF_i: the feature map of its frame, weighted by the entity's layer and pooled.

    Args:
        features: float (B, 512, 7, 7), the encoder's feature maps.
        layers: float32 (k, 7, 7), the share of each of the map's cells that the entity covers.
        frames: int64 (k,), which of the B frames each entity is in.

    Returns:
        float32 (k, 2048), on the layers' device: for each channel the averages of the four
        quarters of the map, which share their middle row and column (adaptive average pooling).

    Raises:
        UsageError: the feature maps or the layers have another shape, a number is not finite, or
            an entity is in none of the frames.

    Source: paper, section on SF: the entity's layer of the semantic map attends to the features.
        The pooling is a choice of this project, the paper gives the size alone.
    """
    maps = as_floats(features, "features").to(layers)
    if maps.ndim != 4 or maps.shape[1:] != (CHANNELS, SIZE, SIZE):
        raise UsageError(
            f"feature maps have the shape {tuple(maps.shape)}",
            name="features",
            suggestion=f"(B, {CHANNELS}, {SIZE}, {SIZE})",
        )
    if layers.shape != (len(frames), SIZE, SIZE):
        raise UsageError(
            f"layers of shape {tuple(layers.shape)} for {len(frames)} entities",
            name="layers",
            suggestion=f"(k, {SIZE}, {SIZE})",
        )
    if ((frames < 0) | (frames >= len(maps))).any():
        raise UsageError(f"an entity is in none of the {len(maps)} frames", name="frames")
    # Attention and pooling are both linear: together they are four weights for each of 49 cells.
    weights = _POOLING.to(layers) * layers.flatten(1)[:, None]
    quarters = layers.new_zeros(len(layers), POOLED * POOLED, CHANNELS)
    for frame, flat in enumerate(maps.flatten(2)):
        own = (frames == frame).nonzero()[:, 0]
        quarters[own] = weights[own] @ flat.T
    return quarters.mT.flatten(1)


def _pooling() -> Tensor:
    """Return adaptive average pooling as a matrix, float32 (4, 49)."""
    cells = torch.eye(SIZE * SIZE).reshape(-1, 1, SIZE, SIZE)
    pooled: Tensor = adaptive_avg_pool2d(cells, POOLED)
    return pooled.flatten(1).T


_POOLING = _pooling()
