"""Reading a descriptor: which entities a hypervector holds, where they are and what is beside them.

C ⊗ N ⊗ S multiplies out to a sum of products h_c ⊗ h_c ⊗ h_k ⊗ h_d ⊗ G_xy, one for every neighbour
(class k, direction d) and every covered cell; without neighbours it is h_c ⊗ G_xy. N and S are sums
both, so that neither can be unbound alone, but each product is a symbol of its own: 3·19·256 of
them, counting 18 pairs of class and direction, and none. A vector is compared with all of them in
the frequency domain, by phases alone: products of Gaussian symbols have spectra of very uneven
magnitude, and the same magnitudes recur in all products that share symbols, which without this
would pass for similarity.

Products of one entity stand together: they are those of a block of neighbouring cells, combined
with a set of neighbours. The best block and set together are found by sums over blocks, and how
much of each cell there is by least squares. What was found is taken away, and the rest searched
for the next (orthogonal matching pursuit); at the end each is looked for again in what the others
leave.

Sources: T. A. Plate, "Holographic Reduced Representations", IEEE Transactions on Neural Networks
6(3), 1995; Y. C. Pati, R. Rezaiifar and P. S. Krishnaprasad, "Orthogonal Matching Pursuit", 27th
Asilomar Conference on Signals, Systems and Computers, 1993.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.linalg import solve
from torch import Tensor

from sfol.errors import UsageError
from vsr.classes import DESCRIPTOR_CLASSES, DYNAMIC_CLASSES, SemanticClass
from vsr.entities import Direction
from vsr.hypervectors import hrr
from vsr.hypervectors.codebook import GRID, Codebook
from vsr.hypervectors.floats import as_floats

Floats = NDArray[np.float32]
Spectrum = NDArray[np.complex64]

# Sides of the blocks of cells that are tried, in cells; what lies between is close to one of them.
BLOCK_SIDES = (1, 2, 3, 4, 6, 8, 12, 16)
# In noise the best of all templates scores 5.1 to 6.6 (75 vectors, D from 1024 to 8192).
LEAST_SCORE = 6.6
SWEEPS = 2
MOST_ENTITIES = 100  # to look for: work grows with their square, and a vector holds fewer
_AROUND = np.ones((3, 3), np.bool_)
_RIDGE = 1e-6  # of the mean square of a product: what float32 cannot tell from zero
_NEGLIGIBLE = 1e-6  # part of a vector's energy that is left to rounding
_NEIGHBOURS = tuple((kind, direction) for kind in DESCRIPTOR_CLASSES for direction in Direction)


@dataclass(frozen=True, eq=False)
class DecodedEntity:
    """One entity that was read from a hypervector.

    Attributes:
        kind: its class.
        neighbours: classes beside it, with their directions.
        coverage: float32 (16, 16), the estimate of w ρ: the entity's weight in the vector times
            the share of each cell that it covers; 0 outside the block that was found.
        score: how well its template fits, in standard deviations of what chance gives.
    """

    kind: SemanticClass
    neighbours: frozenset[tuple[SemanticClass, Direction]]
    coverage: Floats
    score: float

    @property
    def centre(self) -> tuple[float, float]:
        """Row and column of the middle of what it covers, in cells from the upper left corner."""
        middles = np.arange(GRID) + 0.5
        rows, columns = self.coverage.sum(axis=1), self.coverage.sum(axis=0)
        return float(rows @ middles / rows.sum()), float(columns @ middles / columns.sum())

    @property
    def cell(self) -> tuple[int, int]:
        """Row and column of the grid cell that its centre is in."""
        row, column = self.centre
        return int(row), int(column)


class _Pattern(NamedTuple):
    """A class and neighbours, as indices, cells where they are found, bool (16, 16), a score."""

    kind: int
    neighbours: tuple[int, ...]
    cells: NDArray[np.bool_]
    score: float


class _Part(NamedTuple):
    """A pattern, float32 (16, 16) how much of it there is in each cell, and all that of a vector.

    Entities reach a little beyond the pattern's cells, so the cells around them count too.
    """

    pattern: _Pattern
    amounts: Floats
    spectrum: Spectrum


class Decoder:
    """Reads vectors that were made with a codebook.

    Args:
        codebook: the symbols that the vectors were made with.
    """

    def __init__(self, codebook: Codebook) -> None:
        self._dimension = codebook.dimension
        own, directions, cells = (
            hrr.spectrum(part).numpy()
            for part in (codebook.classes, codebook.directions, codebook.cells.flatten(0, 1))
        )
        pairs = (own[:, None] * directions).reshape(len(_NEIGHBOURS), -1)
        own = own[: len(DYNAMIC_CLASSES)]
        self._own, self._pairs, self._cells = own, pairs, cells
        # Spectra of real vectors hold every frequency twice but the first and, for even D, the
        # last; so weighted, products of them are products of the vectors.
        self._twice: Floats = np.full(cells.shape[1], 2.0, np.float32)
        self._twice[0] = 1.0
        if codebook.dimension % 2 == 0:
            self._twice[-1] = 1.0
        meanings = np.concatenate([own[:, None] ** 2 * pairs, own[:, None]], axis=1)
        self._meanings = _phases(meanings.reshape(-1, meanings.shape[-1]))
        self._places = _as_reals(_phases(cells) * self._twice) / np.sqrt(codebook.dimension)
        self._sums = _unit_sums()

    def scores(self, vector: Tensor | NDArray[Any]) -> Floats:
        """Return the similarity of a vector to every product of symbols.

        Args:
            vector: real (D,), any SSI_i or sum of them.

        Returns:
            float32 (3, 19, 16, 16): for each of `DYNAMIC_CLASSES`, each class and direction of a
            neighbour (18, and none), and each cell, in standard deviations of what chance gives.

        Raises:
            UsageError: the vector has another length or is not finite.
        """
        return self._scores(self._spectrum(vector))

    def decode(
        self,
        vector: Tensor | NDArray[Any],
        most: int = 1,
        *,
        least_score: float = LEAST_SCORE,
        sweeps: int = SWEEPS,
    ) -> tuple[DecodedEntity, ...]:
        """Return the entities that a vector holds, the clearest first.

        Args:
            vector: real (D,): SSI_i of one entity, or a sum of those of several.
            most: how many entities to look for, 0 to `MOST_ENTITIES`.
            least_score: what an entity's score is at least; what scores less is left out.
            sweeps: how often every entity is looked for again, with all others taken away.

        Returns:
            At most so many entities; none if all is noise or zero.

        Raises:
            UsageError: the vector has another length or is not finite, or more are looked for.
        """
        if not 0 <= most <= MOST_ENTITIES:
            raise UsageError(
                f"{most} entities to look for", name="most", suggestion=f"0 to {MOST_ENTITIES}"
            )
        whole = self._spectrum(vector)
        parts = self._pursue(whole, most)
        for _ in range(sweeps if len(parts) > 1 else 0):
            parts = self._sweep(whole, parts)
        clear = [part for part in parts if part.pattern.score >= least_score and _covers(part)]
        return tuple(_entity(part) for part in sorted(clear, key=lambda part: -part.pattern.score))

    def _pursue(self, whole: Spectrum, most: int) -> list[_Part]:
        """Find one pattern after the other in what those before do not explain."""
        parts: list[_Part] = []
        rest = whole
        while len(parts) < most and _energy(rest) > _NEGLIGIBLE * _energy(whole):
            known = [part.pattern for part in parts]
            patterns = _joined([*known, self._strongest(rest)])
            if _size(patterns) == _size(known):  # the best that can be found is there already
                break
            parts = self._fit(whole, patterns)
            rest = whole - sum(part.spectrum for part in parts)
        return parts

    def _sweep(self, whole: Spectrum, parts: list[_Part]) -> list[_Part]:
        """Look for every pattern again in what all others leave; drop those that are nothing."""
        rest = whole - sum(part.spectrum for part in parts)
        patterns = []
        for part in parts:
            rest = rest + part.spectrum
            again = self._strongest(rest)
            patterns.append(_joined([again, part.pattern])[0])
            (new,) = self._fit(rest, patterns[-1:])
            rest = rest - new.spectrum
        fitted = self._fit(whole, _joined(patterns))
        return [part for part in fitted if _energy(part.spectrum) > _NEGLIGIBLE * _energy(whole)]

    def _spectrum(self, vector: Tensor | NDArray[Any]) -> Spectrum:
        numbers = as_floats(vector, "vector's numbers").detach().float().cpu()
        if numbers.shape != (self._dimension,):
            raise UsageError(
                f"a vector of shape {tuple(numbers.shape)} cannot be decoded",
                name="vector",
                suggestion=f"it has {self._dimension} finite numbers, as the codebook's symbols",
            )
        spectrum: Spectrum = hrr.spectrum(numbers).numpy()
        return spectrum

    def _scores(self, spectrum: Spectrum) -> Floats:
        scores: Floats = _as_reals(_phases(spectrum) * self._meanings.conj()) @ self._places.T
        return scores.reshape(len(DYNAMIC_CLASSES), -1, GRID, GRID)

    def _strongest(self, spectrum: Spectrum) -> _Pattern:
        """Return the class, neighbours and block of cells that together fit best.

        Of a set of m neighbours and a block of n cells, mn products are added up; their scores
        are standard normal in noise, and so is their sum over √(mn). The best set of m is that of
        the m best neighbours.
        """
        sums = self._sums @ self._scores(spectrum) @ self._sums.T
        pairs, alone = sums[:, :-1], sums[:, -1:]
        best_first = -np.sort(-pairs, axis=1)
        sizes = np.sqrt(np.arange(1, len(_NEIGHBOURS) + 1, dtype=np.float32))
        sets = best_first.cumsum(axis=1) / sizes[:, None, None]
        fits = np.concatenate([alone, sets], axis=1)
        kind, size, rows, columns = np.unravel_index(fits.argmax(), fits.shape)
        neighbours = np.argsort(-pairs[kind, :, rows, columns])[:size]
        return _Pattern(
            kind=int(kind),
            neighbours=tuple(sorted(neighbours.tolist())),
            cells=np.outer(self._sums[rows] > 0, self._sums[columns] > 0),
            score=float(fits[kind, size, rows, columns]),
        )

    def _fit(self, spectrum: Spectrum, patterns: Sequence[_Pattern]) -> list[_Part]:
        """Return how much of each pattern there is in each cell, by least squares."""
        areas = [ndimage.binary_dilation(pattern.cells, _AROUND) for pattern in patterns]
        products = [
            self._meaning(pattern) * self._cells[area.ravel()]
            for pattern, area in zip(patterns, areas, strict=True)
        ]
        together = np.concatenate(products)
        weighted = _as_reals(np.multiply(together, self._twice, dtype=np.complex64))
        gram = (weighted @ _as_reals(together).T).astype(np.float64)
        # Cells that two patterns of one meaning share are one unknown twice: split it evenly.
        gram.flat[:: len(gram) + 1] += _RIDGE * np.trace(gram) / len(gram)
        matches = (weighted @ _as_reals(spectrum)).astype(np.float64)
        amounts = solve(gram, matches, assume_a="pos").astype(np.float32)
        each = np.split(amounts, np.cumsum([len(part) for part in products])[:-1])
        return [
            _Part(pattern, _on_grid(area, numbers), numbers @ part)
            for pattern, area, numbers, part in zip(patterns, areas, each, products, strict=True)
        ]

    def _meaning(self, pattern: _Pattern) -> Spectrum:
        """Return the spectrum of C ⊗ N."""
        own: Spectrum = self._own[pattern.kind]
        if not pattern.neighbours:
            return own
        meaning: Spectrum = own**2 * self._pairs[list(pattern.neighbours)].sum(axis=0)
        return meaning


def _joined(patterns: Sequence[_Pattern]) -> list[_Pattern]:
    """Return the patterns with those made one that touch and say the same.

    As S is a sum, they are the same as one larger entity.
    """
    joined: list[_Pattern] = []
    for pattern in patterns:
        for index, other in enumerate(joined):
            if pattern[:2] == other[:2] and _touch(pattern.cells, other.cells):
                joined[index] = other._replace(cells=pattern.cells | other.cells)
                break
        else:
            joined.append(pattern)
    return joined


def _size(patterns: Sequence[_Pattern]) -> int:
    return sum(int(np.count_nonzero(pattern.cells)) for pattern in patterns)


def _touch(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> bool:
    return bool((ndimage.binary_dilation(first, _AROUND) & second).any())


def _on_grid(area: NDArray[np.bool_], numbers: Floats) -> Floats:
    grid = np.zeros((GRID, GRID), np.float32)
    grid[area] = numbers
    return grid


def _covers(part: _Part) -> bool:
    return bool((part.amounts > 0).any())


def _entity(part: _Part) -> DecodedEntity:
    return DecodedEntity(
        kind=DYNAMIC_CLASSES[part.pattern.kind],
        neighbours=frozenset(_NEIGHBOURS[index] for index in part.pattern.neighbours),
        coverage=np.clip(part.amounts, 0.0, None),
        score=part.pattern.score,
    )


def template_count(most_neighbours: int) -> int:
    """Return how many classes, blocks and sets of at most so many neighbours are told apart."""
    sets = sum(math.comb(len(_NEIGHBOURS), size) for size in range(most_neighbours + 1))
    return len(DYNAMIC_CLASSES) * len(_unit_sums()) ** 2 * sets


def block_likeness(coverage: Floats) -> Floats:
    """Return the cosine between what entities cover and the blocks most like it, 0 to 1.

    Args:
        coverage: float32 (k, 16, 16), not zero.

    Returns:
        float32 (k,).
    """
    sums = _unit_sums()
    best = (sums @ coverage @ sums.T).max(axis=(1, 2))
    likeness: Floats = best / np.linalg.norm(coverage, axis=(1, 2))
    return likeness


def _unit_sums() -> Floats:
    """Return the cells of every span that a block can have, each of length 1, float32 (n, 16)."""
    spans = [
        np.arange(start, start + side) for side in BLOCK_SIDES for start in range(GRID + 1 - side)
    ]
    sums = np.zeros((len(spans), GRID), np.float32)
    for row, span in zip(sums, spans, strict=True):
        row[span] = 1.0 / math.sqrt(len(span))
    return sums


def _energy(spectrum: Spectrum) -> float:
    return float(np.vdot(spectrum, spectrum).real)


def _phases(spectra: Spectrum) -> Spectrum:
    """Return spectra with all magnitudes 1; zeros stay zeros."""
    magnitudes = np.abs(spectra)
    return np.divide(spectra, magnitudes, out=np.zeros_like(spectra), where=magnitudes > 0)


def _as_reals(spectra: Spectrum) -> Floats:
    """Return complex (…, F) as float (…, 2F)."""
    return np.ascontiguousarray(spectra).view(np.float32)
