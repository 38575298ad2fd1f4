"""The street's own renderer: grey values, classes and bodies in one pass over the triangles.

Triangles are drawn row by row into a depth buffer, each with one level of light and the nearest
texel. Only what faces the camera and may be in view is looked at. The code is compiled by numba
when the first frame is drawn, and kept for later processes.

Source: J. Pineda, "A parallel algorithm for polygon rasterization", SIGGRAPH 1988; P. S. Heckbert,
"Survey of texture mapping", 1986 (perspective-correct texture coordinates).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from env.world.compiled import inlined_part, kernel
from env.world.scenery import Light, Poses, Scenery, Textures, Triangles
from vsr.segmentation import Frame

Array = npt.NDArray[np.float64]

_SLACK = 1e-5  # px by which triangles reach farther, so that no gap shows between two of them


class View(NamedTuple):
    """A pinhole that looks along the street's x axis, without pitch.

    Attributes:
        x: of the lens, in m.
        y: of the lens, in m.
        z: of the lens, in m.
        focal: focal length, in px.
        near: where the view begins, in m.
        far: where the view ends, in m.
    """

    x: float
    y: float
    z: float
    focal: float
    near: float
    far: float


class _Canvas(NamedTuple):
    """What is drawn on, each (H, W): grey values, classes, bodies, and 1/depth in 1/m."""

    gray: npt.NDArray[np.uint8]
    classes: npt.NDArray[np.uint8]
    bodies: npt.NDArray[np.int32]
    nearness: npt.NDArray[np.float32]


class _Parts(NamedTuple):
    """What is drawn: triangles, textures, poses, and the body and the class of each part."""

    triangles: Triangles
    textures: Textures
    poses: Poses
    bodies: npt.NDArray[np.int32]
    kinds: npt.NDArray[np.uint8]


class _Sun(NamedTuple):
    """Light: a unit vector towards the sun as (ahead, right, below), and levels."""

    ahead: float
    right: float
    below: float
    ambient: float
    diffuse: float


class _Paint(NamedTuple):
    """What a triangle shows: body, class, level of light; its texture's place and size."""

    body: int
    kind: int
    level: float
    first: int
    height: int
    width: int


def draw(
    scenery: Scenery,
    light: Light,
    view: View,
    sky: npt.NDArray[np.uint8],
    classes: npt.NDArray[np.uint8],
) -> Frame:
    """Draw a frame.

    Args:
        scenery: what is to be seen.
        light: of the episode.
        view: the camera.
        sky: uint8 (H, W), grey values where nothing is; it is drawn on.
        classes: uint8 (B + 1,), the semantic class of each body and, at last, of the sky.
    """
    canvas = _Canvas(
        sky,
        np.full(sky.shape, classes[-1]),
        np.full(sky.shape, -1, np.int32),
        np.zeros(sky.shape, np.float32),
    )
    x, y, z = np.divide(light.direction, np.linalg.norm(light.direction)).tolist()
    _draw(
        canvas,
        _Parts(
            scenery.triangles,
            scenery.textures,
            scenery.poses,
            scenery.bodies,
            classes[scenery.bodies],
        ),
        _Sun(x, -y, -z, light.ambient, light.diffuse),
        view,
    )
    return Frame(canvas.gray, canvas.classes, canvas.bodies)


@kernel
def _draw(canvas: _Canvas, parts: _Parts, sun: _Sun, view: View) -> None:
    """Draw all parts; of two at the same depth, the one that was built later shows."""
    triangles, pose = parts.triangles, np.empty((3, 4))
    lens, towards_sun = np.empty(3), np.empty(3)
    seen, polygon = np.empty((3, 5)), np.empty((4, 5))
    for part in range(len(parts.bodies) - 1, -1, -1):
        _set_pose(pose, parts.poses, part, view)
        if _is_out_of_view(pose, triangles, part, view, canvas.gray.shape):
            continue
        # Lens and sun are turned into the part's axes, so that no triangle is in vain.
        _turn_back(lens, pose, -pose[0, 3], -pose[1, 3], -pose[2, 3])
        _turn_back(towards_sun, pose, sun.ahead, sun.right, sun.below)
        body, kind = parts.bodies[part], parts.kinds[part]
        first, height, width = parts.textures.layout[parts.poses.worn[part]]
        for triangle in range(triangles.starts[part], triangles.starts[part + 1]):
            if _dot(triangles.planes, triangle, lens) <= triangles.planes[triangle, 3]:
                continue
            shine = max(_dot(triangles.normals, triangle, towards_sun), 0.0)
            level = sun.ambient + sun.diffuse * shine
            paint = _Paint(body, kind, level, first, height, width)
            _see(seen, pose, triangles, triangle)
            count = _clip(polygon, seen, view.near)
            _project(polygon, count, view.focal, canvas.gray.shape)
            for corner in range(2, count):
                if triangles.plain[triangle]:
                    _fill_plain(canvas, polygon, corner, paint, parts.textures.texels)
                else:
                    _fill_textured(canvas, polygon, corner, paint, parts.textures.texels)


