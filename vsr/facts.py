"""Facts of a scene: what the entities of a segmentation map say about it.

One function for each family of predicates in the paper's table; each yields atoms as tuples, such
as ``("OnRoad", "pedestrian1")``. Rows and columns are measured in px from the picture's upper left
corner, so that a pixel reaches from its index to the next.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sfol.facts import Bound, Facts
from vsr.classes import CLASS_COUNT, DYNAMIC_CLASSES, SemanticClass
from vsr.entities import Area, ClassMap, Direction, Entity, Mask, check_within, class_map
from vsr.grounding import Camera, SegmentationGrounding, UnratedPredicate

FloatArray = NDArray[np.floating[Any]]
UnratedAtom = tuple[UnratedPredicate, *tuple[str, ...]]

_PREDICATES = {kind: kind.name.capitalize() for kind in SemanticClass}

# The three grounds of which a pedestrian stands on one. On equal evidence the first counts: it is
# the one that asks for more care. A road's markings are part of it.
_GROUNDS: dict[SemanticClass, tuple[SemanticClass, ...]] = {
    SemanticClass.CROSSWALK: (SemanticClass.CROSSWALK,),
    SemanticClass.ROAD: (SemanticClass.ROAD, SemanticClass.ROAD_LINE),
    SemanticClass.SIDEWALK: (SemanticClass.SIDEWALK,),
}


def scene_facts(
    entities: Sequence[Entity],
    probabilities: NDArray[Any],
    grounding: SegmentationGrounding,
    facts: Facts,
    subject: str = "ego",
) -> Facts:
    """Assert everything that a scene shows.

    Args:
        entities: what `find_entities` found in the map.
        probabilities: float32 (28, H, W), or its `class_map`, uint8 (H, W).
        grounding: how to read the map.
        facts: empty facts, which are filled; their margin makes bounds of confidences.
        subject: the constant that stands for ego.

    Returns:
        The same facts.

    Raises:
        UsageError: the map is not what it should be, or the entities are of another.

    Source: paper, section "Obtain Predicates" and Table of predicates.
    """
    classes = class_map(probabilities)
    pinhole = Pinhole.of(grounding.camera, classes.shape)
    evidence = MapEvidence(entities, classes, grounding, pinhole)
    return add_facts(
        facts, entities, unrated_atoms(evidence, grounding, pinhole, subject), grounding
    )


def add_facts(
    facts: Facts,
    entities: Iterable[Entity],
    atoms: Iterable[UnratedAtom],
    grounding: SegmentationGrounding,
) -> Facts:
    """Assert each entity's class with its confidence, and the atoms that have none of their own.

    Args:
        facts: are filled; their margin makes bounds of confidences.
        entities: what is seen.
        atoms: what is said of it.
        grounding: has the bounds of the atoms.

    Returns:
        The same facts.
    """
    certain = Bound.around(1.0, facts.margin)  # as most are, so that it is made once
    for entity in entities:
        predicate = _PREDICATES[entity.kind]
        if entity.confidence == 1.0:
            facts.add(predicate, entity.name, bound=certain)
        else:
            facts.add(predicate, entity.name, confidence=entity.confidence)
    for predicate, *constants in atoms:
        pair = grounding.bounds.get(predicate)
        facts.add(predicate, *constants, bound=None if pair is None else _bound(*pair))
    return facts


@lru_cache(maxsize=32)  # a knowledge base has few, and they come at every step
def _bound(lower: float, upper: float) -> Bound:
    return Bound.checked(lower, upper)


class Evidence(Protocol):
    """What is seen of the entities of a scene, in pixels of a map or by rays through a world.

    How much of something is seen is counted in px of the picture; what that says is decided by
    `unrated_atoms`, the same for everybody.

    """

    @property
    def entities(self) -> Sequence[Entity]:
        """Everything that is seen."""
        ...

    @property
    def standing(self) -> Mapping[Entity, SemanticClass | None]:
        """Each pedestrian's ground; None where none is seen."""
        ...

    def beside(self, person: Entity) -> Mapping[Entity, float]:
        """Return how many px of each vehicle lie in the windows beside a pedestrian.

        Vehicles stand in the order of the entities; those of which none do may be left out.
        """
        ...

    def before(self, other: Entity) -> Mapping[Entity, float]:
        """Return how many px of each vehicle lie before a crosswalk or pedestrian, or touch one.

        Only of vehicles that are closer, which is what reaches lower in the picture; others may be
        left out.
        """
        ...

    def is_trodden(self, crosswalk: Entity) -> bool:
        """Tell whether a pedestrian stands on a crosswalk."""
        ...

    def in_lane(self, vehicle: Entity) -> float:
        """Return in how many columns a vehicle meets the road within ego's lane."""
        ...


