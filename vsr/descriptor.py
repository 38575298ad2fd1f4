"""The scene descriptor: every moving entity as one hypervector, and their weighted bundle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from sfol.errors import UsageError
from vsr import hrr
from vsr.classes import CLASS_COUNT, DESCRIPTOR_CLASSES, DYNAMIC_CLASSES
from vsr.codebook import GRID, Codebook
from vsr.entities import ClassMap, Direction, Entity, class_map
from vsr.grounding import SegmentationGrounding


@dataclass(frozen=True, eq=False)
class Layout:
    """What of k entities goes into their hypervectors.

    Attributes:
        kinds: int64 (k,), each entity's class, as an index of `DESCRIPTOR_CLASSES`.
        neighbours: bool (k, 6, 3), which class is found in which `Direction`.
        coverage: float32 (k, 16, 16), ρ, the share of each grid cell that the entity covers.
    """

    kinds: Tensor
    neighbours: Tensor
    coverage: Tensor


class SceneDescriptor:
    """Hypervectors of a scene: SSI_i = C_i ⊗ N_i ⊗ S_i, and VSR = Σ w_i E_i.

    Args:
        codebook: the symbols.
        grounding: depth of the search window and pixels that make a neighbour.
        device: where the vectors are computed.

    Source: paper, section "Vector Semantic Representation".
    """

    def __init__(
        self,
        codebook: Codebook,
        grounding: SegmentationGrounding | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        self.codebook = codebook
        self.grounding = grounding or SegmentationGrounding()
        self.device = torch.device(device)
        # All symbols are transformed once: in the frequency domain ⊗ is a product and sums stay
        # sums, so that an entity costs one transform back.
        classes = hrr.spectrum(codebook.classes.to(self.device))
        directions = hrr.spectrum(codebook.directions.to(self.device))
        cells = hrr.spectrum(codebook.cells.to(self.device))
        self._classes = classes
        self._pairs = _as_reals((classes[:, None] * directions).flatten(0, 1))
        self._cells = _as_reals(cells.flatten(0, 1))

    def ssi(self, entities: Sequence[Entity], scene: NDArray[Any]) -> Tensor:
        """Return SSI_i of every entity that moves, in the order of the entities.

        Args:
            entities: what `find_entities` found; crosswalks are passed over.
            scene: float32 (28, H, W) probabilities, or their `class_map`, uint8 (H, W). H and W
                are multiples of 16.

        Returns:
            float32 (k, D) for k entities of `DYNAMIC_CLASSES`; k may be 0.

        Raises:
            UsageError: the map is not what it should be.
        """
        return self.encode(self.layout(entities, scene))

    def layout(self, entities: Sequence[Entity], scene: NDArray[Any]) -> Layout:
        """Measure what `encode` needs: classes, neighbours and coverage. Arguments as for `ssi`."""
        classes = class_map(scene)
        moving = [entity for entity in entities if entity.kind in DYNAMIC_CLASSES]
        kinds = np.array([DESCRIPTOR_CLASSES.index(entity.kind) for entity in moving], np.int64)
        neighbours = np.zeros((len(moving), len(DESCRIPTOR_CLASSES), len(Direction)), np.bool_)
        coverage = np.zeros((len(moving), GRID, GRID), np.float32)
        row_cells, column_cells = (_cell_membership(size) for size in classes.shape)
        for i, entity in enumerate(moving):
            rows, columns = entity.box.area
            mask = entity.mask.astype(np.float32)
            coverage[i] = row_cells[:, rows] @ mask @ column_cells[:, columns].T
            neighbours[i] = _neighbours(entity, classes, self.grounding)
        return Layout(
            kinds=torch.from_numpy(kinds).to(self.device),
            neighbours=torch.from_numpy(neighbours).to(self.device),
            coverage=torch.from_numpy(coverage).to(self.device),
        )

    def encode(self, layout: Layout) -> Tensor:
        """Return SSI_i = C_i ⊗ N_i ⊗ S_i.

        C_i = h_c is the symbol of the entity's class. N_i = Σ h_k ⊗ h_d ⊗ h_c over the neighbours,
        class k in direction d; without any it is the identity of ⊗, or the entity would vanish.
        S_i = Σ ρ_xy G_xy over the grid's cells.

        Args:
            layout: k entities, of one scene or of many.

        Returns:
            float32 (k, D).

        Source: paper, section on SSI and its equation for SSI_i.
        """
        own = self._classes[layout.kinds]
        found = layout.neighbours.flatten(1)
        around = _weighted_sum(found.to(torch.float32), self._pairs) * own
        around = torch.where(found.any(dim=1, keepdim=True), around, torch.ones_like(around))
        place = _weighted_sum(layout.coverage.flatten(1), self._cells)
        return hrr.from_spectrum(own * around * place, self.codebook.dimension)

    def bundle(self, vectors: Tensor, weights: Tensor | Sequence[float]) -> Tensor:
        """Return VSR = Σ w_i E_i; of no entities it is zero.

        Args:
            vectors: E_i, (k, D).
            weights: w_i, k numbers, from the knowledge base's `entity_weights`.

        Returns:
            (D,), of the vectors' type.

        Raises:
            UsageError: there are not as many weights as vectors.

        Source: paper, equation for VSR.
        """
        factors = torch.as_tensor(weights, dtype=vectors.dtype, device=vectors.device)
        if factors.shape != vectors.shape[:-1]:
            raise UsageError(
                f"{factors.numel()} weights for {vectors.shape[0]} entities",
                name="weights",
                suggestion="one for each pedestrian, vehicle and truck, in the entities' order",
            )
        return hrr.bundle(vectors, factors)


def _neighbours(
    entity: Entity, classes: ClassMap, grounding: SegmentationGrounding
) -> NDArray[np.bool_]:
    """Return which descriptor class is found on which side of an entity, bool (6, 3)."""
    sides = [classes[entity.beside(side, grounding.window)] for side in Direction]
    pixels = [np.bincount(seen.ravel(), minlength=CLASS_COUNT) for seen in sides]
    found: NDArray[np.bool_] = np.stack(pixels, axis=1) >= grounding.minimum_pixels
    return found[list(DESCRIPTOR_CLASSES)]


def _cell_membership(size: int) -> NDArray[np.float32]:
    """Return which of the grid's 16 stripes a row or column is in, float32 (16, size).

    Entries are 1 over the stripe's width instead of 1, so that sums of them are covered shares.
    """
    width, rest = divmod(size, GRID)
    if rest or not width:
        raise UsageError(
            f"a map with a side of {size} px has no {GRID}×{GRID} grid of equal cells",
            name="classes",
            suggestion=f"its sides are multiples of {GRID}",
        )
    stripes = np.eye(GRID, dtype=np.float32) / np.float32(width)
    return np.repeat(stripes, width, axis=1)


def _as_reals(spectra: Tensor) -> Tensor:
    """Return complex (n, F) as float (n, 2F)."""
    return torch.view_as_real(spectra).flatten(1)


def _weighted_sum(weights: Tensor, spectra: Tensor) -> Tensor:
    """Return Σ_j weights_ij spectra_j: real weights (k, n), spectra as reals; complex (k, F)."""
    sums = weights @ spectra
    return torch.view_as_complex(sums.reshape(len(weights), spectra.shape[1] // 2, 2))
