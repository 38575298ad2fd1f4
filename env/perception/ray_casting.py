"""Rays cast through the street: what the dash camera could see, without a picture.

One ray leaves the lens through each column of the picture that the dash camera would take. What
stands on the street fills, in each column that it meets, the rows from its top to the ground; what
is nearer hides what is farther. So nothing is seen here that the camera could not see, and all of
it is said in the camera's own terms, rows and columns in px.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from env.world.actors import Walkers
from env.world.camera import DashCameraParameters
from env.world.world import ParkedVehicle, World, leg_swings
from vsr.classes import SemanticClass
from vsr.entities import Box, Entity
from vsr.facts import Pinhole
from vsr.grounding import SegmentationGrounding

Array = npt.NDArray[np.floating[Any]]

# A person in m: length of a leg, of a foot before and behind it, half the breadth across the arms;
# and half of what the body fills from head to foot, seen from the front and from the side.
_LEG, _TOE, _HEEL, _ARMS, _FRONT, _SIDE = 0.88, 0.15, 0.07, 0.30, 0.16, 0.12
_LIMBS = 0.07  # share of the columns beside the body that arms and legs fill
_POST_HEIGHT = 3.0  # m; what is above hides nobody from a lens at 1.5 m

_NAMES = {kind: kind.name.lower() for kind in SemanticClass}
_FOOT = np.array([[_TOE], [_HEEL]])
_SIDES = np.array([[-1.0], [1.0], [-1.0], [1.0]])  # left and right


class _Upright(NamedTuple):
    """A person or a post: a strip that faces the camera.

    Attributes:
        depth: from the lens along the street, in m.
        person: whether it is one.
        body: first column that it fills from top to bottom, and the one after the last.
        reach: likewise of the columns in which some part of it is.
        top: row of its upper edge, in px.
        bottom: row where it meets the ground, in px.
    """

    depth: float
    person: bool
    body: tuple[int, int]
    reach: tuple[int, int]
    top: int
    bottom: int


class _Hull(NamedTuple):
    """A parked vehicle as the rays meet it.

    Attributes:
        kind: VEHICLE or TRUCK.
        depths: float (W,), where each ray enters, in m; infinite where it misses.
        tops: float (W,), its upper edge in each column, in px.
        bottoms: float (W,), its lower edge, in px; 0 where the ray misses.
        edges: depth and upper edge in each column in which a ray meets it.
        nearest: the least depth, in m.
        farthest: the greatest one, in m.
    """

    kind: SemanticClass
    depths: Array
    tops: Array
    bottoms: Array
    edges: dict[int, tuple[float, int]]
    nearest: float
    farthest: float


@dataclass
class _Cluster:
    """People whose pixels touch: the picture does not tell them apart, so they are one entity.

    Attributes:
        box: the smallest rectangle around what is visible of them.
        body: first column that their bodies fill, hidden or not, and the one after the last.
        reach: likewise of what their arms and legs reach.
    """

    box: Box
    body: tuple[int, int]
    reach: tuple[int, int]

    def merge(self, other: _Cluster) -> None:
        """Take in people who stand farther away."""
        low, high = self.box, other.box
        self.box = Box(
            min(low.top, high.top),
            min(low.left, high.left),
            max(low.bottom, high.bottom),
            max(low.right, high.right),
        )
        self.body = min(self.body[0], other.body[0]), max(self.body[1], other.body[1])
        self.reach = min(self.reach[0], other.reach[0]), max(self.reach[1], other.reach[1])


class Person(NamedTuple):
    """What is visible of somebody, or of people who touch.

    Attributes:
        entity: its mask fills its box.
        columns: the first that it would reach if nothing hid it, and the one after the last.
    """

    entity: Entity
    columns: tuple[int, int]


class Vehicle(NamedTuple):
    """What is visible of a vehicle.

    Attributes:
        entity: its mask fills its box.
        tops: float (W,), the first visible row in each column, in px.
        bottoms: float (W,), the row after the last one; nothing is visible where it isn't greater.
    """

    entity: Entity
    tops: Array
    bottoms: Array

    def rows(self, columns: slice, box: Box) -> float:
        """Return how many of its pixels lie in these columns and in the rows of a box."""
        own = self.entity.box
        if columns.start >= own.right or columns.stop <= own.left:
            return 0.0
        rows = np.minimum(self.bottoms[columns], box.bottom) - np.maximum(
            self.tops[columns], box.top
        )
        return float(np.maximum(rows, 0.0).sum())

    def covers(self, row: int, column: int) -> bool:
        """Tell whether a pixel is its."""
        _, left, _, right = self.entity.box
        return left <= column < right and bool(self.tops[column] <= row < self.bottoms[column])


class Sighting(NamedTuple):
    """Everything that some ray meets.

    Attributes:
        persons: the nearest first.
        vehicles: those that are parked.
        crosswalks: the street's, if a row of pixels shows it.
        standing: each person's ground; None where none is seen.
    """

    persons: Sequence[Person]
    vehicles: Sequence[Vehicle]
    crosswalks: Sequence[Entity]
    standing: Mapping[Entity, SemanticClass | None]


class RayCaster:
    """Casts the dash camera's rays.

    Args:
        world: the street.
        lens: the dash camera.
        grounding: how much must show of something for it to be seen, and the window below feet.

    Attributes:
        columns: float (W,), of the rays, in px.
        pinhole: the camera.
    """

    def __init__(
        self, world: World, lens: DashCameraParameters, grounding: SegmentationGrounding
    ) -> None:
        self._world = world
        self._lens = lens
        self._grounding = grounding
        self.pinhole = Pinhole.of(grounding.camera, (lens.size, lens.size))
        # The renderer samples a pixel at its lower left corner. A trifle more, or one ray would run
        # along the street and never enter a box from the side.
        self.columns = np.arange(lens.size) + 1e-6
        # How far right of the lens each ray is after 1 m, in m.
        self._rays = (self.columns - self.pinhole.middle) / self.pinhole.focal
        self._steepness = 1.0 / -float(self._rays[0])
        # Every entity fills its box, so that all masks are parts of this one.
        self._filled = np.ones((lens.size, lens.size), np.bool_)
        self._filled.flags.writeable = False

    def cast(self, front: float, people: Walkers) -> Sighting:
        """Return what the dash camera could see.

        Args:
            front: x of ego's front bumper, in m.
            people: where they are.
        """
        lens = front - self._lens.setback
        uprights = self._uprights(lens, people)
        hulls = list(self._hulls(lens))
        persons = self._persons(uprights, hulls)
        vehicles = list(self._vehicles(hulls, uprights))
        standing = {p.entity: self._ground(lens, p.entity, vehicles) for p in persons}
        return Sighting(persons, vehicles, list(self._crosswalks(lens)), standing)

    # What the rays meet

    def _uprights(self, lens: float, people: Walkers) -> list[_Upright]:
        """Return the people and posts in view, the nearest first."""
        camera, near, size = self.pinhole, self._lens.near, self._lens.size
        x, y, sides, heights, feet = self._outlines(people)
        depths, right = x - lens, self._world.geometry.ego_lane - y
        # Nobody's body is broader than with the arms, and no post is.
        in_view = (depths > near) & ((np.abs(right) - _ARMS) * self._steepness < depths)
        depths = np.maximum(depths, near)
        columns = np.ceil(camera.middle + (right + sides) * (camera.focal / depths))
        first, last, left, rest = np.minimum(np.maximum(columns, 0.0), size).astype(int).tolist()
        rows = self._rows(heights, np.maximum(depths - feet, near)).astype(int).tolist()
        persons = [True] * len(people) + [False] * len(self._world.posts)
        bodies, reaches = zip(first, last, strict=True), zip(left, rest, strict=True)
        looks = zip(depths.tolist(), persons, bodies, reaches, *rows, strict=True)
        return sorted(map(_Upright._make, compress(looks, in_view.tolist())))

    def _outlines(self, people: Walkers) -> tuple[Array, Array, Array, Array, Array]:
        """Return what stands upright, the people first: posts are people without arms and legs.

        Returns:
            In m: x and y, float (K,); how far to the right of y the body begins and ends and, as
            heading and stride make it, arms and legs do, (4, K); the heights of head and ground,
            (2, K); how far before x head and feet are, (2, K).
        """
        street, count = self._world.geometry, len(people)
        posts_x, posts_y, radius = self._world.posts.T
        # Filling one array is faster than stacking many, which tells where ten people walk.
        parts = np.zeros((10, count + len(radius)))
        x, y, sides, heights, feet = parts[0], parts[1], parts[2:6], parts[6:8], parts[8:]
        x[count:], y[count:] = posts_x, posts_y
        sides[:, count:], heights[0, count:] = _SIDES * radius, _POST_HEIGHT

        x[:count], y[:count] = people.positions.T
        across, along = np.sin(people.headings), np.abs(np.cos(people.headings))
        sideways = np.abs(across)
        swings = _LEG * np.abs(leg_swings(people.phases, people.speeds))
        strides = swings + _FOOT
        limbs = np.maximum(strides * sideways, _ARMS * along)
        sides[:2, :count] = _FRONT * along + _SIDE * sideways
        sides[2:, :count] = np.where(across > 0.0, limbs, limbs[::-1])
        sides[:, :count] *= _SIDES
        feet[1, :count] = strides[0] * along + _HEEL * sideways
        heights[:, :count] = np.where(street.on_sidewalk(y[:count]), street.kerb_height, 0.0)
        heights[0, :count] += self._world.heights
        return x, y, sides, heights, feet

    def _hulls(self, lens: float) -> Iterator[_Hull]:
        """Yield the parked vehicles that some ray meets."""
        for vehicle in self._world.parked:
            if _front(vehicle) <= lens:
                continue
            depths, tops, bottoms = self._meet(lens, vehicle)
            (hit,) = bottoms.nonzero()
            if hit.size:
                entered = depths[hit].tolist()
                edges = zip(entered, tops[hit].astype(int).tolist(), strict=True)
                columns = dict(zip(hit.tolist(), edges, strict=True))
                yield _Hull(
                    vehicle.kind, depths, tops, bottoms, columns, min(entered), max(entered)
                )

    def _meet(self, lens: float, vehicle: ParkedVehicle) -> tuple[Array, Array, Array]:
        """Meet the boxes of a vehicle (Kay and Kajiya, "Ray Tracing Complex Scenes", 1986).

        Returns:
            Depths, upper and lower edges, as of `_Hull`.
        """
        size, near = self._lens.size, self._lens.near
        centre = self._world.geometry.ego_lane - vehicle.place[1]
        axle = vehicle.place[0] - 0.31 * vehicle.size.length - lens
        first, last, half, height = np.array(_blocks(vehicle)).T[:, :, None]
        left, right = (centre - half) / self._rays, (centre + half) / self._rays
        enter = np.maximum(np.minimum(left, right), np.maximum(first - lens, near))
        leave = np.minimum(np.maximum(left, right), last - lens)
        missed = enter >= leave
        edge = np.where(height < self.pinhole.height, leave, enter)
        tops = self._rows(height, np.maximum(edge, near))
        enter[missed], tops[missed] = np.inf, size
        depths = enter.min(axis=0)
        # It meets the ground with its wheels.
        bottoms = self._rows(0.0, np.maximum(depths, axle))
        bottoms[missed.all(axis=0)] = 0.0
        return depths, tops.min(axis=0), bottoms

    def _rows(self, heights: Array | float, depths: Array) -> Array:
        """Return the first rows that show what is below these heights at these depths, in m."""
        camera = self.pinhole
        edges = camera.horizon + camera.focal * (camera.height - heights) / depths
        rows: Array = np.minimum(np.maximum(np.ceil(edges) - 1.0, 0.0), self._lens.size)
        return rows

    def _row(self, height: float, depth: float) -> int:
        """Do what `_rows` does, for one height and depth."""
        camera = self.pinhole
        edge = camera.horizon + camera.focal * (camera.height - height) / depth
        return min(max(math.ceil(edge) - 1, 0), self._lens.size)

    # What is visible of it

    def _persons(self, uprights: Sequence[_Upright], hulls: Sequence[_Hull]) -> list[Person]:
        """Return those of whom enough is visible; nearer people and posts hide whole columns."""
        hidden = bytearray(self._lens.size)
        clusters: list[_Cluster] = []
        for upright in uprights:
            first, last = upright.body
            if upright.person:
                cluster = self._cluster(upright, hidden, hulls)
                if cluster is not None:
                    _add(cluster, clusters)
            hidden[first:last] = b"\1" * (last - first)
        return [
            Person(self._entity(SemanticClass.PEDESTRIAN, number, cluster.box), cluster.reach)
            for number, cluster in enumerate(clusters, start=1)
        ]

    def _cluster(
        self, upright: _Upright, hidden: bytearray, hulls: Sequence[_Hull]
    ) -> _Cluster | None:
        """Return what is visible of one person, or None where it is too little."""
        top, (first, last) = upright.top, upright.body
        height, columns = upright.bottom - top, range(*upright.reach)
        # Many are too far away or behind others, which shows before their pixels are counted.
        too_small = height * len(columns) < self._grounding.minimum_area
        if too_small or hidden.find(0, *upright.reach) < 0:
            return None
        rows = {column: height for column in columns if not hidden[column]}
        for hull in hulls:
            if hull.nearest < upright.depth:
                _hide(rows, upright, hull)
        body = [rows[column] for column in range(first, last) if column in rows]
        counts = list(rows.values())
        if _area(sum(counts), sum(body)) < self._grounding.minimum_area:
            return None
        lowest = max(counts)
        # An arm or two beside a body whose feet are hidden don't show where it stands.
        shown = _area(lowest * counts.count(lowest), lowest * body.count(lowest))
        if body and shown < self._grounding.minimum_area:
            lowest = max(body)
        box = Box(top, min(rows), top + lowest, max(rows) + 1)
        return _Cluster(box, upright.body, upright.reach)

    def _vehicles(self, hulls: Sequence[_Hull], uprights: Sequence[_Upright]) -> Iterator[Vehicle]:
        """Yield those of which enough is visible; others, people and posts stand before them."""
        numbers: Counter[SemanticClass] = Counter()
        for hull in hulls:
            bottoms = hull.bottoms.copy()
            for other in hulls:
                if other is not hull:
                    nearer = other.depths < hull.depths
                    np.minimum(bottoms, other.tops, out=bottoms, where=nearer)
            for upright in uprights:
                if upright.depth >= hull.farthest:
                    break
                if hull.edges.keys().isdisjoint(range(*upright.body)):
                    continue
                part = slice(*upright.body)
                nearer = upright.depth < hull.depths[part]
                np.minimum(bottoms[part], upright.top, out=bottoms[part], where=nearer)
            rows = np.maximum(bottoms - hull.tops, 0.0)
            if rows.sum() >= self._grounding.minimum_area:
                numbers[hull.kind] += 1
                (columns,) = rows.nonzero()
                top, bottom = hull.tops[columns].min(), bottoms[columns].max()
                box = Box(int(top), int(columns[0]), int(bottom), int(columns[-1]) + 1)
                yield Vehicle(self._entity(hull.kind, numbers[hull.kind], box), hull.tops, bottoms)

    def _crosswalks(self, lens: float) -> Iterator[Entity]:
        """Yield the crosswalk if a row of pixels shows it; somewhere across the road one does."""
        street = self._world.geometry
        first, last = (edge - lens for edge in street.crosswalk)
        if last <= self._lens.near:
            return
        top, bottom = self._row(0.0, last), self._row(0.0, max(first, self._lens.near))
        scale = (bottom - self.pinhole.horizon) / self.pinhole.height
        sides = (street.ego_lane - street.far_kerb, street.ego_lane - street.near_kerb)
        left, right = (self.pinhole.middle + side * scale for side in sides)
        box = Box(top, max(int(left), 0), bottom, min(int(right), self._lens.size))
        if (box.bottom - box.top) * (box.right - box.left) >= self._grounding.minimum_area:
            yield self._entity(SemanticClass.CROSSWALK, 1, box)

    def _ground(
        self, lens: float, person: Entity, vehicles: Sequence[Vehicle]
    ) -> SemanticClass | None:
        """Return the ground that shows first below the middle of a person's visible part.

        `vsr.facts.ground_of` lets each row count twice as much as the next, so the first decides.
        """
        street, camera = self._world.geometry, self.pinhole
        # Where the picture ends at the feet, the ground below is what it shows last.
        first = min(person.bottom, self._lens.size - 1)
        column = int(person.centre[1])
        for row in range(first, min(first + self._grounding.window, self._lens.size)):
            depth = camera.distance(row + 1)
            if math.isinf(depth) or any(v.covers(row, column) for v in vehicles):
                continue
            y = street.ego_lane - float(self._rays[column]) * depth
            if not street.near_kerb <= y <= street.far_kerb:
                return SemanticClass.SIDEWALK
            across = street.crosswalk[0] <= lens + depth < street.crosswalk[1]
            return SemanticClass.CROSSWALK if across else SemanticClass.ROAD
        return None

    def _entity(self, kind: SemanticClass, number: int, box: Box) -> Entity:
        mask = self._filled[: box.bottom - box.top, : box.right - box.left]
        return Entity(f"{_NAMES[kind]}{number}", kind, 1.0, box, mask)


def _hide(rows: dict[int, int], upright: _Upright, hull: _Hull) -> None:
    """Take away those of a person's rows, column by column, that a vehicle before it hides."""
    for column in rows.keys() & hull.edges.keys():
        depth, edge = hull.edges[column]
        if depth >= upright.depth:
            continue
        if edge <= upright.top:
            del rows[column]
        else:
            rows[column] = min(rows[column], edge - upright.top)


