"""Facts of a scene: what the entities of a segmentation map say about it.

One function for each family of predicates in the paper's table; each yields atoms as tuples, such
as ``("OnRoad", "pedestrian1")``. Rows and columns are measured in px from the picture's upper left
corner, so that a pixel reaches from its index to the next.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sfol.facts import Bound, Facts
from vsr.classes import CLASS_COUNT, DYNAMIC_CLASSES, SemanticClass
from vsr.entities import Area, ClassMap, Direction, Entity, class_map
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
        UsageError: the map is not what it should be.

    Source: paper, section "Obtain Predicates" and Table of predicates.
    """
    classes = class_map(probabilities)
    atoms = _unrated_atoms(entities, classes, grounding, subject)
    return add_facts(facts, entities, atoms, grounding)


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


def _unrated_atoms(
    entities: Sequence[Entity],
    classes: ClassMap,
    grounding: SegmentationGrounding,
    subject: str,
) -> Iterator[UnratedAtom]:
    """Yield the atoms that have no confidence of their own, family by family."""
    pinhole = Pinhole.of(grounding.camera, classes.shape)
    people = _of_kind(entities, SemanticClass.PEDESTRIAN)
    vehicles = _of_kind(entities, SemanticClass.VEHICLE, SemanticClass.TRUCK)
    crosswalks = _of_kind(entities, SemanticClass.CROSSWALK)
    standing = {person: ground_of(person, classes, grounding.window) for person in people}
    hidden = tuple(occlusions(vehicles, [*crosswalks, *people], grounding, pinhole))

    yield from regions(entities, classes.shape[1], subject)
    yield from crosswalk_distances(crosswalks, grounding, pinhole, subject)
    yield from grounds(standing)
    yield from nearness(people, vehicles, grounding)
    yield from hidden
    yield from clear_crosswalks(crosswalks, standing, hidden, classes.shape[0], grounding)
    yield from absences(crosswalks, vehicles, grounding, pinhole, subject)


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


def regions(entities: Sequence[Entity], width: int, subject: str) -> Iterator[UnratedAtom]:
    """Yield LeftOf, CenterOf or RightOf(entity, ego) of everything that moves.

    The picture is cut into three equal parts from left to right; the one in which the middle of
    the entity's box lies decides. A middle on a border counts as centre.

    Args:
        entities: all entities.
        width: W of the picture, in px.
        subject: ego's name.
    """
    for entity in _of_kind(entities, *DYNAMIC_CLASSES):
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
    rows = area[0].start + np.arange(len(seen)) + 0.5
    weights = 0.5 ** np.abs(rows - person.bottom)
    shares = np.bincount(seen.ravel(), np.repeat(weights, seen.shape[1]), minlength=CLASS_COUNT)
    evidence = {ground: shares[list(members)].sum() for ground, members in _GROUNDS.items()}
    best = max(evidence, key=evidence.__getitem__)
    return best if evidence[best] > 0 else None


def _feet(person: Entity, height: int, window: int) -> Area:
    """Return the window below a pedestrian.

    Where the picture ends at the pedestrian's lower edge, nothing is below: there it is the lowest
    part of the box and what lies beside it.
    """
    if person.bottom < height:
        return person.beside(Direction.BELOW_OF, window)
    rows = slice(max(person.bottom - window, 0), person.bottom)
    return rows, slice(max(person.box.left - window, 0), person.box.right + window)


def nearness(
    people: Sequence[Entity], vehicles: Sequence[Entity], grounding: SegmentationGrounding
) -> Iterator[UnratedAtom]:
    """Yield IsNear(pedestrian, vehicle) for enough of the vehicle in the windows beside."""
    for person in people:
        sides = [
            person.beside(side, grounding.window)
            for side in (Direction.LEFT_OF, Direction.RIGHT_OF)
        ]
        for vehicle in vehicles:
            pixels = sum(np.count_nonzero(vehicle.on(side)) for side in sides)
            if pixels >= grounding.minimum_pixels:
                yield "IsNear", person.name, vehicle.name


def occlusions(
    vehicles: Sequence[Entity],
    others: Sequence[Entity],
    grounding: SegmentationGrounding,
    pinhole: Pinhole,
) -> Iterator[UnratedAtom]:
    """Yield Occludes(vehicle, crosswalk or pedestrian).

    Paper: an entity is occluded if another lies closer to ego along the same line of sight. Closer
    is what reaches lower in the picture.

    Args:
        vehicles: all vehicles and trucks.
        others: all crosswalks and pedestrians.
        grounding: how to read the map.
        pinhole: the camera.
    """
    for vehicle in vehicles:
        for other in others:
            if other.kind is SemanticClass.CROSSWALK:
                overlap = _before_crosswalk(vehicle, other, grounding.road, pinhole)
            else:
                overlap = _before_person(vehicle, other)
            if overlap >= grounding.minimum_pixels:
                yield "Occludes", vehicle.name, other.name


