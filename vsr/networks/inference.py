"""How networks are run: the device, the arithmetic, and what frames become before they go in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn
from torch.fx.experimental.optimization import fuse

from sfol.errors import UsageError
from vsr.segmentation import Frame, check_alike

Precision = Literal["auto", "float32", "bfloat16"]


def default_device() -> torch.device:
    """Return the GPU where there is one, else the processor."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def arithmetic(precision: Precision, device: torch.device) -> torch.dtype:
    """Return the type to compute in.

    Args:
        precision: ``auto`` takes bfloat16 where the hardware computes in it (GPUs, processors with
            AVX512-BF16 or AMX), float32 elsewhere: emulated, bfloat16 is slower.
        device: where it will be computed.
    """
    if precision == "auto":
        precision = "bfloat16" if _computes_in_bfloat16(device) else "float32"
    return torch.bfloat16 if precision == "bfloat16" else torch.float32


def training_dtype(device: torch.device) -> torch.dtype:
    """Return the type to train in: bfloat16 on GPUs that compute in it, float32 elsewhere.

    On a processor with AMX, gradients of the autoencoder in bfloat16 were NaN for half of twelve
    seeds after one step (torch 2.14.1), and never in float32.
    """
    return arithmetic("auto", device) if device.type == "cuda" else torch.float32


def _computes_in_bfloat16(device: torch.device) -> bool:
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    # torch has no public name for this question.
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())


def to_input(gray: Tensor) -> Tensor:
    """Return what networks take: uint8 (B, H, W) as float32 (B, 1, H, W), from -1 to 1."""
    return gray.unsqueeze(1).to(torch.float32) / 127.5 - 1.0


def to_gray(pictures: Tensor) -> Tensor:
    """Return what `to_input` undoes: float (B, 1, H, W), from -1 to 1, as uint8 (B, H, W)."""
    gray = (pictures.squeeze(1) + 1.0) * 127.5
    return gray.round().clamp(0.0, 255.0).to(torch.uint8)


class Runner:
    """A network that is run, never trained: frames in, its output for them out.

    Args:
        network: takes float (B, 1, H, W). It is set to evaluation, for good.
        precision: arithmetic.
        device: where to compute.
    """

    def __init__(self, network: nn.Module, precision: Precision, device: torch.device) -> None:
        self._dtype = arithmetic(precision, device)
        self._device = device
        # Normalisation goes into the convolutions before it: a tenth of the time, and the same.
        fused = fuse(network.eval().requires_grad_(False)).to(device, self._dtype)
        self._network = fused.to(memory_format=torch.channels_last)

    def __call__(self, frames: Sequence[Frame]) -> Tensor:
        """Return the network's output for a batch of frames, on its device.

        Raises:
            UsageError: there are no frames, or their sides are no multiples of 32.
        """
        inputs = to_input(stack_gray(frames).to(self._device))
        with torch.inference_mode():
            output: Tensor = self._network(
                inputs.to(dtype=self._dtype, memory_format=torch.channels_last)
            )
        return output


def stack_gray(frames: Sequence[Frame]) -> Tensor:
    """Return the grey values of frames, uint8 (B, H, W).

    Raises:
        UsageError: there are no frames, they differ in size, or their sides are no multiples of 32.
    """
    check_alike(frames, "a network")
    gray = np.stack([frame.gray for frame in frames])
    if gray.shape[1] % 32 or gray.shape[2] % 32:
        raise UsageError(
            f"frames of {gray.shape[2]}×{gray.shape[1]} px do not fit the network",
            name="frames",
            suggestion="their sides are multiples of 32, 224×224 in the paper",
        )
    return torch.from_numpy(gray)
