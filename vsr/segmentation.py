"""Segmenters: camera frames in, segmentation maps out, one protocol for all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sfol.errors import UsageError
from vsr.arrays import checked_array
from vsr.classes import CLASS_COUNT


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of the dash camera, with what the renderer knows about it.

    Attributes:
        gray: uint8 (H, W), grey values, 224×224 in the paper.
        classes: uint8 (H, W), the `SemanticClass` of each pixel.
        instances: int32 (H, W), the body that each pixel belongs to, -1 where there is none.

    Raises:
        UsageError: an array has another type, or they differ in shape.
    """

    gray: NDArray[np.uint8]
    classes: NDArray[np.uint8]
    instances: NDArray[np.int32]

    def __post_init__(self) -> None:
        shape = checked_array(self.gray, np.uint8, ("H", "W"), "gray").shape
        checked_array(self.classes, np.uint8, shape, "classes")
        checked_array(self.instances, np.signedinteger, shape, "instances")


class Segmenter(Protocol):
    """Anything that turns frames into segmentation maps."""

    def __call__(self, frames: Sequence[Frame]) -> NDArray[np.float32] | NDArray[np.uint8]:
        """Segment a batch of B frames.

        Returns:
            float32 (B, 28, H, W), per-pixel class probabilities that sum to one over axis 1
            (paper, section "Semantic Segmentation Maps"); or, from a segmenter that is certain,
            uint8 (B, H, W), the `SemanticClass` of each pixel.
        """
        ...


def check_alike(frames: Sequence[Frame], who: str) -> None:
    """Refuse frames that are no batch.

    Args:
        frames: to be stacked.
        who: needs them.

    Raises:
        UsageError: there are none, or they differ in size.
    """
    if not frames:
        raise UsageError(f"{who} needs at least one frame", name="frames")
    sizes = sorted({frame.gray.shape for frame in frames})
    if len(sizes) > 1:
        raise UsageError(
            f"frames of sizes {sizes[0]} and {sizes[1]} are no batch",
            name="frames",
            suggestion="one size, (H, W), for all",
        )


class SimulatorSegmenter:
    """The simulator's own class map, which is certain.

    It goes through the same code as a network's output, so that nothing but the segmenter differs.
    """

    def __call__(self, frames: Sequence[Frame]) -> NDArray[np.uint8]:
        """Return the frames' class maps, uint8 (B, H, W).

        Raises:
            UsageError: there are no frames, they differ in size, or a class has no such number.
        """
        check_alike(frames, "a segmenter")
        classes = np.stack([frame.classes for frame in frames])
        if classes.max() >= CLASS_COUNT:
            raise UsageError(
                f"a frame has the class {classes.max()}",
                name="classes",
                suggestion=f"classes are 0 to {CLASS_COUNT - 1}",
            )
        return classes