def _before_crosswalk(
    vehicle: Entity, crosswalk: Entity, road: tuple[float, float], pinhole: Pinhole
) -> int:
    """Return how many pixels of a vehicle lie before a crosswalk, seen or hidden.

    What is hidden leaves no pixels, so the crosswalk's rows are taken to reach across the road.
    Only a vehicle that meets the ground before the crosswalk's middle is closer: one that stands
    just behind may still touch its far edge by a row.
    """
    if vehicle.bottom <= crosswalk.centre[0]:
        return 0
    top, left, bottom, right = crosswalk.box
    rows = np.arange(top, bottom) + 0.5
    first = np.minimum(pinhole.columns(road[0], rows), left)[:, None]
    last = np.maximum(pinhole.columns(road[1], rows), right)[:, None]
    columns = np.arange(vehicle.box.left, vehicle.box.right) + 0.5
    band = (columns > first) & (columns < last)
    seen = vehicle.on((slice(top, bottom), vehicle.box.area[1]))
    return int(np.count_nonzero(band & seen))


def _before_person(vehicle: Entity, person: Entity) -> int:
    """Return how many pixels of a closer vehicle touch what is visible of a pedestrian."""
    if vehicle.bottom <= person.bottom:
        return 0
    top, left, bottom, right = person.box
    around = vehicle.on((slice(top - 1, bottom + 1), slice(left - 1, right + 1)))
    if not around.any():
        return 0
    return int(np.count_nonzero(around & ndimage.binary_dilation(np.pad(person.mask, 1))))


def clear_crosswalks(
    crosswalks: Sequence[Entity],
    standing: Mapping[Entity, SemanticClass | None],
    hidden: Sequence[UnratedAtom],
    height: int,
    grounding: SegmentationGrounding,
) -> Iterator[UnratedAtom]:
    """Yield IsClear(crosswalk) where no pedestrian stands on it.

    With `clear_requires_unoccluded` nothing may hide a part of it either.

    Args:
        crosswalks: all crosswalks.
        standing: each pedestrian's ground, from `ground_of`.
        hidden: what `occlusions` yields.
        height: H of the picture, in px.
        grounding: how to read the map.
    """
    walkers = [p for p, ground in standing.items() if ground is SemanticClass.CROSSWALK]
    feet = [_feet(walker, height, grounding.window) for walker in walkers]
    occluded = {atom[-1] for atom in hidden} if grounding.clear_requires_unoccluded else set()
    for crosswalk in crosswalks:
        taken = any(crosswalk.on(area).any() for area in feet)
        if not taken and crosswalk.name not in occluded:
            yield "IsClear", crosswalk.name


def absences(
    crosswalks: Sequence[Entity],
    vehicles: Sequence[Entity],
    grounding: SegmentationGrounding,
    pinhole: Pinhole,
    subject: str,
) -> Iterator[UnratedAtom]:
    """Yield NoCrosswalk(ego) and EmptyLane(ego), the paper's explicit negations.

    No crosswalk: none is seen within the farther of the approach distances. Empty lane: no vehicle
    or truck meets the road within half a lane's width of ego's centre line, at any distance.
    """
    if all(pinhole.distance(a.bottom) > grounding.approaching[1] for a in crosswalks):
        yield "NoCrosswalk", subject
    if not any(_in_lane(vehicle, grounding, pinhole) for vehicle in vehicles):
        yield "EmptyLane", subject


def _in_lane(vehicle: Entity, grounding: SegmentationGrounding, pinhole: Pinhole) -> bool:
    """Tell whether the lower outline of a vehicle, projected to the road, is in ego's lane."""
    _, left, bottom, right = vehicle.box
    # the lower edge of each column's lowest pixel
    rows = bottom - np.argmax(vehicle.mask[::-1], axis=0)
    laterals = pinhole.laterals(np.arange(left, right) + 0.5, rows)
    inside = np.abs(laterals) < grounding.lane_half_width
    return int(np.count_nonzero(inside)) >= grounding.minimum_pixels


def _of_kind(entities: Sequence[Entity], *kinds: SemanticClass) -> list[Entity]:
    return [entity for entity in entities if entity.kind in kinds]
