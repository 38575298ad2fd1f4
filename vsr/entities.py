"""Entities: the clusters of a segmentation map, each with its confidence, box and mask."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from numbers import Integral
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sfol.errors import UsageError
from vsr.arrays import checked_array
from vsr.classes import CLASS_COUNT, ENTITY_CLASSES, SemanticClass

ClassMap = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Area = tuple[slice, slice]

_SUM_TOLERANCE = 1e-3
_BY_EDGES = ndimage.generate_binary_structure(rank=2, connectivity=1)


class Direction(StrEnum):
    """Where a neighbour lies, seen from the entity (paper, section on SSI)."""

    LEFT_OF = "left_of"
    RIGHT_OF = "right_of"
    BELOW_OF = "below_of"


class Box(NamedTuple):
    """A rectangle in px; bottom and right are exclusive, so they are also its lower edges."""

    top: int
    left: int
    bottom: int
    right: int

    @property
    def area(self) -> Area:
        """The rectangle as rows and columns, for indexing a map."""
        return slice(self.top, self.bottom), slice(self.left, self.right)


@dataclass(frozen=True, eq=False)
class Entity:
    """One thing in the picture.

    Attributes:
        name: the constant that stands for it in the facts, such as ``pedestrian1``.
        kind: its semantic class.
        confidence: τ̂, the mean probability of its class over its pixels, 0 to 1.
        box: the smallest rectangle around it, in px.
        mask: bool (box height, box width), its pixels within the box.

    Raises:
        UsageError: mask and box do not fit, or the confidence is not from 0 to 1.
    """

    name: str
    kind: SemanticClass
    confidence: float
    box: Box
    mask: Mask

    def __post_init__(self) -> None:
        top, left, bottom, right = self.box
        checked_array(self.mask, np.bool_, (bottom - top, right - left), "mask")
        if not 0.0 <= self.confidence <= 1.0:
            raise UsageError(
                f"a confidence of {self.confidence}", name=self.name, suggestion="0 to 1"
            )

    @property
    def area(self) -> int:
        """Number of its pixels."""
        return int(np.count_nonzero(self.mask))

    @property
    def centre(self) -> tuple[float, float]:
        """Row and column of the middle of its box, in px from the picture's upper left corner."""
        top, left, bottom, right = self.box
        return (top + bottom) / 2, (left + right) / 2

    @property
    def bottom(self) -> int:
        """Row of its lower edge, in px, where it meets the ground if that can be seen."""
        return self.box.bottom

    def beside(self, direction: Direction, size: int) -> Area:
        """Return the window along one side of the box (paper, section on SSI: 15 cells).

        Args:
            direction: the side.
            size: how far the window reaches, in px. It ends at the border of the map.

        Returns:
            The rows and columns of the window, which may be empty.
        """
        top, left, bottom, right = self.box
        match direction:
            case Direction.LEFT_OF:
                return slice(top, bottom), slice(max(left - size, 0), left)
            case Direction.RIGHT_OF:
                return slice(top, bottom), slice(right, right + size)
            case Direction.BELOW_OF:
                return slice(bottom, bottom + size), slice(left, right)

    def on(self, area: Area) -> Mask:
        """Return the entity's pixels on a rectangle of the map.

        Args:
            area: rows and columns, which may reach beyond the map.

        Returns:
            bool, of the rectangle's shape, false wherever the entity is not.
        """
        (rows, columns), (top, left, bottom, right) = area, self.box
        height, width = rows.stop - rows.start, columns.stop - columns.start
        pixels = np.zeros((height, width), np.bool_)
        pixels[
            _clip(top - rows.start, height) : _clip(bottom - rows.start, height),
            _clip(left - columns.start, width) : _clip(right - columns.start, width),
        ] = self.mask[
            _clip(rows.start - top, bottom - top) : _clip(rows.stop - top, bottom - top),
            _clip(columns.start - left, right - left) : _clip(columns.stop - left, right - left),
        ]
        return pixels


