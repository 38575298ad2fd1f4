"""Cheap changes of a picture that change nothing of what it shows."""

from __future__ import annotations

import torch
from torch import Tensor


def relight(inputs: Tensor, rng: torch.Generator) -> Tensor:
    """Return frames with other brightness and contrast, and some noise.

    Args:
        inputs: float32 (B, 1, H, W), from -1 to 1.
        rng: decides how much.
    """
    contrast, brightness, noise = torch.rand(3, len(inputs), 1, 1, 1, generator=rng)
    grain = torch.randn(inputs.shape, generator=rng) * (0.04 * noise)
    relit: Tensor = inputs * (0.8 + 0.4 * contrast) + (0.3 * brightness - 0.15) + grain
    return relit
