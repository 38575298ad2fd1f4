"""The scene descriptor: every moving entity as one hypervector, and their weighted bundle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor
from torch.nn.functional import embedding_bag

from sfol.errors import UsageError
from vsr.arrays import checked_array
from vsr.classes import CLASS_COUNT, DESCRIPTOR_CLASSES, DYNAMIC_CLASSES
from vsr.entities import ClassMap, Direction, Entity, check_within, class_map
from vsr.grounding import SegmentationGrounding
from vsr.hypervectors import attention, hrr
from vsr.hypervectors.codebook import GRID, Codebook
from vsr.hypervectors.floats import as_floats
from vsr.hypervectors.fusion import Fusion
from vsr.hypervectors.methods import Method

_PAIRS = len(DESCRIPTOR_CLASSES) * len(Direction)  # what can be a neighbour, and where


@dataclass(frozen=True, eq=False)
class Layout:
    """What of the k moving entities of a frame goes into their vectors.

    Attributes:
        names: the entities' names, in the order of all that follows.
        kinds: int64 (k,), each entity's class, as an index of `DESCRIPTOR_CLASSES`.
        neighbours: bool (k, 6, 3), which class is found in which `Direction`.
        coverage: float32 (k, 16, 16), ρ, the share of each grid cell that the entity covers.
        attention: float32 (k, 7, 7), `attention_layers`, for the encoder's feature map.

    Raises:
        UsageError: an array has another type or shape, or there is no class of such a number.
    """

    names: tuple[str, ...]
    kinds: NDArray[np.int64]
    neighbours: NDArray[np.bool_]
    coverage: NDArray[np.float32]
    attention: NDArray[np.float32]

    def __post_init__(self) -> None:
        count, classes = len(self.names), len(DESCRIPTOR_CLASSES)
        checked_array(self.kinds, np.int64, (count,), "kinds")
        checked_array(self.neighbours, np.bool_, (count, classes, len(Direction)), "neighbours")
        checked_array(self.coverage, np.float32, (count, GRID, GRID), "coverage")
        side = attention.SIZE
        checked_array(self.attention, np.float32, (count, side, side), "attention")
        if count and not 0 <= self.kinds.min() <= self.kinds.max() < classes:
            raise UsageError(
                "an entity has a class of no such number", name="kinds", suggestion=f"< {classes}"
            )


class SceneDescriptor:
    """Vectors of a scene: SSI_i = C_i ⊗ N_i ⊗ S_i, E_i = SSI_i ⊕ SF_i and VSR = Σ w_i E_i.

    Args:
        codebook: the symbols.
        grounding: depth of the search window and pixels that make a neighbour.
        fusion: what E_i is made of; a method's name stands for its defaults. With features the
            codebook's vectors have 2048 numbers.
        device: where the vectors are computed.

    Raises:
        UsageError: the fusion is not known or does not go with the codebook.

    Source: paper, section "Vector Semantic Representation".
    """

    def __init__(
        self,
        codebook: Codebook,
        grounding: SegmentationGrounding | None = None,
        fusion: Fusion | Method = "ssi",
        device: torch.device | str = "cpu",
    ) -> None:
        self.codebook = codebook
        self.grounding = grounding or SegmentationGrounding()
        self.device = torch.device(device)
        self.fusion = fusion if isinstance(fusion, Fusion) else Fusion(fusion)
        if self.fusion.uses_features and codebook.dimension != attention.FEATURES:
            raise UsageError(
                f"fusion '{self.fusion.method}' of features with vectors of "
                f"{codebook.dimension} numbers",
                name="fusion",
                suggestion=f"a codebook of dimension {attention.FEATURES}, or the fusion 'ssi'",
            )
        # All symbols are transformed once: in the frequency domain ⊗ is a product and sums stay
        # sums, so that an entity costs one transform back. For each class there are 19 terms of
        # C_i ⊗ N_i: one for each neighbour and direction, and one for none at all.
        own = hrr.spectrum(codebook.classes.to(self.device))
        directions = hrr.spectrum(codebook.directions.to(self.device))
        cells = hrr.spectrum(codebook.cells.to(self.device))
        pairs = (own[:, None] * directions).flatten(0, 1)
        meanings = torch.cat([own[:, None].square() * pairs, own[:, None]], dim=1)
        self._meanings = _as_reals(meanings.flatten(0, 1))
        self._cells = _as_reals(cells.flatten(0, 1))

    def ssi(self, entities: Sequence[Entity], scene: NDArray[Any]) -> Tensor:
        """Return SSI_i of every entity that moves, in the order of the entities.

        Args:
            entities: what `find_entities` found; crosswalks are passed over.
            scene: float32 (28, H, W) probabilities, or their `class_map`, uint8 (H, W).

        Returns:
            float32 (k, D) for k entities of `DYNAMIC_CLASSES`; k may be 0.

        Raises:
            UsageError: the map is not what it should be.
        """
        return self.encode(self.layout(entities, scene))

    def layout(self, entities: Sequence[Entity], scene: NDArray[Any]) -> Layout:
        """Measure what the vectors are made of. Arguments as for `ssi`.

        Pixels on the border of two grid cells count for each by the part that lies in it, so that
        the map may have any size.
        """
        classes = class_map(scene)
        check_within(entities, classes.shape)
        moving = [entity for entity in entities if entity.kind in DYNAMIC_CLASSES]
        kinds = [DESCRIPTOR_CLASSES.index(entity.kind) for entity in moving]
        neighbours = np.zeros((len(moving), len(DESCRIPTOR_CLASSES), len(Direction)), np.bool_)
        for found, entity in zip(neighbours, moving, strict=True):
            found[:] = _neighbours(entity, classes, self.grounding)
        return Layout(
            names=tuple(entity.name for entity in moving),
            kinds=np.array(kinds, np.int64),
            neighbours=neighbours,
            coverage=cell_shares(moving, classes.shape, GRID),
            attention=attention_layers(moving, classes.shape),
        )

    def encode(self, *layouts: Layout) -> Tensor:
        """Return SSI_i = C_i ⊗ N_i ⊗ S_i of all entities of one or more frames.

        C_i = h_c is the symbol of the entity's class. N_i = Σ h_k ⊗ h_d ⊗ h_c over the neighbours,
        class k in direction d; without any it is the identity of ⊗, or the entity would vanish.
        S_i = Σ ρ_xy G_xy over the grid's cells.

        Returns:
            float32 (k, D), frame after frame.

        Raises:
            UsageError: there are no layouts.

        Source: paper, section on SSI and its equation for SSI_i.
        """
        _check_number(layouts)
        kinds = np.concatenate([layout.kinds for layout in layouts])
        neighbours = np.concatenate([layout.neighbours for layout in layouts])
        coverage = np.concatenate([layout.coverage for layout in layouts])
        each = np.arange(len(kinds))
        terms = np.zeros((len(kinds), len(DESCRIPTOR_CLASSES), _PAIRS + 1), np.float32)
        terms[each, kinds, :_PAIRS] = neighbours.reshape(-1, _PAIRS)
        terms[each, kinds, _PAIRS] = ~neighbours.any(axis=(1, 2))
        meaning = self._sum(terms, self._meanings)
        place = self._sum(coverage, self._cells)
        return hrr.from_spectrum(meaning * place, self.codebook.dimension)

    def entities(
        self, layouts: Sequence[Layout], features: NDArray[Any] | Tensor | None = None
    ) -> Tensor:
        """Return E_i of all entities of B frames: SSI_i and SF_i, fused.

        Args:
            layouts: what `layout` measured, one for each frame.
            features: float (B, 512, 7, 7), the encoder's feature maps; needed by every fusion but
                ``ssi``, which looks at none.

        Returns:
            float32 (k, D), frame after frame.

        Raises:
            UsageError: there are no layouts, or the feature maps are missing or have another shape.

        Source: paper, equation for E_i.
        """
        _check_number(layouts)
        parts = []
        if self.fusion.uses_ssi:
            parts.append(self.encode(*layouts))
        if self.fusion.uses_features:
            parts.append(self._features(layouts, features))
        return self.fusion.fuse(*parts)

    def vsr(
        self,
        layouts: Sequence[Layout],
        weights: Sequence[ArrayLike],
        features: NDArray[Any] | Tensor | None = None,
    ) -> Tensor:
        """Return VSR = Σ w_i E_i of each of B frames; of no entities it is zero.

        Args:
            layouts: what `layout` measured, one for each frame.
            weights: w_i, one sequence of numbers for each frame, in the order of the layout's
                names; the knowledge base's `entity_weights` gives them.
            features: as for `entities`.

        Returns:
            float32 (B, D).

        Raises:
            UsageError: there are not as many weights as entities, one is not finite, or the
                feature maps are not what they should be.

        Source: paper, equation for VSR.
        """
        if len(weights) != len(layouts):
            raise UsageError(
                f"weights of {len(weights)} frames for {len(layouts)} frames", name="weights"
            )
        sizes = [len(layout.names) for layout in layouts]
        table = np.zeros((len(layouts), sum(sizes)), np.float32)
        first = 0
        for row, numbers, size in zip(table, weights, sizes, strict=True):
            row[first : first + size] = _checked_weights(numbers, size)
            first += size
        return torch.from_numpy(table).to(self.device) @ self.entities(layouts, features)

    def bundle(self, vectors: Tensor, weights: Tensor | Sequence[float]) -> Tensor:
        """Return Σ w_i x_i of the vectors of one frame; of no vectors it is zero.

        Args:
            vectors: x_i, (k, D).
            weights: w_i, k numbers.

        Returns:
            (D,), of the vectors' type.

        Raises:
            UsageError: there are not as many weights as vectors, or one is not finite.
        """
        if vectors.ndim != 2 or not vectors.is_floating_point():
            raise UsageError(
                f"vectors of shape {tuple(vectors.shape)} and type {vectors.dtype}",
                name="vectors",
                suggestion="floats of shape (k, D)",
            )
        factors = as_floats(weights, "weights").to(vectors)
        if factors.shape != vectors.shape[:-1]:
            raise _wrong_number(factors.numel(), len(vectors))
        return hrr.bundle(vectors, factors)

    def _features(
        self, layouts: Sequence[Layout], features: NDArray[Any] | Tensor | None
    ) -> Tensor:
        if features is None:
            raise UsageError(
                f"the fusion '{self.fusion.method}' needs the encoder's feature maps",
                name="features",
                suggestion="pass them, or choose the fusion 'ssi'",
            )
        shape = np.shape(features)
        if shape[:1] != (len(layouts),):
            raise UsageError(
                f"feature maps of shape {tuple(shape)} for {len(layouts)} frames",
                name="features",
                suggestion="one for each frame",
            )
        layers = np.concatenate([layout.attention for layout in layouts])
        frames = np.repeat(np.arange(len(layouts)), [len(layout.names) for layout in layouts])
        return attention.attend(
            features,
            torch.from_numpy(layers).to(self.device),
            torch.from_numpy(frames).to(self.device),
        )

    def _sum(self, weights: NDArray[np.float32], table: Tensor) -> Tensor:
        """Return Σ_j weights_ij table_j: float32 (k, …) for n spectra as reals; complex (k, F).

        Entities cover few of the grid's cells, so only terms that are there are added up.
        """
        weights = weights.reshape(len(weights), len(table))
        rows, terms = np.nonzero(weights)
        sums = embedding_bag(
            torch.from_numpy(terms).to(self.device),
            table,
            torch.from_numpy(np.searchsorted(rows, np.arange(len(weights)))).to(self.device),
            mode="sum",
            per_sample_weights=torch.from_numpy(weights[rows, terms]).to(self.device),
        )
        return torch.view_as_complex(sums.reshape(len(weights), table.shape[1] // 2, 2))


def cell_shares(
    entities: Sequence[Entity], shape: tuple[int, ...], cells: int
) -> NDArray[np.float32]:
    """Return which share of each cell of a grid over the picture each entity covers.

    Args:
        entities: k entities.
        shape: (H, W) of the picture, in px.
        cells: n, the rows and columns of the grid, which share the picture evenly.

    Returns:
        float32 (k, n, n), 0 to 1.

    Raises:
        UsageError: an entity reaches beyond the picture, or there is no cell.
    """
    check_within(entities, shape)
    if cells < 1:
        raise UsageError(f"a grid of {cells} cells", name="cells", suggestion="≥ 1")
    rows, columns = (_membership(size, cells) for size in shape)
    return _projected(entities, rows, columns)


def attention_layers(entities: Sequence[Entity], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return how much of each entity each cell of the encoder's feature map sees.

    A pixel counts for the four cells around it, by bilinear interpolation: the features attended
    to are those of the map interpolated to the picture's size. With shares of cells instead, all
    that lies in one cell of 32 px would have the same features.

    Args:
        entities: k entities.
        shape: (H, W) of the picture, in px.

    Returns:
        float32 (k, 7, 7), an entity's sum being its area in cells.

    Raises:
        UsageError: an entity reaches beyond the picture.
    """
    check_within(entities, shape)
    rows, columns = (_interpolation(size, attention.SIZE) for size in shape)
    return _projected(entities, rows, columns)