def class_map(scene: NDArray[Any]) -> ClassMap:
    """Return the most probable class of every pixel; of equal ones, the first.

    Args:
        scene: float (28, H, W), class probabilities that sum to one over the first axis; or
            uint8 (H, W), a class map, which is returned as it is, so that callers who need it
            several times can compute it once.

    Returns:
        uint8 (H, W), numbers of `SemanticClass`.

    Raises:
        UsageError: the array is neither of the two.
    """
    if is_class_map(scene):
        return checked_classes(scene)
    _check_probabilities(scene)
    best = scene[0].copy()
    classes = np.zeros(best.shape, np.uint8)
    # numpy's argmax over the first axis takes ten times as long.
    for number in range(1, CLASS_COUNT):
        greater = scene[number] > best
        np.maximum(best, scene[number], out=best)
        np.maximum(classes, greater.view(np.uint8) * np.uint8(number), out=classes)
    return classes


def find_entities(
    scene: NDArray[Any],
    minimum_area: int = 1,
    classes: ClassMap | None = None,
) -> tuple[Entity, ...]:
    """Find the pedestrians, vehicles, trucks and crosswalks of a segmentation map.

    Every cluster of pixels of one class is an entity, as `scipy.ndimage.label` finds them (pixels
    touch by their edges). Parts of a crosswalk that share rows of the picture are one crosswalk
    that something in front of it cuts apart.

    Args:
        scene: float32 (28, H, W), probabilities that sum to one over the first axis; or uint8
            (H, W), a class map, whose entities have the confidence 1.
        minimum_area: how many pixels an entity has at least.
        classes: uint8 (H, W), the `class_map` of the probabilities where it is at hand.

    Returns:
        The entities, class by class in the order of `ENTITY_CLASSES`, and within a class the
        lowest in the picture first, which is the nearest; names count in this order.

    Raises:
        UsageError: the map or the minimum area is not what it should be.

    Source: paper, section "Obtain Predicates".
    """
    if not isinstance(minimum_area, Integral) or minimum_area < 1:
        raise UsageError(
            f"minimum_area is {minimum_area}", name="minimum_area", suggestion="an integer, ≥ 1"
        )
    certain = is_class_map(scene)
    if certain:
        checked_classes(scene)
    else:
        checked_array(scene, np.floating, (CLASS_COUNT, "H", "W"), "probabilities")
    labels = class_map(scene) if classes is None else checked_classes(classes)
    if scene.shape[-2:] != labels.shape:
        raise UsageError(
            f"the class map {labels.shape} does not belong to the map {scene.shape}",
            name="classes",
        )
    return tuple(
        entity
        for kind in ENTITY_CLASSES
        for entity in _entities_of(kind, labels, None if certain else scene[kind], minimum_area)
    )


def _entities_of(
    kind: SemanticClass,
    labels: ClassMap,
    layer: NDArray[np.floating[Any]] | None,
    minimum_area: int,
) -> Iterator[Entity]:
    """Yield the entities of one class; without a layer of probabilities it is certain of them."""
    clusters = _clusters(labels == kind.value)
    if kind is SemanticClass.CROSSWALK:
        clusters = _merge_row_bands(clusters)
    large = [(box, mask) for box, mask in clusters if np.count_nonzero(mask) >= minimum_area]
    nearest_first = sorted(large, key=lambda cluster: (-cluster[0].bottom, cluster[0].left))
    for number, (box, mask) in enumerate(nearest_first, start=1):
        yield Entity(
            name=f"{kind.name.lower()}{number}",
            kind=kind,
            confidence=1.0 if layer is None else _mean_probability(layer[box.area][mask]),
            box=box,
            mask=mask,
        )


