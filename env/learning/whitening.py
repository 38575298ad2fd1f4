"""Whitening: observations in coordinates in which learning is quick.

Half of the variance of VSR vectors lies in one direction, roughly how much there is to see, and
what tells whether somebody is in the way lies in directions that vary a hundred times less.
Gradient descent learns along the first long before it does along the others (LeCun et al.,
"Efficient BackProp", 1998, section 4.3).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from env.driving.setup import MEASURED_AT_LEAST

_RANK = MEASURED_AT_LEAST  # directions that may be shrunk, at most
# Of the largest variance: what varies less than this stays as it is. With a tenth of it, a hundred
# directions of VSR vectors count alike, and on a stand-in with as many PPO learnt less.
_FLOOR = 1e-2
_RMS = 0.3  # of what comes out; much more would drive units of tanh to where they hardly learn


class Whitening(nn.Module):
    """z = scale · (I + Σ_i (g_i - 1) v_i v_iᵀ) (x - mean), the first layer of a policy; not learnt.

    Along v_i, where observations vary most, the gains g_i shrink them to a deviation that all such
    directions share. Nothing is amplified, so that few observations are enough to measure it.
    Until `measure` is called, z = x.

    Args:
        size: D, how many numbers an observation has.
    """

    mean: Tensor
    directions: Tensor
    gains: Tensor
    scale: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        rank = min(_RANK, size)
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("directions", torch.zeros(size, rank))
        self.register_buffer("gains", torch.ones(rank))
        self.register_buffer("scale", torch.ones(()))

    def measure(self, observations: Tensor) -> None:
        """Find out how observations vary.

        Args:
            observations: float32 (N, D), N at least `env.driving.setup.MEASURED_AT_LEAST`.
        """
        _, deviations, directions = torch.pca_lowrank(observations, q=len(self.gains), niter=4)
        if deviations[0] == 0.0:  # an empty street: they are all the same
            return
        self.mean.copy_(observations.mean(dim=0))
        floor = deviations[0] * _FLOOR**0.5
        self.directions.copy_(directions)
        self.gains.copy_(floor / deviations.clamp(min=floor))
        self.scale.copy_(_RMS / self._shrunk(observations - self.mean).square().mean().sqrt())

    def forward(self, observations: Tensor) -> Tensor:
        """Return z of observations, float (B, D)."""
        return self.scale * self._shrunk(observations - self.mean)

    def folded(self, weight: Tensor, bias: Tensor) -> tuple[Tensor, Tensor]:
        """Return a linear layer that does to observations what another does to z.

        Args:
            weight: float (H, D), of the other.
            bias: float (H,), of the other.
        """
        # The map is symmetric, so that rows of weights go through it as observations do.
        weight = self.scale * self._shrunk(weight)
        return weight, bias - weight @ self.mean

    def _shrunk(self, vectors: Tensor) -> Tensor:
        along = vectors @ self.directions
        return vectors + (along * (self.gains - 1.0)) @ self.directions.T