def _area(pixels: int, body: int) -> float:
    """Return how much of a person shows in all these columns, in px, given the body's share."""
    return body + _LIMBS * (pixels - body)


def _add(cluster: _Cluster, clusters: list[_Cluster]) -> None:
    """Merge a cluster into the first nearer one that it touches, or else append it."""
    (first, last), box = cluster.body, cluster.box
    for nearer in clusters:
        beside = first >= nearer.reach[1] or last <= nearer.reach[0]
        if not beside and box.top <= nearer.box.bottom and nearer.box.top <= box.bottom:
            nearer.merge(cluster)
            return
    clusters.append(cluster)


def _front(vehicle: ParkedVehicle) -> float:
    return vehicle.place[0] + vehicle.size.length / 2


def _blocks(vehicle: ParkedVehicle) -> list[tuple[float, float, float, float]]:
    """Return the boxes of a vehicle: first and last x, half its width, and its height, in m."""
    x, length, side = vehicle.place[0], vehicle.size.length, vehicle.size.width / 2
    rear, front, top = x - length / 2, x + length / 2, vehicle.size.height
    if vehicle.kind is SemanticClass.TRUCK:
        cab = front - 1.75
        return [
            (rear, cab, side, top),
            (cab, front - 0.35, side - 0.1, 2.1),
            (cab, front, side - 0.06, 1.25),
        ]
    return [
        (rear, front - 0.1, side - 0.015, 0.6 * top),
        (x - 0.42 * length, x + 0.16 * length, side - 0.14, top),
    ]
