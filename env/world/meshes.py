"""Low-poly meshes of the street: cars, box trucks, people, houses, trees, all made by code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Point = Sequence[float]


class Swatch(IntEnum):
    """A field of a palette texture: what a face is made of.

    A mesh names swatches, not colours, so that one mesh can wear any palette.
    """

    PAINT = 0
    TRIM = 1
    GLASS = 2
    RUBBER = 3
    METAL = 4
    TAIL_LIGHT = 5
    HEAD_LIGHT = 6
    PLATE = 7
    SKIN = 8
    HAIR = 9
    SHIRT = 10
    TROUSERS = 11
    SHOES = 12
    BAG = 13
    BARK = 14
    LEAVES = 15


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with flat shading.

    Attributes:
        vertices: float (V, 3), in m.
        normals: float (V, 3), unit length.
        uvs: float (V, 2), texture coordinates; 1 is one repetition of the texture.
        triangles: int (T, 3), counter-clockwise seen from outside.
    """

    vertices: Array
    normals: Array
    uvs: Array
    triangles: npt.NDArray[np.int64]

    def moved(self, offset: Point) -> Mesh:
        """Return the mesh shifted by `offset`, in m."""
        return replace(self, vertices=self.vertices + np.asarray(offset))

    def shape(self) -> dict[str, Any]:
        """Return the arguments of pybullet's ``createVisualShape`` for ``GEOM_MESH``."""
        arrays = (self.vertices, self.normals, self.uvs, self.triangles)
        return _shape(*(array.tobytes() for array in arrays))


@cache
def _shape(vertices: bytes, normals: bytes, uvs: bytes, triangles: bytes) -> dict[str, Any]:
    """Return the lists of a mesh; equal meshes share theirs, for pybullet never lets go of them."""
    return {
        "vertices": np.frombuffer(vertices).reshape(-1, 3).tolist(),
        "normals": np.frombuffer(normals).reshape(-1, 3).tolist(),
        "uvs": np.frombuffer(uvs).reshape(-1, 2).tolist(),
        "indices": np.frombuffer(triangles, np.int64).tolist(),
    }


def merge(*meshes: Mesh) -> Mesh:
    """Return one mesh of all."""
    sizes = [len(mesh.vertices) for mesh in meshes]
    offsets = np.cumsum([0, *sizes[:-1]])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.uvs for mesh in meshes]),
        np.concatenate([m.triangles + o for m, o in zip(meshes, offsets, strict=True)]),
    )


def polygon(corners: Sequence[Point] | Array, uvs: Swatch | Sequence[Point]) -> Mesh:
    """Return a flat convex polygon.

    Args:
        corners: in m, counter-clockwise seen from the side that shows.
        uvs: the swatch that it wears, or texture coordinates for each corner.
    """
    points = np.asarray(corners, float)
    # Newell's sum, which bears a corner that falls together with the next.
    normal = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    normal /= np.linalg.norm(normal)
    field = _swatch_uv(uvs) if isinstance(uvs, Swatch) else uvs
    fan = np.arange(1, len(points) - 1)
    return Mesh(
        points,
        np.tile(normal, (len(points), 1)),
        np.broadcast_to(np.asarray(field, float), (len(points), 2)).copy(),
        np.stack([np.zeros_like(fan), fan, fan + 1], axis=1),
    )


def loft(lower: Sequence[Point], upper: Sequence[Point], side: Swatch, top: Swatch) -> Mesh:
    """Return a closed body between two outlines with the same number of corners, without floor.

    Args:
        lower: corners of the lower outline in m, counter-clockwise seen from above.
        upper: those of the upper outline.
        side: swatch of the walls.
        top: swatch of the upper face.
    """
    count = len(lower)
    walls = [
        polygon([lower[i], lower[(i + 1) % count], upper[(i + 1) % count], upper[i]], side)
        for i in range(count)
    ]
    return merge(*walls, polygon(upper, top))


