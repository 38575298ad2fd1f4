"""What the autoencoder learns: to draw a frame again from 512·7·7 numbers."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss

from vsr.networks.inference import default_device, to_input, training_dtype
from vsr.training.augmentation import relight
from vsr.training.frames import FrameSet
from vsr.training.loop import Metrics, batches


class AutoencoderTask:
    """Reconstruction of frames, their edges included.

    Args:
        network: (B, 1, H, W) to (B, 1, H, W).
        train: frames to learn from.
        validation: frames of other streets.
        device: where to compute.
    """

    def __init__(
        self,
        network: nn.Module,
        train: FrameSet,
        validation: FrameSet,
        device: torch.device | None = None,
    ) -> None:
        self._device = device or default_device()
        self._dtype = training_dtype(self._device)
        self.network = network.to(self._device).to(memory_format=torch.channels_last)
        self.size = len(train)
        self._train = torch.from_numpy(train.gray)
        self._validation = torch.from_numpy(validation.gray)

    def loss(self, indices: Tensor, rng: torch.Generator, progress: float) -> Tensor:
        """Return the squared error of values and of differences between neighbours."""
        inputs = relight(to_input(self._train[indices]), rng)
        inputs = inputs.to(self._device, memory_format=torch.channels_last)
        return reconstruction_loss(self._reconstruct(inputs), inputs)

    def validate(self) -> Metrics:
        """Return the mean peak signal-to-noise ratio, in dB, which is the score."""
        ratios = []
        for part in batches(len(self._validation), 16):
            inputs = to_input(self._validation[part])
            inputs = inputs.to(self._device, memory_format=torch.channels_last)
            ratios.append(psnr(self._reconstruct(inputs), inputs).cpu())
        return {"score": float(torch.cat(ratios).mean())}

    def _reconstruct(self, inputs: Tensor) -> Tensor:
        reduced = self._dtype != torch.float32
        with torch.autocast(self._device.type, torch.bfloat16, enabled=reduced):
            drawn: Tensor = self.network(inputs)
        return drawn.float()


def reconstruction_loss(drawn: Tensor, pictures: Tensor) -> Tensor:
    """Return the mean squared error of grey values and of their differences in both directions.

    Differences are where things end: without them a distant pedestrian, a few pixels among fifty
    thousand, would hardly count.

    Args:
        drawn: float32 (B, 1, H, W).
        pictures: what they should be, of the same shape.
    """
    error = drawn - pictures
    across, down = error.diff(dim=3), error.diff(dim=2)
    return mse_loss(drawn, pictures) + across.square().mean() + down.square().mean()


def psnr(drawn: Tensor, pictures: Tensor) -> Tensor:
    """Return the peak signal-to-noise ratio of each picture, in dB, float32 (B,).

    10 log₁₀(peak² / mean squared error), where grey values reach from -1 to 1: the peak is 2.

    Args:
        drawn: float32 (B, 1, H, W).
        pictures: what they should be, of the same shape.
    """
    error = (drawn.clamp(-1.0, 1.0) - pictures).square().mean(dim=(1, 2, 3))
    return 20.0 * math.log10(2.0) - 10.0 * torch.log10(error)