def unrated_atoms(
    evidence: Evidence, grounding: SegmentationGrounding, pinhole: Pinhole, subject: str
) -> Iterator[UnratedAtom]:
    """Yield the atoms that have no confidence of their own, family by family.

    Args:
        evidence: what is seen.
        grounding: how much of it is enough.
        pinhole: the camera.
        subject: ego's name.
    """
    people = of_kind(evidence.entities, SemanticClass.PEDESTRIAN)
    vehicles = of_kind(evidence.entities, SemanticClass.VEHICLE, SemanticClass.TRUCK)
    crosswalks = of_kind(evidence.entities, SemanticClass.CROSSWALK)
    enough = grounding.minimum_pixels
    # Asked for one by one, all pairs would be more than a map of many small entities has pixels.
    before = [
        (vehicle, place, other.name)
        for place, other in enumerate([*crosswalks, *people])
        for vehicle, pixels in evidence.before(other).items()
        if pixels >= enough
    ]
    order = {vehicle: place for place, vehicle in enumerate(vehicles)}
    hidden = [
        (vehicle.name, other)
        for vehicle, _, other in sorted(before, key=lambda found: (order[found[0]], found[1]))
    ]
    yield from regions(evidence.entities, 2 * pinhole.middle, subject)
    yield from crosswalk_distances(crosswalks, grounding, pinhole, subject)
    yield from grounds(evidence.standing)
    for person in people:
        for vehicle, pixels in evidence.beside(person).items():
            if pixels >= enough:
                yield "IsNear", person.name, vehicle.name
    for vehicle_name, other_name in hidden:
        yield "Occludes", vehicle_name, other_name
    occluded = {name for _, name in hidden} if grounding.clear_requires_unoccluded else set()
    for crosswalk in crosswalks:
        if crosswalk.name not in occluded and not evidence.is_trodden(crosswalk):
            yield "IsClear", crosswalk.name
    # The paper's explicit negations: no crosswalk within the farther of the approach distances, no
    # vehicle or truck in ego's lane, however far away.
    if all(pinhole.distance(a.bottom) > grounding.approaching[1] for a in crosswalks):
        yield "NoCrosswalk", subject
    if not any(evidence.in_lane(vehicle) >= enough for vehicle in vehicles):
        yield "EmptyLane", subject


@dataclass(frozen=True)
class Pinhole:
    """A level pinhole camera over a flat road (Szeliski, "Computer Vision", 2010, section 2.1).

    A point of the road Z m ahead and X m to the right is seen f·h/Z px below the horizon and
    f·X/Z px right of the middle, for a lens h m above the road with a focal length of f px.

    Attributes:
        focal: f, in px.
        height: h, in m.
        horizon: row of the horizon, in px.
        middle: column straight ahead, in px.
    """

    focal: float
    height: float
    horizon: float
    middle: float

    @classmethod
    def of(cls, camera: Camera, shape: tuple[int, ...]) -> Pinhole:
        """Return the camera of a picture of this shape (H, W)."""
        height, width = shape
        return cls(camera.focal_length(width), camera.height, height / 2, width / 2)

    def distance(self, row: float) -> float:
        """Return Z in m of the road seen at a row; infinity at and above the horizon."""
        below = row - self.horizon
        return self.focal * self.height / below if below > 0 else math.inf

    def lateral(self, column: float, distance: float) -> float:
        """Return X in m of what a column shows at a distance Z in m."""
        return (column - self.middle) * distance / self.focal

    def columns(self, lateral: float, rows: FloatArray) -> FloatArray:
        """Return the columns at which the rows show the road X m to the right of the middle."""
        return self.middle + lateral * self._pixels_per_metre(rows)

    def laterals(self, columns: FloatArray, rows: FloatArray) -> FloatArray:
        """Return X in m of the road at these pixels; infinite at and above the horizon."""
        scale = self._pixels_per_metre(rows)
        laterals: FloatArray = np.full(scale.shape, np.inf)
        np.divide(columns - self.middle, scale, out=laterals, where=scale > 0)
        return laterals

    def _pixels_per_metre(self, rows: FloatArray) -> FloatArray:
        # f/Z, which is the drop below the horizon over h; above the horizon there is no road
        below: FloatArray = np.maximum(rows - self.horizon, 0.0)
        return below / self.height


def regions(entities: Iterable[Entity], width: float, subject: str) -> Iterator[UnratedAtom]:
    """Yield LeftOf, CenterOf or RightOf(entity, ego) of everything that moves.

    The picture is cut into three equal parts from left to right; the one in which the middle of
    the entity's box lies decides. A middle on a border counts as centre.

    Args:
        entities: all entities.
        width: W of the picture, in px.
        subject: ego's name.
    """
    for entity in of_kind(entities, *DYNAMIC_CLASSES):
        third = 3 * entity.centre[1] / width
        yield _region(third), entity.name, subject