def block(low: Point, high: Point, swatch: Swatch, taper: Point = (0.0, 0.0)) -> Mesh:
    """Return a box between two corners, its top drawn in by `taper` (x, y) on each side, in m."""
    (x0, y0, z0), (x1, y1, z1), (tx, ty) = low, high, taper
    return loft(
        [(x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z0)],
        [
            (x0 + tx, y0 + ty, z1),
            (x1 - tx, y0 + ty, z1),
            (x1 - tx, y1 - ty, z1),
            (x0 + tx, y1 - ty, z1),
        ],
        swatch,
        swatch,
    )


def tube(rings: Sequence[tuple[float, float, float]], swatch: Swatch, sides: int = 6) -> Mesh:
    """Return a body of rotation about the z axis, flattened along x.

    Args:
        rings: for each ring from the lowest: height z, radius along y, radius along x, in m.
        swatch: what it wears.
        sides: corners of a ring.
    """
    angles = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    outlines = [
        np.stack([rx * np.cos(angles), ry * np.sin(angles), np.full(sides, z)], axis=1)
        for z, ry, rx in rings
    ]
    walls = [
        polygon([low[i], low[(i + 1) % sides], high[(i + 1) % sides], high[i]], swatch)
        for low, high in pairwise(outlines)
        for i in range(sides)
    ]
    return merge(*walls, polygon(outlines[-1], swatch))


def wheel(centre: Point, radius: float, width: float, side: int) -> Mesh:
    """Return a wheel with its hub on one side of a vehicle; `side` is +1 for left, -1 for right."""
    angles = 2 * np.pi * np.arange(8) / 8
    circle = np.stack([np.cos(angles), np.zeros(8), np.sin(angles)], axis=1)
    across = np.array([0.0, side * width / 2, 0.0])
    outer = centre + radius * circle + across
    inner = centre + radius * circle - across
    # The hub stands out a little, or it would flicker with the tyre.
    hub = centre + 0.55 * radius * circle + 1.1 * across
    facing = slice(None, None, -side)
    tread = [
        polygon(
            [inner[i], inner[(i + 1) % 8], outer[(i + 1) % 8], outer[i]][::-side], Swatch.RUBBER
        )
        for i in range(8)
    ]
    return merge(
        *tread,
        polygon(outer[facing], Swatch.RUBBER),
        polygon(hub[facing], Swatch.METAL),
    )


@dataclass(frozen=True)
class VehicleSize:
    """Outer measures of a vehicle: length, width, height in m."""

    length: float
    width: float
    height: float


def car(size: VehicleSize, boot: float) -> Mesh:
    """Return a passenger car that faces +x, centred, its wheels on z = 0.

    Args:
        size: outer measures.
        boot: length of the boot behind the cabin as a share of the car; near 0 for a hatchback.
    """
    half, side = size.length / 2, size.width / 2
    belt, sill = 0.60 * size.height, 0.17 * size.height
    rear, front = -half + boot * size.length, half - 0.26 * size.length
    body = loft(
        _outline(-half, half, side, sill, 0.06),
        _outline(-half + 0.05, half - 0.12, side - 0.03, belt, 0.14),
        Swatch.PAINT,
        Swatch.PAINT,
    )
    roof = size.height
    slant = 0.16 * size.length
    foot = _rectangle(rear, front, side - 0.06, belt)
    head = _rectangle(rear + 0.6 * slant, front - slant, side - 0.22, roof - 0.06)
    cabin = loft(foot, head, Swatch.GLASS, Swatch.PAINT)
    lid = block(
        (rear + 0.6 * slant - 0.04, -side + 0.19, roof - 0.08),
        (front - slant + 0.04, side - 0.19, roof),
        Swatch.PAINT,
        (0.08, 0.08),
    )
    pillars = [_pillar(foot[i], head[i]) for i in range(4)]
    middle = 0.5 * (rear + front) - 0.1
    doors = [
        _pillar((middle, s * (side - 0.06), belt), (middle, s * (side - 0.22), roof - 0.06))
        for s in (-1, 1)
    ]
    bumpers = [
        block((x - 0.08, -side + 0.05, sill), (x + 0.08, side - 0.05, sill + 0.22), Swatch.TRIM)
        for x in (-half + 0.02, half - 0.02)
    ]
    return merge(
        body,
        cabin,
        lid,
        *pillars,
        *doors,
        *bumpers,
        *_lights(half, side, belt - 0.2, 0.16),
        *_wheels(size, 0.21 * size.height),
    )