@inlined_part
def _set_pose(pose: Array, poses: Poses, part: int, view: View) -> None:
    """Write the map from a part's axes to (ahead, right, below) of the lens, in m."""
    cos_yaw, sin_yaw = math.cos(poses.yaws[part]), math.sin(poses.yaws[part])
    cos_pitch, sin_pitch = math.cos(poses.pitches[part]), math.sin(poses.pitches[part])
    pose[0, 0], pose[0, 1], pose[0, 2] = cos_yaw * cos_pitch, -sin_yaw, cos_yaw * sin_pitch
    pose[1, 0], pose[1, 1], pose[1, 2] = -sin_yaw * cos_pitch, -cos_yaw, -sin_yaw * sin_pitch
    pose[2, 0], pose[2, 1], pose[2, 2] = sin_pitch, 0.0, -cos_pitch
    pose[0, 3] = poses.places[part, 0] - view.x
    pose[1, 3] = view.y - poses.places[part, 1]
    pose[2, 3] = view.z - poses.places[part, 2]


@inlined_part
def _apply(pose: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a part's point as (ahead, right, below) of the lens, in m."""
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3],
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3],
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3],
    )


@inlined_part
def _turn_back(vector: Array, pose: Array, ahead: float, right: float, below: float) -> None:
    """Write a direction along the lens's axes as one along a part's."""
    for axis in range(3):
        vector[axis] = pose[0, axis] * ahead + pose[1, axis] * right + pose[2, axis] * below


@inlined_part
def _dot(vectors: Array, index: int, other: Array) -> float:
    return (
        vectors[index, 0] * other[0] + vectors[index, 1] * other[1] + vectors[index, 2] * other[2]
    )


@inlined_part
def _is_out_of_view(
    pose: Array, triangles: Triangles, part: int, view: View, shape: tuple[int, int]
) -> bool:
    """Tell whether the sphere around a part lies outside of the pyramid that the picture shows."""
    radius, centres = triangles.radii[part], triangles.centres
    ahead, right, below = _apply(pose, centres[part, 0], centres[part, 1], centres[part, 2])
    tall, wide = 0.5 * shape[0], 0.5 * shape[1]
    beside = (abs(right) * view.focal - ahead * wide) / math.hypot(view.focal, wide)
    above = (abs(below) * view.focal - ahead * tall) / math.hypot(view.focal, tall)
    return max(view.near - ahead, ahead - view.far, beside, above) > radius


@inlined_part
def _see(seen: Array, pose: Array, triangles: Triangles, triangle: int) -> None:
    """Write a triangle's corners as (ahead, right, below, u, v)."""
    for corner in range(3):
        x = triangles.corners[triangle, corner, 0]
        y = triangles.corners[triangle, corner, 1]
        z = triangles.corners[triangle, corner, 2]
        seen[corner, 0], seen[corner, 1], seen[corner, 2] = _apply(pose, x, y, z)
        seen[corner, 3] = triangles.uvs[triangle, corner, 0]
        seen[corner, 4] = triangles.uvs[triangle, corner, 1]


@inlined_part
def _clip(polygon: Array, seen: Array, near: float) -> int:
    """Write what of a triangle lies beyond the near plane; return its number of corners.

    Source: I. E. Sutherland and G. W. Hodgman, "Reentrant polygon clipping", 1974.
    """
    count = 0
    for corner in range(3):
        following = (corner + 1) % 3
        here, there = seen[corner, 0] - near, seen[following, 0] - near
        if here > 0.0:
            for axis in range(5):
                polygon[count, axis] = seen[corner, axis]
            count += 1
        if (here > 0.0) != (there > 0.0):
            share = here / (here - there)
            for axis in range(5):
                start, end = seen[corner, axis], seen[following, axis]
                polygon[count, axis] = start + share * (end - start)
            count += 1
    return count


@inlined_part
def _project(polygon: Array, count: int, focal: float, shape: tuple[int, int]) -> None:
    """Turn corners into (column, row, 1/depth, u/depth, v/depth), all linear in the picture.

    A pixel's sample lies at its lower left corner, as that of pybullet's TinyRenderer does.
    """
    for corner in range(count):
        nearness = 1.0 / polygon[corner, 0]
        scale = focal * nearness
        polygon[corner, 0] = 0.5 * shape[1] + scale * polygon[corner, 1]
        polygon[corner, 1] = 0.5 * shape[0] + scale * polygon[corner, 2] - 1.0
        polygon[corner, 2] = nearness
        polygon[corner, 3] *= nearness
        polygon[corner, 4] *= nearness