def _projected(
    entities: Sequence[Entity], rows: NDArray[np.float32], columns: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return rows · mask · columnsᵀ of each entity, for (n, H) and (n, W): float32 (k, n, n)."""
    grids = np.empty((len(entities), len(rows), len(columns)), np.float32)
    for grid, entity in zip(grids, entities, strict=True):
        down, across = entity.box.area
        mask = entity.mask.astype(np.float32)
        np.matmul(rows[:, down] @ mask, columns[:, across].T, out=grid)
    return grids


@lru_cache(maxsize=16)
def _interpolation(size: int, cells: int) -> NDArray[np.float32]:
    """Return linear interpolation between the middles of n cells, float32 (n, size).

    Entries are the weights of the cells for each px, over a cell's width.
    """
    width = size / cells
    places = np.clip((np.arange(size) + 0.5) / width - 0.5, 0.0, cells - 1.0)
    weights = np.maximum(1.0 - np.abs(np.arange(cells)[:, None] - places), 0.0) / width
    interpolation: NDArray[np.float32] = weights.astype(np.float32)
    return interpolation


@lru_cache(maxsize=16)
def _membership(size: int, cells: int) -> NDArray[np.float32]:
    """Return how much of each of n stripes lies in each row (or column) of px, float32 (n, size).

    Entries are shares of the stripe, so that sums of them are covered shares.
    """
    width = size / cells
    upper = np.arange(cells)[:, None] * width
    pixels = np.arange(size)
    overlap = np.minimum(pixels + 1, upper + width) - np.maximum(pixels, upper)
    shares: NDArray[np.float32] = np.clip(overlap / width, 0.0, None).astype(np.float32)
    return shares


def _neighbours(
    entity: Entity, classes: ClassMap, grounding: SegmentationGrounding
) -> NDArray[np.bool_]:
    """Return which descriptor class is found on which side of an entity, bool (6, 3)."""
    sides = [classes[entity.beside(side, grounding.window)] for side in Direction]
    pixels = [np.bincount(seen.ravel(), minlength=CLASS_COUNT) for seen in sides]
    found: NDArray[np.bool_] = np.stack(pixels, axis=1) >= grounding.minimum_pixels
    return found[list(DESCRIPTOR_CLASSES)]


def _check_number(layouts: Sequence[Layout]) -> None:
    if not layouts:
        raise UsageError("a descriptor needs at least one frame", name="layouts")


def _checked_weights(weights: ArrayLike, count: int) -> NDArray[np.float32]:
    numbers: NDArray[np.float32] = as_floats(weights, "weights").detach().float().cpu().numpy()
    if numbers.shape != (count,):
        raise _wrong_number(numbers.size, count)
    return numbers


def _wrong_number(weights: int, entities: int) -> UsageError:
    return UsageError(
        f"{weights} weights for {entities} entities",
        name="weights",
        suggestion="one for each pedestrian, vehicle and truck, in the entities' order",
    )


def _as_reals(spectra: Tensor) -> Tensor:
    """Return complex (n, F) as float (n, 2F)."""
    return torch.view_as_real(spectra).flatten(1)