def box_truck(size: VehicleSize) -> Mesh:
    """Return a van with a box body that faces +x, centred, its wheels on z = 0."""
    half, side = size.length / 2, size.width / 2
    floor, cab = 0.55, half - 1.75
    roof, back = size.height, -half - 0.03
    load = block((-half, -side, floor), (cab, side, roof), Swatch.PAINT)
    frame = [
        block((back, -side - 0.05, floor), (back + 0.08, -side + 0.05, roof), Swatch.METAL),
        block((back, side - 0.05, floor), (back + 0.08, side + 0.05, roof), Swatch.METAL),
        block((back, -side, roof - 0.12), (back + 0.08, side, roof + 0.02), Swatch.METAL),
        block((back, -side, floor - 0.03), (cab, side + 0.02, floor + 0.12), Swatch.METAL),
    ]
    doors = [
        block((back, y - 0.03, low), (back + 0.05, y + 0.03, high), Swatch.RUBBER)
        for y, low, high in ((0.0, floor, roof - 0.1), (-0.22, 1.0, 1.9), (0.22, 1.0, 1.9))
    ]
    stripe = block((-half + 0.4, -side - 0.01, 1.25), (cab - 0.3, side + 0.01, 1.65), Swatch.BAG)
    nose = loft(
        _rectangle(cab, half, side - 0.06, 0.4),
        _rectangle(cab, half - 0.05, side - 0.06, 1.25),
        Swatch.TRIM,
        Swatch.TRIM,
    )
    cabin = loft(
        _rectangle(cab, half - 0.05, side - 0.06, 1.25),
        _rectangle(cab, half - 0.7, side - 0.16, 2.1),
        Swatch.GLASS,
        Swatch.TRIM,
    )
    bumper = block((-half - 0.1, -side + 0.05, 0.35), (-half, side - 0.05, 0.52), Swatch.RUBBER)
    return merge(
        load,
        *frame,
        *doors,
        stripe,
        nose,
        cabin,
        bumper,
        *_lights(half, side, floor + 0.14, 0.2),
        *_wheels(size, 0.38),
    )


# Heights of a person's joints and their distance from the middle, in m, for a height of 1.75 m.
HIP_HEIGHT, HIP_OFFSET = 0.90, 0.095
SHOULDER_HEIGHT, SHOULDER_OFFSET = 1.42, 0.245


@dataclass(frozen=True)
class Figure:
    """Build of a person.

    Attributes:
        height: from the ground, in m.
        breadth: of the body relative to an average one, without unit.
        skirt: wears a skirt.
        backpack: carries a backpack.
        long_hair: hair down to the shoulders.
    """

    height: float = 1.75
    breadth: float = 1.0
    skirt: bool = False
    backpack: bool = False
    long_hair: bool = False


