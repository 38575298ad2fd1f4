"""The codebook: one fixed random hypervector for every symbol of the scene descriptor."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save
from torch import Tensor

from sfol.errors import FileError, UsageError
from vsr import tensor_files
from vsr.classes import DESCRIPTOR_CLASSES
from vsr.entities import Direction
from vsr.hypervectors import hrr
from vsr.tensor_files import TensorKind

DIMENSION = 2048  # the paper's choice
GRID = 16  # cells along each side of the picture, the paper's choice
MOST_DIMENSION = 65_536  # of a codebook's file, 70 MB
VERSION = 1  # to be raised whenever the same seed gives other vectors

CLASS_NAMES = tuple(f"class/{kind.name.lower()}" for kind in DESCRIPTOR_CLASSES)
DIRECTION_NAMES = tuple(f"direction/{direction}" for direction in Direction)
CELL_NAMES = tuple(f"cell/{row}/{column}" for row in range(GRID) for column in range(GRID))
_ABOUT = ("seed", "unitary", "version")
_NAMES = (*CLASS_NAMES, *DIRECTION_NAMES, *CELL_NAMES)


@dataclass(frozen=True)
class Codebook:
    """Symbols for classes, directions and grid cells, the same on every machine.

    Each symbol has a stream of random numbers of its own: numpy's Philox, keyed with the first 16
    bytes of the SHA-256 of ``vsr/<version>/<seed>/<name>``, whose normal numbers are drawn in
    float64, divided by √D and rounded to float32. So a symbol depends on nothing but the seed, the
    dimension and its own name, and new symbols change none of the old.

    A policy knows the symbols that it was trained with: `save` them with it, and `load` them
    whatever later versions of this module draw.

    Attributes:
        dimension: D, the length of the vectors.
        seed: which of all codebooks.
        unitary: whether symbols are projected to unitary vectors; the paper's are not.
        version: which way of drawing symbols; others than `VERSION` come from files alone.
        stored: the vectors of a file by their names; None to draw them.

    Source: paper, section on SSI.
    """

    dimension: int = DIMENSION
    seed: int = 0
    unitary: bool = False
    version: int = VERSION
    stored: Mapping[str, Tensor] | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.dimension < 1:
            raise UsageError(
                f"the dimension is {self.dimension}", name="dimension", suggestion="≥ 1"
            )
        if self.stored is None and self.version != VERSION:
            raise UsageError(
                f"codebooks of version {self.version} cannot be drawn",
                name="version",
                suggestion=f"draw version {VERSION}, or load a file",
            )

    def symbol(self, name: str) -> Tensor:
        """Return the hypervector of a name, float32 (D,), such as ``class/pedestrian``."""
        if self.stored is not None:
            return self.stored[name]
        digest = hashlib.sha256(f"vsr/{self.version}/{self.seed}/{name}".encode()).digest()
        generator = np.random.Generator(np.random.Philox(key=int.from_bytes(digest[:16], "big")))
        vector = hrr.random_symbols(1, self.dimension, generator)[0]
        return hrr.unitary(vector) if self.unitary else vector

    @cached_property
    def classes(self) -> Tensor:
        """Symbols of `DESCRIPTOR_CLASSES`, in that order, float32 (6, D)."""
        return torch.stack([self.symbol(name) for name in CLASS_NAMES])

    @cached_property
    def directions(self) -> Tensor:
        """Symbols of left_of, right_of and below_of, float32 (3, D)."""
        return torch.stack([self.symbol(name) for name in DIRECTION_NAMES])

    @cached_property
    def cells(self) -> Tensor:
        """Symbols of the grid's cells by row and column, float32 (16, 16, D)."""
        cells = torch.stack([self.symbol(name) for name in CELL_NAMES])
        return cells.reshape(GRID, GRID, self.dimension)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all vectors, 64 hex digits, equal for equal codebooks."""
        numbers = [self.classes, self.directions, self.cells]
        return hashlib.sha256(
            b"".join(part.numpy().astype("<f4").tobytes() for part in numbers)
        ).hexdigest()

    def save(self, path: Path | str) -> None:
        """Write all vectors, by their names, to a safetensors file.

        Raises:
            UsageError: the file can't be written.
        """
        tensor_files.write_together({Path(path): self.content()})

    def content(self) -> bytes:
        """Return what `save` writes."""
        # a row of `classes` shares its memory with the others, which the format does not allow
        vectors = {name: vector.clone() for name, vector in self._vectors()}
        metadata = {
            "version": str(self.version),
            "seed": str(self.seed),
            "unitary": str(int(self.unitary)),
        }
        return save(vectors, metadata)

    @classmethod
    def load(cls, path: Path | str) -> Codebook:
        """Read what `save` wrote, of this or any other version.

        Raises:
            FileError: the file can't be read or is no codebook.
        """
        header = tensor_files.read_header(path)
        try:
            ((dimension,),) = {header.tensors[name][1] for name in _NAMES}
            seed, unitary, version = (int(header.metadata[name]) for name in _ABOUT)
        except (KeyError, ValueError):
            raise _no_codebook(path) from None
        vector = TensorKind(floating=True, shape=(dimension,))
        if not 0 < dimension <= MOST_DIMENSION:
            raise _no_codebook(path)
        if tensor_files.misfit(header, dict.fromkeys(header.tensors, vector)):
            raise _no_codebook(path)
        return cls(
            dimension=dimension,
            seed=seed,
            unitary=bool(unitary),
            version=version,
            stored=tensor_files.load_finite(path),
        )

    def _vectors(self) -> Iterator[tuple[str, Tensor]]:
        yield from zip(CLASS_NAMES, self.classes, strict=True)
        yield from zip(DIRECTION_NAMES, self.directions, strict=True)
        yield from zip(CELL_NAMES, self.cells.flatten(0, 1), strict=True)


def _no_codebook(path: Path | str) -> FileError:
    return FileError(
        f"'{path}' is no codebook",
        name=str(path),
        suggestion="files that Codebook.save wrote have a vector for every symbol",
    )