@inlined_part
def _gray(paint: _Paint, texels: npt.NDArray[np.uint8], u: float, v: float) -> int:
    """Return the grey value of a texture's point in this light, by ITU-R BT.601."""
    column = min(max(int((u - math.trunc(u)) * paint.width), 0), paint.width - 1)
    row = min(max(int((v - math.trunc(v)) * paint.height), 0), paint.height - 1)
    texel = paint.first + row * paint.width + column
    red = min(int(paint.level * texels[texel, 0]), 255)
    green = min(int(paint.level * texels[texel, 1]), 255)
    blue = min(int(paint.level * texels[texel, 2]), 255)
    return (19595 * red + 38470 * green + 7471 * blue + 32768) >> 16


@inlined_part
def _slope(polygon: Array, corner: int, axis: int) -> tuple[float, float, float]:
    """Return a value's change by column and by row, and the value in column 0 of row 0.

    The triangle is that of the polygon's corners 0, `corner` - 1 and `corner`.
    """
    x0, y0, value = polygon[0, 0], polygon[0, 1], polygon[0, axis]
    x1, y1 = polygon[corner - 1, 0] - x0, polygon[corner - 1, 1] - y0
    x2, y2 = polygon[corner, 0] - x0, polygon[corner, 1] - y0
    rise1, rise2 = polygon[corner - 1, axis] - value, polygon[corner, axis] - value
    area = x1 * y2 - x2 * y1
    by_column = (rise1 * y2 - rise2 * y1) / area
    by_row = (x1 * rise2 - x2 * rise1) / area
    return by_column, by_row, value - by_column * x0 - by_row * y0


@inlined_part
def _rows(polygon: Array, corner: int, shape: tuple[int, int]) -> tuple[int, int]:
    """Return the first row that a triangle may cover, and the one after the last."""
    last = corner - 1
    left = min(polygon[0, 0], polygon[last, 0], polygon[corner, 0]) - _SLACK
    right = max(polygon[0, 0], polygon[last, 0], polygon[corner, 0]) + _SLACK
    top = min(polygon[0, 1], polygon[last, 1], polygon[corner, 1]) - _SLACK
    bottom = max(polygon[0, 1], polygon[last, 1], polygon[corner, 1]) + _SLACK
    if math.ceil(left) > min(math.floor(right), shape[1] - 1) or right < 0.0:
        return 0, 0
    return max(math.ceil(top), 0), min(math.floor(bottom), shape[0] - 1) + 1


@inlined_part
def _columns(polygon: Array, corner: int, row: int, width: int) -> tuple[int, int]:
    """Return the first column that a triangle covers in a row, and the one after the last."""
    left, right = 0.0, width - 1.0
    start = 0
    for end in (corner - 1, corner, 0):
        x, y = polygon[start, 0], polygon[start, 1]
        fall = polygon[end, 1] - y
        # Seen from its front, a triangle's corners turn against the clock.
        crossing = x + (polygon[end, 0] - x) * (row - y) / fall
        if fall > 0.0:
            left = max(left, crossing - _SLACK)
        elif fall < 0.0:
            right = min(right, crossing + _SLACK)
        start = end
    return math.ceil(left), math.floor(right) + 1


@inlined_part
def _fill_plain(
    canvas: _Canvas, polygon: Array, corner: int, paint: _Paint, texels: npt.NDArray[np.uint8]
) -> None:
    """Fill a triangle that shows one point of its texture."""
    first, last = _rows(polygon, corner, canvas.gray.shape)
    if first >= last:  # as of most triangles of people far away
        return
    depth = 1.0 / polygon[0, 2]
    gray = _gray(paint, texels, polygon[0, 3] * depth, polygon[0, 4] * depth)
    by_column, by_row, nearness = _slope(polygon, corner, 2)
    for row in range(first, last):
        left, right = _columns(polygon, corner, row, canvas.gray.shape[1])
        for column in range(left, right):
            near = np.float32(nearness + by_row * row + by_column * column)
            if near > canvas.nearness[row, column]:
                canvas.nearness[row, column] = near
                canvas.gray[row, column] = gray
                canvas.classes[row, column] = paint.kind
                canvas.bodies[row, column] = paint.body


@inlined_part
def _fill_textured(
    canvas: _Canvas, polygon: Array, corner: int, paint: _Paint, texels: npt.NDArray[np.uint8]
) -> None:
    """Fill a triangle with the nearest texels."""
    first, last = _rows(polygon, corner, canvas.gray.shape)
    by_column, by_row, nearness = _slope(polygon, corner, 2)
    u_by_column, u_by_row, u = _slope(polygon, corner, 3)
    v_by_column, v_by_row, v = _slope(polygon, corner, 4)
    for row in range(first, last):
        left, right = _columns(polygon, corner, row, canvas.gray.shape[1])
        for column in range(left, right):
            near = nearness + by_row * row + by_column * column
            if np.float32(near) > canvas.nearness[row, column]:
                depth = 1.0 / near
                across = (u + u_by_row * row + u_by_column * column) * depth
                along = (v + v_by_row * row + v_by_column * column) * depth
                canvas.nearness[row, column] = near
                canvas.gray[row, column] = _gray(paint, texels, across, along)
                canvas.classes[row, column] = paint.kind
                canvas.bodies[row, column] = paint.body
