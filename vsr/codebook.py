"""The codebook: one fixed random hypervector for every symbol of the scene descriptor."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from sfol.errors import UsageError
from vsr import hrr
from vsr.classes import DESCRIPTOR_CLASSES
from vsr.entities import Direction

DIMENSION = 2048  # the paper's choice
GRID = 16  # cells along each side of the picture, the paper's choice
VERSION = 1  # to be raised whenever the same seed gives other vectors


@dataclass(frozen=True)
class Codebook:
    """Symbols for classes, directions and grid cells, the same on every machine.

    Each symbol has a stream of random numbers of its own: numpy's Philox, keyed with the first 16
    bytes of the SHA-256 of ``vsr/<version>/<seed>/<name>``, whose normal numbers are drawn in
    float64, divided by √D and rounded to float32. So a symbol depends on nothing but the seed, the
    dimension and its own name, and new symbols change none of the old.

    Attributes:
        dimension: D, the length of the vectors.
        seed: which of all codebooks.
        unitary: whether symbols are projected to unitary vectors; the paper's are not.

    Source: paper, section on SSI.
    """

    dimension: int = DIMENSION
    seed: int = 0
    unitary: bool = False

    def __post_init__(self) -> None:
        if self.dimension < 1:
            raise UsageError(
                f"the dimension is {self.dimension}", name="dimension", suggestion="≥ 1"
            )

    def symbol(self, name: str) -> Tensor:
        """Return the hypervector of a name, float32 (D,), such as ``class/pedestrian``."""
        digest = hashlib.sha256(f"vsr/{VERSION}/{self.seed}/{name}".encode()).digest()
        generator = np.random.Generator(np.random.Philox(key=int.from_bytes(digest[:16], "big")))
        vector = hrr.random_symbols(1, self.dimension, generator)[0]
        return hrr.unitary(vector) if self.unitary else vector

    @cached_property
    def classes(self) -> Tensor:
        """Symbols of `DESCRIPTOR_CLASSES`, in that order, float32 (6, D)."""
        return self._symbols(f"class/{kind.name.lower()}" for kind in DESCRIPTOR_CLASSES)

    @cached_property
    def directions(self) -> Tensor:
        """Symbols of left_of, right_of and below_of, float32 (3, D)."""
        return self._symbols(f"direction/{direction}" for direction in Direction)

    @cached_property
    def cells(self) -> Tensor:
        """Symbols of the grid's cells by row and column, float32 (16, 16, D)."""
        names = (f"cell/{row}/{column}" for row in range(GRID) for column in range(GRID))
        return self._symbols(names).reshape(GRID, GRID, self.dimension)

    def _symbols(self, names: Iterable[str]) -> Tensor:
        return torch.stack([self.symbol(name) for name in names])
