"""pybullet's TinyRenderer: pictures of a scenery in colour, from anywhere, some 15 ms each."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pybullet
from PIL import Image

from env.world.bullet import Client
from env.world.scenery import Light, Scenery


@dataclass(frozen=True, eq=False)
class Picture:
    """What the renderer returns.

    Attributes:
        rgb: uint8 (H, W, 3).
        bodies: int32 (H, W), the body at each pixel, -1 for the sky.
    """

    rgb: npt.NDArray[np.uint8]
    bodies: npt.NDArray[np.int32]


class TinyRenderer:
    """Draws a scenery by pybullet, in a client of its own that has a body for each part.

    pybullet keeps the memory of meshes even when their bodies are removed, until the client is
    closed, so bodies are made once and moved.

    Args:
        scenery: what is to be seen.

    Raises:
        UsageError: pybullet does not start.
    """

    def __init__(self, scenery: Scenery) -> None:
        self._scenery = scenery
        self._client = Client()
        self._textures = self._load_textures()
        for part in scenery.parts:
            shape = pybullet.createVisualShape(
                pybullet.GEOM_MESH, **part.mesh.shape(), physicsClientId=self._client.number
            )
            pybullet.createMultiBody(
                baseMass=0.0, baseVisualShapeIndex=shape, physicsClientId=self._client.number
            )
        # Sky has no part: the last entry is what index -1 finds.
        self._bodies = np.append(scenery.bodies, np.int32(-1))
        self._shown = np.full((len(scenery.parts), 6), np.nan)

    def render(
        self,
        light: Light,
        view: Sequence[float],
        projection: Sequence[float],
        size: tuple[int, int],
    ) -> Picture:
        """Draw the scenery as it is now.

        Args:
            light: of the episode.
            view: pybullet's view matrix.
            projection: pybullet's projection matrix.
            size: width and height, in px.
        """
        self._update()
        width, height, rgba, _, parts = pybullet.getCameraImage(
            *size,
            view,
            projection,
            renderer=pybullet.ER_TINY_RENDERER,
            shadow=0,
            lightDirection=light.direction,
            lightColor=(1.0, 1.0, 1.0),
            lightAmbientCoeff=light.ambient,
            lightDiffuseCoeff=light.diffuse,
            lightSpecularCoeff=0.0,
            physicsClientId=self._client.number,
        )
        rgb = np.asarray(rgba, np.uint8).reshape(height, width, 4)[..., :3]
        return Picture(rgb, self._bodies[np.asarray(parts).reshape(height, width)])

    def close(self) -> None:
        """Disconnect from pybullet; a second call does nothing."""
        self._client.close()

    def _load_textures(self) -> list[int]:
        with tempfile.TemporaryDirectory(prefix="street-") as folder:
            return [
                self._load(Path(folder, f"{number}.png"), picture)
                for number, picture in enumerate(self._scenery.pictures)
            ]

    def _load(self, file: Path, picture: npt.NDArray[np.uint8]) -> int:
        # The renderer counts rows from below.
        Image.fromarray(picture[::-1]).save(file)
        return int(pybullet.loadTexture(str(file), physicsClientId=self._client.number))

    def _update(self) -> None:
        """Move and dress the parts that have changed since the last picture."""
        client, poses = self._client.number, self._scenery.poses
        poses_now = np.column_stack([*poses])
        changes = poses_now != self._shown
        for part in np.flatnonzero(changes[:, :5].any(axis=1)).tolist():
            turn = _quaternion(poses.yaws[part], poses.pitches[part])
            pybullet.resetBasePositionAndOrientation(
                part, poses.places[part], turn, physicsClientId=client
            )
        for part in np.flatnonzero(changes[:, 5]).tolist():
            pybullet.changeVisualShape(
                part,
                -1,
                textureUniqueId=self._textures[poses.worn[part]],
                rgbaColor=(1.0, 1.0, 1.0, 1.0),
                physicsClientId=client,
            )
        self._shown = poses_now


def _quaternion(yaw: float, pitch: float) -> tuple[float, float, float, float]:
    """Return a turn about the y axis, then about the z axis, as (x, y, z, w)."""
    sin_z, cos_z = np.sin(0.5 * yaw), np.cos(0.5 * yaw)
    sin_y, cos_y = np.sin(0.5 * pitch), np.cos(0.5 * pitch)
    return -sin_z * sin_y, cos_z * sin_y, sin_z * cos_y, cos_z * cos_y
