"""The dash camera, and a view from outside for people."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt
import pybullet

from env.world.tiny_renderer import Picture
from env.world.world import World
from vsr.facts import Pinhole
from vsr.grounding import Camera
from vsr.segmentation import Frame

Renderer = Literal["street", "tiny"]
# As cards of frames and of weights name them.
RENDERERS: Mapping[Renderer, str] = {"street": "street rasteriser", "tiny": "pybullet TinyRenderer"}


@dataclass(frozen=True)
class DashCameraParameters:
    """Lens and place of the dash camera: a pinhole that looks straight ahead, without pitch.

    Attributes:
        size: width and height of the picture, in px.
        fov: horizontal field of view, in degrees.
        height: of the lens above the road, in m.
        setback: of the lens behind the front bumper, in m (behind the windscreen).
        near: where the view begins, in m.
        far: where the view ends, in m.
    """

    size: int = 224
    fov: float = 50.0
    height: float = 1.5
    setback: float = 1.5
    near: float = 0.3
    far: float = 320.0

    @cached_property
    def pinhole(self) -> Pinhole:
        """The camera's geometry."""
        return Pinhole.of(Camera(fov=self.fov, height=self.height), (self.size, self.size))


class DashCamera:
    """Takes the grayscale frames that ego drives by.

    Args:
        world: the street.
        parameters: lens and place.
        renderer: ``street``, the street's own, or ``tiny``, pybullet's TinyRenderer, which takes
            some ten times as long.

    Source: paper, section "Occluded Pedestrian Crossing Scenario using CARLA".
    """

    def __init__(
        self,
        world: World,
        parameters: DashCameraParameters | None = None,
        renderer: Renderer = "street",
    ) -> None:
        self.parameters = parameters or DashCameraParameters()
        self.renderer = renderer
        self._world = world

    def capture(self, front: float) -> Frame:
        """Take a frame from ego's dashboard.

        Args:
            front: x of ego's front bumper, in m.
        """
        return self._draw(front) if self.renderer == "street" else self._draw_tiny(front)

    def _draw(self, front: float) -> Frame:
        from env.world.rasteriser import View, draw  # noqa: PLC0415  (numba is slow to import)

        lens, world = self.parameters, self._world
        view = View(*self._eye(front), lens.pinhole.focal, lens.near, lens.far)
        return draw(world.scenery, world.light, view, self._sky(), world.classes)

    def _draw_tiny(self, front: float) -> Frame:
        lens, (x, y, z) = self.parameters, self._eye(front)
        view = pybullet.computeViewMatrix((x, y, z), (x + 1.0, y, z), (0, 0, 1))
        picture = self._world.render(view, self._projection, (lens.size, lens.size))
        gray = np.where(picture.bodies < 0, self._sky(), luma(picture.rgb))
        return Frame(gray, self._world.classes[picture.bodies], picture.bodies)

    def _eye(self, front: float) -> tuple[float, float, float]:
        """Return where the lens is, in m."""
        lens = self.parameters
        return front - lens.setback, self._world.geometry.ego_lane, lens.height

    @cached_property
    def _projection(self) -> tuple[float, ...]:
        lens = self.parameters
        return tuple(pybullet.computeProjectionMatrixFOV(lens.fov, 1.0, lens.near, lens.far))

    def _sky(self) -> npt.NDArray[np.uint8]:
        """Return grey values that brighten towards the horizon, (H, W)."""
        zenith, horizon = self._world.light.sky
        size = self.parameters.size
        column = np.interp(np.arange(size), [0, size // 2], [zenith, horizon])
        return np.repeat(column.astype(np.uint8)[:, None], size, axis=1)


def third_person(
    world: World, front: float, size: tuple[int, int] = (480, 360)
) -> npt.NDArray[np.uint8]:
    """Return a view of ego and the street ahead from behind and above.

    Args:
        world: the street.
        front: x of ego's front bumper, in m.
        size: width and height, in px.

    Returns:
        uint8 (height, width, 3), RGB.
    """
    y = world.geometry.ego_lane
    eye, target = (front - 13.0, y + 1.5, 5.0), (front + 12.0, y, 0.6)
    view = pybullet.computeViewMatrix(eye, target, (0, 0, 1))
    projection = pybullet.computeProjectionMatrixFOV(48.0, size[0] / size[1], 0.3, 320.0)
    world.show_ego(front)
    picture = world.render(view, projection, size)
    world.hide_ego()
    return _with_sky(picture)


def luma(rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return grey values by ITU-R BT.601: 0.299 R + 0.587 G + 0.114 B.

    Args:
        rgb: uint8 (H, W, 3).
    """
    red, green, blue = (rgb[..., channel].astype(np.uint32) for channel in range(3))
    # Whole numbers give the same picture on every machine.
    return ((19595 * red + 38470 * green + 7471 * blue + 32768) >> 16).astype(np.uint8)


def _with_sky(picture: Picture) -> npt.NDArray[np.uint8]:
    rows = np.linspace(0.0, 1.0, len(picture.rgb))[:, None, None]
    sky = (1.0 - rows) * (128, 172, 222) + rows * (236, 242, 248)
    return np.where(picture.bodies[..., None] < 0, sky, picture.rgb).astype(np.uint8)