def _region(third: float) -> UnratedPredicate:
    if third < 1:
        return "LeftOf"
    return "RightOf" if third > 2 else "CenterOf"


def crosswalk_distances(
    crosswalks: Sequence[Entity],
    grounding: SegmentationGrounding,
    pinhole: Pinhole,
    subject: str,
) -> Iterator[UnratedAtom]:
    """Yield Approaching or IsAt(ego, crosswalk), by the distance of its nearest visible row.

    Approaching for near ≤ d ≤ far, IsAt for d < near (paper: 50 and 200 m), else neither.
    """
    near, far = grounding.approaching
    for crosswalk in crosswalks:
        distance = pinhole.distance(crosswalk.bottom)
        if distance < near:
            yield "IsAt", subject, crosswalk.name
        elif distance <= far:
            yield "Approaching", subject, crosswalk.name


def grounds(standing: Mapping[Entity, SemanticClass | None]) -> Iterator[UnratedAtom]:
    """Yield OnRoad or OnCrosswalk(pedestrian); on the sidewalk or on unseen ground neither.

    Args:
        standing: each pedestrian's ground, from `ground_of`.
    """
    for person, ground in standing.items():
        if ground is SemanticClass.ROAD:
            yield "OnRoad", person.name
        if ground is SemanticClass.CROSSWALK:
            yield "OnCrosswalk", person.name


def ground_of(person: Entity, classes: ClassMap, window: int) -> SemanticClass | None:
    """Return the ground on which a pedestrian stands: what most of the window below shows.

    Each row counts twice as much as the next one away from the feet: far ahead a crosswalk is two
    or three rows deep, and most of the window shows the road before it.

    Args:
        person: the pedestrian.
        classes: uint8 (H, W), the class map.
        window: depth of the window, in px (paper: 15).

    Returns:
        CROSSWALK, ROAD or SIDEWALK, or None where the window shows none of them.
    """
    area = _feet(person, classes.shape[0], window)
    seen = classes[area]
    weights = _row_weights(person.bottom - area[0].start, *seen.shape)
    shares = np.bincount(seen.ravel(), weights, minlength=CLASS_COUNT).tolist()
    evidence = {
        ground: sum(shares[member] for member in members) for ground, members in _GROUNDS.items()
    }
    best = max(evidence, key=evidence.__getitem__)
    return best if evidence[best] > 0 else None


@lru_cache(maxsize=1024)  # people have few widths
def _row_weights(feet: int, rows: int, columns: int) -> FloatArray:
    """Return the weight of each pixel of a window, float64 (rows·columns,); `feet` is a row."""
    weights: FloatArray = 0.5 ** np.abs(np.arange(rows) + 0.5 - feet)
    return np.repeat(weights, columns)


def _feet(person: Entity, height: int, window: int) -> Area:
    """Return the window below a pedestrian.

    Where the picture ends at the pedestrian's lower edge, nothing is below: there it is the lowest
    part of the box and what lies beside it.
    """
    if person.bottom < height:
        return person.beside(Direction.BELOW_OF, window)
    rows = slice(max(person.bottom - window, 0), person.bottom)
    return rows, slice(max(person.box.left - window, 0), person.box.right + window)


@dataclass(frozen=True, eq=False)
class _Numbered:
    """Entities that share no pixel, as a map of their numbers, so that a window tells who is in it.

    Attributes:
        entities: in order.
        numbers: int32 (H, W), the place of each pixel's entity, from 1; 0 where there is none.
    """

    entities: Sequence[Entity]
    numbers: NDArray[np.int32]

    @classmethod
    def of(cls, entities: Sequence[Entity], shape: tuple[int, ...]) -> _Numbered:
        numbers = np.zeros(shape, np.int32)
        for number, entity in enumerate(entities, start=1):
            numbers[entity.box.area][entity.mask] = number
        return cls(entities, numbers)

    def within(self, *areas: Area) -> dict[Entity, int]:
        """Return who has how many pixels in some areas, which may reach beyond the map."""
        return self.counted(*[self.numbers[area] for area in areas])

    def counted(self, *pixels: NDArray[np.int32]) -> dict[Entity, int]:
        """Return who has how many of some pixels, in the entities' order."""
        seen = [part[part > 0] for part in pixels if np.count_nonzero(part)]
        if not seen:
            return {}
        counts = Counter(np.concatenate(seen).tolist())
        return {self.entities[number - 1]: counts[number] for number in sorted(counts)}


