"""The UNet segmenter: grey frames in, probabilities of 28 classes out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import segmentation_models_pytorch
import torch
from numpy.typing import NDArray
from torch import nn

from vsr.classes import CLASS_COUNT
from vsr.inference import Precision, Runner, default_device
from vsr.segmentation import Frame
from vsr.weights import load_weights

# Half as wide as the library's default: speed counts, and the street is not that rich.
DECODER_CHANNELS = (128, 64, 32, 16, 16)
ARCHITECTURE = f"UNet, ResNet18 encoder, decoder {DECODER_CHANNELS}, 1 channel to {CLASS_COUNT}"


def build_unet() -> nn.Module:
    """Return an untrained UNet with a ResNet18 encoder: (B, 1, H, W) to (B, 28, H, W) logits.

    Source: paper, section "Semantic Segmentation Maps"; Ronneberger et al., "U-Net", 2015.
    """
    unet: nn.Module = segmentation_models_pytorch.Unet(
        "resnet18",
        encoder_weights=None,
        in_channels=1,
        classes=CLASS_COUNT,
        decoder_channels=DECODER_CHANNELS,
    )
    return unet


def load_unet(file: Path) -> nn.Module:
    """Return the UNet whose weights a file holds; see `vsr.weights.load_weights`."""
    unet = build_unet()
    load_weights(file, unet)
    return unet


class UNetSegmenter:
    """A trained UNet as a `Segmenter`.

    Args:
        unet: what `build_unet` returns, trained. It is taken over and can't be trained further.
        precision: arithmetic; ``auto`` takes the fastest that the hardware has.
        device: where to compute; the GPU where there is one.
    """

    def __init__(
        self,
        unet: nn.Module,
        precision: Precision = "auto",
        device: torch.device | None = None,
    ) -> None:
        self._runner = Runner(unet, precision, device or default_device())

    @classmethod
    def load(
        cls, file: Path, precision: Precision = "auto", device: torch.device | None = None
    ) -> UNetSegmenter:
        """Return the segmenter whose weights a file holds; see `vsr.weights.load_weights`."""
        return cls(load_unet(file), precision, device)

    def __call__(self, frames: Sequence[Frame]) -> NDArray[np.float32]:
        """Return class probabilities, float32 (B, 28, H, W), that sum to one over axis 1.

        Raises:
            UsageError: there are no frames, or their sides are no multiples of 32.
        """
        logits = self._runner(frames)
        # Rows of pixels lie together in memory, as everything that reads a class's layer expects.
        probabilities = torch.softmax(logits.contiguous(), dim=1, dtype=torch.float32)
        segmented: NDArray[np.float32] = probabilities.cpu().numpy()
        return segmented