def trunk(figure: Figure) -> Mesh:
    """Return head and torso of a person who faces +x and stands on z = 0."""
    parts = [
        tube([(0.86, 0.16, 0.11), (1.06, 0.145, 0.10)], Swatch.TROUSERS),
        tube([(1.04, 0.155, 0.11), (1.32, 0.21, 0.125), (1.46, 0.17, 0.09)], Swatch.SHIRT),
        tube([(1.44, 0.055, 0.055), (1.54, 0.055, 0.055)], Swatch.SKIN, 4),
        tube([(1.51, 0.05, 0.06), (1.58, 0.085, 0.1), (1.68, 0.085, 0.1)], Swatch.SKIN),
        tube([(1.655, 0.095, 0.11), (1.72, 0.085, 0.1), (1.76, 0.04, 0.05)], Swatch.HAIR),
        block((-0.115, -0.08, 1.42 if figure.long_hair else 1.57), (-0.03, 0.08, 1.7), Swatch.HAIR),
    ]
    if figure.skirt:
        parts.append(tube([(0.5, 0.27, 0.24), (1.06, 0.15, 0.11)], Swatch.TROUSERS))
    if figure.backpack:
        parts.append(block((-0.31, -0.16, 1.0), (-0.1, 0.16, 1.42), Swatch.BAG, (0.03, 0.03)))
    return _fitted(merge(*parts), figure)


def leg(figure: Figure) -> Mesh:
    """Return a leg, its hip in the origin."""
    calf = Swatch.SKIN if figure.skirt else Swatch.TROUSERS
    return _fitted(
        merge(
            tube([(-0.46, 0.06, 0.065), (0.02, 0.09, 0.105)], Swatch.TROUSERS, 4),
            tube([(-0.84, 0.045, 0.05), (-0.44, 0.06, 0.065)], calf, 4),
            block((-0.07, -0.05, -0.9), (0.18, 0.05, -0.81), Swatch.SHOES, (0.03, 0.01)),
        ),
        figure,
    )


def arm(figure: Figure) -> Mesh:
    """Return an arm with a bent elbow, its shoulder in the origin."""
    forearm = tube([(-0.22, 0.035, 0.035), (0.0, 0.045, 0.045)], Swatch.SHIRT, 4)
    hand = tube([(-0.33, 0.035, 0.045), (-0.22, 0.04, 0.045)], Swatch.SKIN, 4)
    lower = _pitched(merge(forearm, hand), -0.45).moved((0.0, 0.0, -0.28))
    upper = tube([(-0.30, 0.045, 0.05), (0.03, 0.065, 0.065)], Swatch.SHIRT, 4)
    return _fitted(merge(upper, lower), figure)


def limb_joints(figure: Figure) -> list[Point]:
    """Return where left leg, right leg, left arm and right arm are joined to the trunk, in m."""
    scale, broad = figure.height / 1.75, figure.breadth
    hip, shoulder = HIP_HEIGHT * scale, SHOULDER_HEIGHT * scale
    return [
        (0.0, HIP_OFFSET * broad, hip),
        (0.0, -HIP_OFFSET * broad, hip),
        (0.0, SHOULDER_OFFSET * broad, shoulder),
        (0.0, -SHOULDER_OFFSET * broad, shoulder),
    ]


def tree(height: float) -> Mesh:
    """Return a broad-leaved tree in a pit, its trunk on z = 0."""
    crown = height - 2.1
    spread = [(0.0, 0.35), (0.14, 1.05), (0.42, 1.4), (0.72, 1.1), (0.92, 0.6), (1.0, 0.15)]
    return merge(
        tube([(0.0, 0.17, 0.17), (2.5, 0.11, 0.11)], Swatch.BARK, 5),
        tube([(2.1 + share * crown, r, r) for share, r in spread], Swatch.LEAVES, 8),
    )


def lamp() -> Mesh:
    """Return a street lamp, its arm towards +y."""
    return merge(
        tube([(0.0, 0.09, 0.09), (5.6, 0.05, 0.05)], Swatch.METAL, 5),
        block((-0.04, 0.0, 5.5), (0.04, 1.1, 5.6), Swatch.METAL),
        block((-0.12, 0.8, 5.4), (0.12, 1.4, 5.52), Swatch.PLATE),
    )


def sign_post() -> Mesh:
    """Return the pole of a traffic sign."""
    return tube([(0.0, 0.04, 0.04), (2.9, 0.04, 0.04)], Swatch.METAL, 4)