class MapEvidence:
    """What the pixels of a class map show of its entities.

    Args:
        entities: what `find_entities` found in the map.
        classes: uint8 (H, W), the class map.
        grounding: how to read the map.
        pinhole: the camera.

    Raises:
        UsageError: an entity reaches beyond the map.
    """

    def __init__(
        self,
        entities: Sequence[Entity],
        classes: ClassMap,
        grounding: SegmentationGrounding,
        pinhole: Pinhole,
    ) -> None:
        check_within(entities, classes.shape)
        self.entities = entities
        self.standing: Mapping[Entity, SemanticClass | None] = {
            person: ground_of(person, classes, grounding.window)
            for person in of_kind(entities, SemanticClass.PEDESTRIAN)
        }
        self._grounding = grounding
        self._pinhole = pinhole
        vehicles = of_kind(entities, SemanticClass.VEHICLE, SemanticClass.TRUCK)
        self._vehicles = _Numbered.of(vehicles, classes.shape)
        feet = [
            _feet(person, classes.shape[0], grounding.window)
            for person, ground in self.standing.items()
            if ground is SemanticClass.CROSSWALK
        ]
        crosswalks = of_kind(entities, SemanticClass.CROSSWALK) if feet else []
        self._trodden = _Numbered.of(crosswalks, classes.shape).within(*feet)

    def beside(self, person: Entity) -> Mapping[Entity, int]:
        """See `Evidence`."""
        sides = (Direction.LEFT_OF, Direction.RIGHT_OF)
        return self._vehicles.within(*(person.beside(s, self._grounding.window) for s in sides))

    def before(self, other: Entity) -> Mapping[Entity, int]:
        """See `Evidence`. Paper: the other lies behind it along the same line of sight."""
        if other.kind is SemanticClass.CROSSWALK:
            return _before_crosswalk(self._vehicles, other, self._grounding.road, self._pinhole)
        return _before_person(self._vehicles, other)

    def is_trodden(self, crosswalk: Entity) -> bool:
        """See `Evidence`."""
        return crosswalk in self._trodden

    def in_lane(self, vehicle: Entity) -> float:
        """See `Evidence`."""
        _, left, bottom, right = vehicle.box
        # the lower edge of each column's lowest pixel
        rows = bottom - np.argmax(vehicle.mask[::-1], axis=0)
        laterals = self._pinhole.laterals(np.arange(left, right) + 0.5, rows)
        return int(np.count_nonzero(np.abs(laterals) < self._grounding.lane_half_width))


def _before_crosswalk(
    vehicles: _Numbered, crosswalk: Entity, road: tuple[float, float], pinhole: Pinhole
) -> dict[Entity, int]:
    """Return how many pixels of each vehicle lie before a crosswalk, seen or hidden.

    What is hidden leaves no pixels, so the crosswalk's rows are taken to reach across the road.
    Only a vehicle that meets the ground before the crosswalk's middle is closer: one that stands
    just behind may still touch its far edge by a row.
    """
    top, left, bottom, right = crosswalk.box
    rows = np.arange(top, bottom) + 0.5
    first = np.minimum(pinhole.columns(road[0], rows), left)[:, None]
    last = np.maximum(pinhole.columns(road[1], rows), right)[:, None]
    columns = np.arange(vehicles.numbers.shape[1]) + 0.5
    band = (columns > first) & (columns < last)
    return _closer(vehicles.counted(vehicles.numbers[top:bottom][band]), crosswalk.centre[0])


def _before_person(vehicles: _Numbered, person: Entity) -> dict[Entity, int]:
    """Return how many pixels of each closer vehicle touch what is visible of a pedestrian."""
    top, left, bottom, right = person.box
    first_row, first_column = max(top - 1, 0), max(left - 1, 0)
    around = vehicles.numbers[first_row : bottom + 1, first_column : right + 1]
    if not np.count_nonzero(around):
        return {}
    touched = _and_neighbours(person.mask)
    touched = touched[first_row - (top - 1) :, first_column - (left - 1) :]
    touched = touched[: around.shape[0], : around.shape[1]]
    return _closer(vehicles.counted(around[touched]), person.bottom)


def _and_neighbours(mask: Mask) -> Mask:
    """Return the pixels of a mask (h, w) and all that touch them, bool (h + 2, w + 2)."""
    height, width = mask.shape
    grown = np.zeros((height + 2, width + 2), np.bool_)
    for down, right in ((1, 1), (0, 1), (2, 1), (1, 0), (1, 2)):
        grown[down : down + height, right : right + width] |= mask
    return grown


def _closer(found: Mapping[Entity, int], row: float) -> dict[Entity, int]:
    """Return those whose lower edge is below a row."""
    return {vehicle: pixels for vehicle, pixels in found.items() if vehicle.bottom > row}


def of_kind(entities: Iterable[Entity], *kinds: SemanticClass) -> list[Entity]:
    """Return the entities of some kinds, in their order."""
    return [entity for entity in entities if entity.kind in kinds]