def _clusters(layer: Mask) -> list[tuple[Box, Mask]]:
    # Labelling only where there are any pixels saves most of the time.
    rows = np.flatnonzero(layer.any(axis=1))
    if not rows.size:
        return []
    top, bottom = int(rows[0]), int(rows[-1]) + 1
    columns = np.flatnonzero(layer[top:bottom].any(axis=0))
    left, right = int(columns[0]), int(columns[-1]) + 1
    numbered, _ = ndimage.label(layer[top:bottom, left:right], _BY_EDGES)
    return [
        (
            Box(top + down.start, left + across.start, top + down.stop, left + across.stop),
            numbered[down, across] == number,
        )
        for number, (down, across) in enumerate(ndimage.find_objects(numbered), start=1)
    ]


def _merge_row_bands(parts: Iterable[tuple[Box, Mask]]) -> list[tuple[Box, Mask]]:
    bands: list[list[tuple[Box, Mask]]] = []
    reach = -1
    for part in sorted(parts, key=lambda part: part[0]):
        if part[0].top >= reach:
            bands.append([])
        bands[-1].append(part)
        reach = max(reach, part[0].bottom)
    return [_union(band) for band in bands]


def _union(parts: list[tuple[Box, Mask]]) -> tuple[Box, Mask]:
    tops, lefts, bottoms, rights = zip(*(box for box, _ in parts), strict=True)
    whole = Box(min(tops), min(lefts), max(bottoms), max(rights))
    mask = np.zeros((whole.bottom - whole.top, whole.right - whole.left), np.bool_)
    for (top, left, bottom, right), part in parts:
        rows = slice(top - whole.top, bottom - whole.top)
        columns = slice(left - whole.left, right - whole.left)
        mask[rows, columns] |= part
    return whole, mask


def _clip(offset: int, size: int) -> int:
    return min(max(offset, 0), size)


def _mean_probability(probabilities: NDArray[np.floating[Any]]) -> float:
    # The paper's τ̂_c = 1/|R_c| Σ σ(p); rounding may lift a mean of ones above one.
    mean = float(probabilities.mean(dtype=np.float64))
    return min(mean, 1.0) if mean <= 1.0 + _SUM_TOLERANCE else mean


def is_class_map(scene: NDArray[Any]) -> bool:
    """Tell a class map, uint8, from probabilities, which are floats."""
    return bool(getattr(scene, "dtype", None) == np.uint8)


def checked_classes(classes: NDArray[Any]) -> ClassMap:
    """Return a class map, uint8 (H, W).

    Raises:
        UsageError: it is none, is empty, or has numbers beyond the classes.
    """
    checked_array(classes, np.uint8, ("H", "W"), "a class map")
    if classes.max() >= CLASS_COUNT:
        raise UsageError(
            "a class map has numbers beyond the classes",
            name="classes",
            suggestion=f"its numbers are 0 to {CLASS_COUNT - 1}",
        )
    return classes


def check_within(entities: Iterable[Entity], shape: tuple[int, ...]) -> None:
    """Refuse entities of another map.

    Args:
        entities: what was found.
        shape: (H, W) of the map.

    Raises:
        UsageError: one reaches beyond the map.
    """
    height, width = shape
    for entity in entities:
        top, left, bottom, right = entity.box
        if top < 0 or left < 0 or bottom > height or right > width:
            raise UsageError(
                f"'{entity.name}', {tuple(entity.box)}, is beyond a map of {height}×{width} px",
                name=entity.name,
                suggestion="entities and map are of the same frame",
            )


def _check_probabilities(scene: NDArray[Any]) -> None:
    checked_array(scene, np.floating, (CLASS_COUNT, "H", "W"), "a segmentation map")
    # Written so that NaN fails them too.
    sums = scene.sum(axis=0)
    if not (scene.min() >= 0.0 and np.abs(sums - 1.0).max() <= _SUM_TOLERANCE):
        raise UsageError(
            "the probabilities of a segmentation map do not sum to one at every pixel",
            name="probabilities",
            suggestion="apply softmax over the class axis; NaN and negative numbers are errors",
        )
