"""What the street looks like, as arrays: rigid parts with their triangles, textures and poses.

It is the one description that every renderer draws from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from env.world.meshes import Mesh
from env.world.textures import Picture

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Light:
    """Sun and sky of an episode.

    Attributes:
        direction: unit vector towards the sun.
        ambient: share of a colour that shows in the shade.
        diffuse: what full sun adds to it.
        sky: grey values of the sky at the zenith and at the horizon.
    """

    direction: tuple[float, float, float] = (-0.5, 0.3, 0.8)
    ambient: float = 0.6
    diffuse: float = 0.4
    sky: tuple[float, float] = (170.0, 225.0)


class Part(NamedTuple):
    """A rigid mesh and where it is at first.

    Attributes:
        mesh: its triangles.
        body: number of the body that it belongs to.
        place: of the mesh's origin, in m.
        yaw: its turn about the z axis, in rad.
    """

    mesh: Mesh
    body: int
    place: Sequence[float] = (0.0, 0.0, 0.0)
    yaw: float = 0.0


# Numba keeps code by the types of these tuples' fields, not by their names: whoever changes no more
# than the order of fields deletes what it has kept, `rasteriser.*.nb*` in `__pycache__`.


class Triangles(NamedTuple):
    """All parts' triangles, one part after the other, as seen from the part's origin.

    Attributes:
        starts: int64 (P + 1,), each part's first triangle, and the number of all.
        corners: float64 (T, 3, 3), x, y, z of three corners, in m.
        planes: float64 (T, 4), outward unit normal n, and n · corner in m.
        normals: float64 (T, 3), unit vectors by which light falls on them.
        uvs: float64 (T, 3, 2), texture coordinates of the corners.
        plain: bool (T,), whether all of a triangle shows one point of its texture.
        centres: float64 (P, 3), of a sphere around each part, in m.
        radii: float64 (P,), of that sphere, in m.
    """

    starts: npt.NDArray[np.int64]
    corners: Array
    planes: Array
    normals: Array
    uvs: Array
    plain: npt.NDArray[np.bool_]
    centres: Array
    radii: Array


class Textures(NamedTuple):
    """All textures in one array.

    Attributes:
        texels: uint8 (K, 3), RGB, row by row, one texture after the other.
        layout: int64 (M, 3), each texture's first texel, height and width.
    """

    texels: npt.NDArray[np.uint8]
    layout: npt.NDArray[np.int64]


class Poses(NamedTuple):
    """Where the parts are now, and what they wear.

    A part is first turned about the y axis, then about the z axis.

    Attributes:
        places: float64 (P, 3), of the parts' origins, in m.
        yaws: float64 (P,), turns about the z axis, in rad.
        pitches: float64 (P,), turns about the y axis, in rad.
        worn: int64 (P,), number of the texture.
    """

    places: Array
    yaws: Array
    pitches: Array
    worn: npt.NDArray[np.int64]


class Scenery:
    """Parts that can be moved and dressed; meshes and textures stay as they are.

    Args:
        parts: all of them.
        pictures: the textures that they can wear; at first, all wear the first one.

    Attributes:
        parts: as given.
        pictures: as given.
        bodies: int32 (P,), number of each part's body.
        triangles: of the meshes.
        textures: the pictures.
        poses: of the parts, at present.
    """

    def __init__(self, parts: Sequence[Part], pictures: Sequence[Picture]) -> None:
        self.parts = tuple(parts)
        self.pictures = tuple(pictures)
        self.bodies = np.array([part.body for part in parts], np.int32)
        self.triangles = _triangles([part.mesh for part in parts])
        self.textures = _textures(pictures)
        self.poses = Poses(
            np.array([part.place for part in parts], float),
            np.array([part.yaw for part in parts], float),
            np.zeros(len(parts)),
            np.zeros(len(parts), np.int64),
        )

    def put(self, part: int, place: Sequence[float], yaw: float = 0.0) -> None:
        """Move a part.

        Args:
            part: its index.
            place: of its origin, in m.
            yaw: its turn about the z axis, in rad.
        """
        self.poses.places[part], self.poses.yaws[part] = place, yaw

    def wear(self, parts: int | npt.NDArray[np.int64], texture: int) -> None:
        """Dress a part, or several, in a texture, named by its number."""
        self.poses.worn[parts] = texture


def _triangles(meshes: Sequence[Mesh]) -> Triangles:
    counts = [len(mesh.triangles) for mesh in meshes]
    corners, normals, uvs = (
        np.concatenate([getattr(mesh, name)[mesh.triangles] for mesh in meshes])
        for name in ("vertices", "normals", "uvs")
    )
    # A figure is scaled and its normals, by which it is lit, are not: planes are the corners' own.
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    offsets = np.einsum("ti,ti->t", outward, corners[:, 0])
    boxes = [(mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)) for mesh in meshes]
    centres = np.array([0.5 * (low + high) for low, high in boxes])
    return Triangles(
        np.cumsum([0, *counts]),
        corners,
        np.column_stack([outward, offsets]),
        normals[:, 0].copy(),
        uvs,
        (uvs == uvs[:, :1]).all(axis=(1, 2)),
        centres,
        np.array([0.5 * np.linalg.norm(high - low) for low, high in boxes]),
    )


def _textures(pictures: Sequence[Picture]) -> Textures:
    sizes = np.array([picture.shape[:2] for picture in pictures])
    firsts = np.cumsum([0, *sizes.prod(axis=1)[:-1]])
    texels = np.concatenate([picture.reshape(-1, 3) for picture in pictures])
    return Textures(texels, np.column_stack([firsts, sizes]))
