"""Segmenters: camera frames in, class probabilities out, one protocol for all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sfol.errors import UsageError
from vsr.classes import CLASS_COUNT


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of the dash camera, with what the renderer knows about it.

    Attributes:
        gray: uint8 (H, W), grey values, 224×224 in the paper.
        classes: uint8 (H, W), the `SemanticClass` of each pixel.
        instances: int32 (H, W), the body that each pixel belongs to, -1 where there is none.
    """

    gray: NDArray[np.uint8]
    classes: NDArray[np.uint8]
    instances: NDArray[np.int32]


class Segmenter(Protocol):
    """Anything that turns frames into segmentation maps."""

    def __call__(self, frames: Sequence[Frame]) -> NDArray[np.float32]:
        """Segment a batch of B frames.

        Returns:
            float32 (B, 28, H, W), per-pixel class probabilities that sum to one over axis 1
            (paper, section "Semantic Segmentation Maps").
        """
        ...


class SimulatorSegmenter:
    """The simulator's own class map as one-hot probabilities.

    It goes through the same code as a network's output, so that nothing but the segmenter differs.
    """

    def __call__(self, frames: Sequence[Frame]) -> NDArray[np.float32]:
        """Return the frames' class maps, float32 (B, 28, H, W), one-hot over axis 1.

        Raises:
            UsageError: there are no frames.
        """
        if not frames:
            raise UsageError("a segmenter needs at least one frame", name="frames")
        labels = np.stack([frame.classes for frame in frames])
        channels = np.arange(CLASS_COUNT, dtype=labels.dtype)[:, None, None]
        one_hot: NDArray[np.float32] = (labels[:, None] == channels).astype(np.float32)
        return one_hot