def panel(low: Point, high: Point, part: Point = (0.0, 0.0, 1.0, 1.0)) -> Mesh:
    """Return an upright rectangle, textured, that shows to whoever sees `low` on the left.

    Args:
        low: its lower left corner, in m.
        high: its upper right corner, in m.
        part: left, top, right, bottom of what it shows of the texture.
    """
    (x0, y0, z0), (x1, y1, z1), (left, top, right, bottom) = low, high, part
    corners = [(x0, y0, z0), (x1, y1, z0), (x1, y1, z1), (x0, y0, z1)]
    return polygon(corners, [(left, bottom), (right, bottom), (right, top), (left, top)])


def slab(low: Point, high: Point, height: float, tile: Point) -> Mesh:
    """Return a level rectangle, textured, at `height`.

    Args:
        low: x and y of one corner, in m.
        high: x and y of the opposite corner, in m.
        height: z, in m.
        tile: length along x and y that one repetition of the texture covers, in m.
    """
    (x0, y0), (x1, y1) = low, high
    u, v = (x1 - x0) / tile[0], (y1 - y0) / tile[1]
    corners = [(x0, y0, height), (x1, y0, height), (x1, y1, height), (x0, y1, height)]
    return polygon(corners, [(0.0, 0.0), (u, 0.0), (u, v), (0.0, v)])


def _swatch_uv(swatch: Swatch) -> tuple[float, float]:
    return (swatch + 0.5) / len(Swatch), 0.5


def _rectangle(x0: float, x1: float, side: float, z: float) -> list[Point]:
    return [(x0, -side, z), (x1, -side, z), (x1, side, z), (x0, side, z)]


def _outline(x0: float, x1: float, side: float, z: float, corner: float) -> list[Point]:
    inner = side - corner
    return [
        (x0 + corner, -side, z),
        (x1 - corner, -side, z),
        (x1, -inner, z),
        (x1, inner, z),
        (x1 - corner, side, z),
        (x0 + corner, side, z),
        (x0, inner, z),
        (x0, -inner, z),
    ]


def _pillar(foot: Point, head: Point) -> Mesh:
    width = 0.045
    around = [(-width, -width), (width, -width), (width, width), (-width, width)]
    lower, upper = (
        [(end[0] + dx, end[1] + dy, end[2]) for dx, dy in around] for end in (foot, head)
    )
    return loft(lower, upper, Swatch.PAINT, Swatch.PAINT)


def _lights(half: float, side: float, z: float, height: float) -> list[Mesh]:
    lamps = []
    for s in (-1, 1):
        inner, outer = sorted((s * (side - 0.42), s * (side - 0.06)))
        lamps.append(
            block((-half - 0.03, inner, z), (-half + 0.2, outer, z + height), Swatch.TAIL_LIGHT)
        )
        lamps.append(
            block((half - 0.25, inner, z), (half + 0.02, outer, z + height), Swatch.HEAD_LIGHT)
        )
    lamps.append(block((-half - 0.08, -0.27, z - 0.14), (-half, 0.27, z - 0.01), Swatch.PLATE))
    return lamps


def _wheels(size: VehicleSize, radius: float) -> list[Mesh]:
    axle, track = 0.31 * size.length, size.width / 2 - 0.09
    return [
        wheel((x, side * track, radius), radius, 0.22, side)
        for x in (-axle, axle)
        for side in (-1, 1)
    ]


def _fitted(mesh: Mesh, figure: Figure) -> Mesh:
    scale = figure.height / 1.75
    return replace(mesh, vertices=mesh.vertices * [figure.breadth, figure.breadth, scale])


def _pitched(mesh: Mesh, angle: float) -> Mesh:
    sine, cosine = np.sin(angle), np.cos(angle)
    turn = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    return replace(mesh, vertices=mesh.vertices @ turn.T, normals=mesh.normals @ turn.T)
