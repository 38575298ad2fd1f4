"""The ResNet18 autoencoder: its encoder's feature maps say what a frame looks like where."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import cast

import torch
import torchvision  # type: ignore[import-untyped]
from torch import Tensor, nn

from vsr.networks.inference import Precision
from vsr.networks.runtime import RuntimeName, runtime_of
from vsr.networks.weights import load_weights
from vsr.segmentation import Frame

CHANNELS = 512  # of the encoder's last stage
ARCHITECTURE = "autoencoder, ResNet18 encoder to 512×7×7, decoder (128, 64, 32, 16)"


class Autoencoder(nn.Module):
    """A ResNet18 that sees one channel, and a light decoder back to the picture.

    Args:
        widths: channels of the decoder's stages, each of which doubles the sides.

    Attributes:
        encoder: (B, 1, H, W) to (B, 512, H/32, W/32).
        decoder: back to (B, 1, H, W).

    Source: paper, section on SF; He et al., "Deep Residual Learning", 2016.
    """

    def __init__(self, widths: tuple[int, ...] = (128, 64, 32, 16)) -> None:
        super().__init__()
        self.encoder = _encoder()
        stages = zip((CHANNELS, *widths), widths, strict=False)
        self.decoder = nn.Sequential(
            *(_doubled(before, after) for before, after in stages),
            # The last doubling only rearranges channels: pictures are large, features are not.
            nn.Conv2d(widths[-1], 4, kernel_size=3, padding=1),
            nn.PixelShuffle(2),
        )

    def start_from(self, unet: nn.Module) -> None:
        """Take the weights of a UNet's encoder, which is a ResNet18 too.

        An encoder that has learnt to see the street once learns to remember it much faster.

        Args:
            unet: what `vsr.networks.unet.build_unet` returns, trained.
        """
        encoder = cast(nn.Module, unet.encoder)
        self.encoder.load_state_dict(encoder.state_dict())

    def forward(self, pictures: Tensor) -> Tensor:
        """Return the pictures as far as the feature map remembers them.

        Args:
            pictures: float (B, 1, H, W), from -1 to 1; H and W are multiples of 32.
        """
        return cast(Tensor, self.decoder(self.encoder(pictures)))


def load_autoencoder(file: Path) -> Autoencoder:
    """Return the autoencoder in a file; see `vsr.networks.weights.load_weights`."""
    autoencoder = Autoencoder()
    load_weights(file, autoencoder)
    return autoencoder


def _encoder() -> nn.Module:
    resnet = torchvision.models.resnet18(weights=None)
    resnet.conv1 = nn.Conv2d(1, 64, kernel_size=7, stride=2, padding=3, bias=False)
    stages = dict(list(resnet.named_children())[:-2])  # without pooling and classifier
    return nn.Sequential(OrderedDict(stages))


def _doubled(before: int, after: int) -> nn.Module:
    return nn.Sequential(
        nn.Upsample(scale_factor=2, mode="nearest"),
        nn.Conv2d(before, after, kernel_size=3, padding=1, bias=False),
        nn.BatchNorm2d(after),
        nn.ReLU(inplace=True),
    )


class FeatureEncoder:
    """The encoder of a trained autoencoder.

    Args:
        autoencoder: trained. Its encoder is taken over and can't be trained further.
        precision: arithmetic; ``auto`` takes the fastest that the hardware has.
        device: where to compute; the GPU where there is one.
        runtime: what runs the network; see `vsr.networks.runtime.runtime_of`.
    """

    def __init__(
        self,
        autoencoder: Autoencoder,
        precision: Precision = "auto",
        device: torch.device | None = None,
        runtime: RuntimeName = "auto",
    ) -> None:
        self._run = runtime_of(autoencoder.encoder, runtime, precision, device)

    @classmethod
    def load(
        cls,
        file: Path,
        precision: Precision = "auto",
        device: torch.device | None = None,
        runtime: RuntimeName = "auto",
    ) -> FeatureEncoder:
        """Return the encoder in a file; see `vsr.networks.weights.load_weights`."""
        return cls(load_autoencoder(file), precision, device, runtime)

    def encode(self, frames: Sequence[Frame]) -> Tensor:
        """Return the feature maps of frames, float32 (B, 512, H/32, W/32), on the device.

        Raises:
            UsageError: there are no frames, or their sides are no multiples of 32.
        """
        return self._run(frames).float().contiguous()
