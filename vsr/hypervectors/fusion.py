"""Fusion: how an entity's hypervector and its features become one vector."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import add, mul
from typing import get_args

from torch import Tensor
from torch.nn.functional import rms_norm

from sfol.errors import UsageError, did_you_mean
from vsr.hypervectors.methods import Method

_TINY = 1e-30  # added to mean squares, so that a vector of zeros stays one


@dataclass(frozen=True)
class Fusion:
    """What E_i is made of.

    Attributes:
        method: ``add`` is the paper's SSI ⊕ SF, ``multiply`` its SSI ⊗ SF, which is elementwise
            and no convolution; ``ssi`` and ``sf`` take one part alone.
        normalise_parts: whether SSI_i and SF_i are scaled to a root mean square of 1 before they
            are fused. They differ in scale, and large entities would drown small ones.
        normalise_entities: whether E_i is scaled so afterwards. With both, every method gives
            vectors of one scale, and w_i alone says how much an entity counts.

    Source: paper, equation for E_i and first set of setups; the scaling is this project's choice.
    """

    method: Method = "ssi"
    normalise_parts: bool = True
    normalise_entities: bool = True

    def __post_init__(self) -> None:
        methods = get_args(Method)
        if self.method not in methods:
            raise UsageError(
                f"unknown fusion '{self.method}'",
                name=self.method,
                suggestion=did_you_mean(self.method, methods),
            )

    @property
    def uses_ssi(self) -> bool:
        """Whether the entity's hypervector is a part."""
        return self.method != "sf"

    @property
    def uses_features(self) -> bool:
        """Whether the entity's features are a part."""
        return self.method != "ssi"

    def fuse(self, *parts: Tensor) -> Tensor:
        """Return E_i of k entities.

        Args:
            parts: SSI_i, SF_i or both, as the method uses them, each (k, D).

        Returns:
            (k, D).

        Raises:
            UsageError: there are more or fewer parts than the method uses, or they differ in shape.
        """
        if len(parts) != self.uses_ssi + self.uses_features or len({p.shape for p in parts}) > 1:
            raise UsageError(
                f"the fusion '{self.method}' of parts of shapes {[tuple(p.shape) for p in parts]}",
                name="parts",
                suggestion="as many as it uses, all of one shape",
            )
        scaled = [unit_rms(part) for part in parts] if self.normalise_parts else parts
        operation: Callable[[Tensor, Tensor], Tensor] = mul if self.method == "multiply" else add
        fused = reduce(operation, scaled)
        return unit_rms(fused) if self.normalise_entities else fused


def unit_rms(vectors: Tensor) -> Tensor:
    """Scale vectors to a root mean square of 1; zeros stay zeros."""
    return rms_norm(vectors, vectors.shape[-1:], eps=_TINY)
