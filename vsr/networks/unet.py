"""The UNet segmenter: grey frames in, probabilities of 28 classes out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import segmentation_models_pytorch
import torch
from numpy.typing import NDArray
from segmentation_models_pytorch.decoders.unet.decoder import UnetDecoderBlock
from torch import Tensor, nn

from vsr.classes import CLASS_COUNT
from vsr.networks.inference import Precision
from vsr.networks.runtime import RuntimeName, runtime_of
from vsr.networks.weights import load_weights
from vsr.segmentation import Frame

# Half as wide as the library's default: speed counts, and the street is not that rich.
DECODER_CHANNELS = (128, 64, 32, 16, 16)
DETAIL_CHANNELS = 16
ARCHITECTURE = (
    f"UNet, ResNet18 encoder, decoder {DECODER_CHANNELS}, {DETAIL_CHANNELS} channels of detail, "
    f"1 channel to {CLASS_COUNT}"
)


class _UNet(segmentation_models_pytorch.Unet):  # type: ignore[misc]
    """The library's UNet, with a skip connection at the full resolution as well.

    The encoder's first stage halves the sides, so its finest features are two pixels wide; arms and
    legs are as thin as that.
    """

    def __init__(self) -> None:
        super().__init__(
            "resnet18",
            encoder_weights=None,
            in_channels=1,
            classes=CLASS_COUNT,
            decoder_channels=DECODER_CHANNELS,
        )
        self.detail = nn.Sequential(
            nn.Conv2d(1, DETAIL_CHANNELS, kernel_size=5, padding=2, bias=False),
            nn.BatchNorm2d(DETAIL_CHANNELS),
            nn.ReLU(),
        )
        before, last = DECODER_CHANNELS[-2:]
        self.decoder.blocks[-1] = UnetDecoderBlock(before, DETAIL_CHANNELS, last)

    def forward(self, pictures: Tensor) -> Tensor:
        first, *deeper = self.encoder(pictures)
        decoded = self.decoder([first, self.detail(pictures), *deeper])
        logits: Tensor = self.segmentation_head(decoded)
        return logits


def build_unet() -> nn.Module:
    """Return an untrained UNet with a ResNet18 encoder: (B, 1, H, W) to (B, 28, H, W) logits.

    Source: paper, section "Semantic Segmentation Maps"; Ronneberger et al., "U-Net", 2015.
    """
    return _UNet()


def load_unet(file: Path) -> nn.Module:
    """Return the UNet in a file; see `vsr.networks.weights.load_weights`."""
    unet = build_unet()
    load_weights(file, unet)
    return unet


class UNetSegmenter:
    """A trained UNet as a `Segmenter`.

    Args:
        unet: what `build_unet` returns, trained. It is taken over and can't be trained further.
        precision: arithmetic; ``auto`` takes the fastest that the hardware has.
        device: where to compute; the GPU where there is one.
        runtime: what runs the network; see `vsr.networks.runtime.runtime_of`.
    """

    def __init__(
        self,
        unet: nn.Module,
        precision: Precision = "auto",
        device: torch.device | None = None,
        runtime: RuntimeName = "auto",
    ) -> None:
        self._run = runtime_of(unet, runtime, precision, device)

    @classmethod
    def load(
        cls,
        file: Path,
        precision: Precision = "auto",
        device: torch.device | None = None,
        runtime: RuntimeName = "auto",
    ) -> UNetSegmenter:
        """Return the segmenter in a file; see `vsr.networks.weights.load_weights`."""
        return cls(load_unet(file), precision, device, runtime)

    def __call__(self, frames: Sequence[Frame]) -> NDArray[np.float32]:
        """Return class probabilities, float32 (B, 28, H, W), that sum to one over axis 1.

        Raises:
            UsageError: there are no frames, or their sides are no multiples of 32.
        """
        logits = self._run(frames)
        # Rows of pixels lie together in memory, as everything that reads a class's layer expects.
        probabilities = torch.softmax(logits.contiguous(), dim=1, dtype=torch.float32)
        segmented: NDArray[np.float32] = probabilities.cpu().numpy()
        return segmented
