"""What a policy is given of the street: one observer for each kind of observation."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal, Protocol, cast

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from env.street.view import StreetView
from env.world.actors import RUNNING_PACE
from env.world.compiled import kernel
from vsr.hypervectors.methods import Method

if TYPE_CHECKING:
    from env.perception.description import Describer
    from vsr.hypervectors.codebook import Codebook
    from vsr.networks.runtime import RuntimeName

Observation = npt.NDArray[Any] | dict[str, npt.NDArray[Any]]
ObservationKind = Literal["image", "state", "vsr", "frame", "none"]

_NEAREST = 10  # people in the state
_REACH = 60.0  # m ahead of ego at which the state's distances end
_ASIDE = 12.0  # m beside ego at which they end; the street is narrower
# What ego's top speed is beside a VSR vector. One number among 2048, most of them around 3, would
# hardly be learnt from if it were not larger.
_SPEED_SCALE = 20.0

STATE_FIELDS = (
    "speed",
    "force",
    "goal",
    "crosswalk",
    "gap",
    *(f"person{n}_{part}" for n in range(1, _NEAREST + 1) for part in ("x", "y", "vx", "vy")),
)


class Observer(Protocol):
    """Turns the present state of the street into an observation."""

    @property
    def space(self) -> spaces.Space[Any]:
        """What it returns lies in this space."""
        ...

    def __call__(self, street: StreetView) -> Observation:
        """Return what the policy is given now."""
        ...


class ImageObserver:
    """The frame of the dash camera, uint8 (224, 224, 1)."""

    def __init__(self, side: int) -> None:
        self.space = spaces.Box(0, 255, (side, side, 1), np.uint8)

    def __call__(self, street: StreetView) -> Observation:
        """Return the frame; this is where it is rendered if nobody needed it before."""
        return street.frame.gray[..., None]


class StateObserver:
    """The world's own state, seen or hidden, float32 (45,) in [-1, 1]; `STATE_FIELDS` names it.

    ``speed`` is ego's, as a share of the top speed; ``force`` the acceleration of the actuators, as
    a share of the brake's; ``goal`` and ``crosswalk`` how far ahead of the front bumper they are,
    as shares of 100 m and of 60 m; ``gap`` how far the nearest of those who are or will be in the
    way is, the reward's d, as a share of 60 m. Of the ten people nearest to the bumper, those
    beside or before ego, it has x ahead and y to the left of the bumper, as shares of 60 m and
    12 m, and their velocity as a share of 6 km/h. Whoever is farther is at the border; where there
    are no ten, x is 1 and the rest 0.
    """

    def __init__(self) -> None:
        self.space = spaces.Box(-1.0, 1.0, (len(STATE_FIELDS),), np.float32)

    def __call__(self, street: StreetView) -> Observation:
        """Return the state."""
        ego, geometry = street.ego, street.geometry
        own = (
            ego.speed / ego.parameters.top_speed,
            ego.force / ego.parameters.brake,
            (geometry.goal - ego.position) / geometry.length,
            (geometry.crosswalk[0] - ego.position) / _REACH,
            street.gap / _REACH,
        )
        bumper, people = (ego.position, street.corridor.centre), street.people
        return _state(own, bumper, ego.parameters.length, people.positions, people.velocities)


@kernel
def _state(
    own: tuple[float, ...],
    bumper: tuple[float, float],
    length: float,
    positions: npt.NDArray[np.float64],
    velocities: npt.NDArray[np.float64],
) -> npt.NDArray[np.float32]:
    """Return the state that `StateObserver` describes.

    Args:
        own: its first numbers, those of ego.
        bumper: x and y of the middle of ego's front, in m.
        length: of ego, in m; who is farther behind the bumper isn't shown.
        positions: float (N, 2), of the people, in m.
        velocities: float (N, 2), in m/s.

    Returns:
        float32 (45,), in [-1, 1].
    """
    state = np.zeros(len(own) + 4 * _NEAREST, np.float32)
    nearest, distances, count = np.empty(_NEAREST, np.int64), np.empty(_NEAREST), 0
    for person in range(len(positions)):
        ahead = positions[person, 0] - bumper[0]
        distance = math.hypot(ahead, positions[person, 1] - bumper[1])
        # Of two who are equally near, the first counts.
        if ahead < -length or (count == _NEAREST and distance >= distances[count - 1]):
            continue
        count = min(count + 1, _NEAREST)
        place = count - 1
        while place > 0 and distance < distances[place - 1]:
            nearest[place], distances[place] = nearest[place - 1], distances[place - 1]
            place -= 1
        nearest[place], distances[place] = person, distance
    for place in range(len(own)):
        state[place] = min(max(own[place], -1.0), 1.0)
    for place in range(_NEAREST):
        first = len(own) + 4 * place
        state[first] = 1.0
        if place < count:
            person = nearest[place]
            shares = (
                (positions[person, 0] - bumper[0]) / _REACH,
                (positions[person, 1] - bumper[1]) / _ASIDE,
                velocities[person, 0] / RUNNING_PACE,
                velocities[person, 1] / RUNNING_PACE,
            )
            for part in range(4):
                state[first + part] = min(max(shares[part], -1.0), 1.0)
    return state


class VsrObserver:
    """The VSR vector of the scene, float32 (2048,): SSI and SF of what moves, fused and weighted.

    One observer serves all streets that have the same rules and camera.

    Args:
        fusion: of SSI and SF.
        codebook: the symbols; a trained policy needs those that it was trained with.
        speed: whether ego's speed comes after the vector, from 0 to 20 at its top speed.
        unit_rms: whether SSI and SF of each entity, and what they are fused to, are scaled to a
            root mean square of 1; see `vsr.hypervectors.fusion.Fusion`.
        runtime: what runs the encoder; see `env.perception.networks.load_autoencoder`.

    Source: paper, section "Vector Semantic Representation".
    """

    def __init__(
        self,
        fusion: str = "add",
        codebook: Codebook | None = None,
        *,
        speed: bool = False,
        unit_rms: bool = True,
        runtime: RuntimeName = "auto",
    ) -> None:
        # torch takes seconds and 0.5 GB, which workers that only render should not pay.
        from vsr.hypervectors.codebook import DIMENSION  # noqa: PLC0415
        from vsr.hypervectors.fusion import Fusion  # noqa: PLC0415

        dimension = codebook.dimension if codebook else DIMENSION
        self.space = spaces.Box(-np.inf, np.inf, (dimension + speed,), np.float32)
        self._fusion = Fusion(cast(Method, fusion), unit_rms, unit_rms)
        self._codebook = codebook
        self._speed = speed
        self._runtime: RuntimeName = runtime
        self._describer: Describer | None = None

    def __call__(self, street: StreetView) -> Observation:
        """Return the vector; this is where the networks are loaded if nobody needed them before."""
        if self._describer is None:
            self._describer = self._make_describer(street)
        (vector,) = self._describer([street.frame], [street.scene])
        if not self._speed:
            return vector
        share = street.ego.speed / street.ego.parameters.top_speed
        return np.append(vector, np.float32(_SPEED_SCALE * share))

    def _make_describer(self, street: StreetView) -> Describer:
        from env.perception.description import Describer  # noqa: PLC0415
        from env.perception.networks import load_autoencoder  # noqa: PLC0415

        encoder = None
        if self._fusion.uses_features:
            camera = street.pipeline.grounding.camera
            encoder = load_autoencoder(camera=camera, runtime=self._runtime)
        return Describer(street.pipeline, self._fusion, encoder, self._codebook)


class NoObserver:
    """Nothing, float32 (0,), for those who observe elsewhere."""

    def __init__(self) -> None:
        self.space = spaces.Box(-1.0, 1.0, (0,), np.float32)

    def __call__(self, street: StreetView) -> Observation:
        """Return nothing."""
        return np.empty(0, np.float32)


class FrameObserver:
    """The frame with all that the renderer knows of it, for those who perceive elsewhere.

    ``gray``, uint8 (224, 224, 1); ``classes``, uint8 (224, 224); ``instances``, int32 (224, 224);
    see `vsr.segmentation.Frame`.
    """

    def __init__(self, side: int) -> None:
        integers = np.iinfo(np.int32)
        self.space = spaces.Dict(
            {
                "gray": spaces.Box(0, 255, (side, side, 1), np.uint8),
                "classes": spaces.Box(0, 255, (side, side), np.uint8),
                "instances": spaces.Box(integers.min, integers.max, (side, side), np.int32),
            }
        )

    def __call__(self, street: StreetView) -> Observation:
        """Return the frame; this is where it is rendered if nobody needed it before."""
        frame = street.frame
        gray = frame.gray[..., None]
        return {"gray": gray, "classes": frame.classes, "instances": frame.instances}


def observer_of(  # noqa: PLR0913 (what makes an observer of each kind)
    kind: ObservationKind,
    side: int,
    fusion: str = "add",
    codebook: Codebook | None = None,
    *,
    speed: bool = False,
    unit_rms: bool = True,
) -> Observer:
    """Return the observer of a kind.

    Args:
        kind: ``image``, ``state``, ``vsr``, ``frame`` or ``none``.
        side: width and height of the camera's frames, in px.
        fusion: of SSI and SF, for ``vsr``, as are the others; see `VsrObserver`.
        codebook: the symbols.
        speed: whether ego's speed comes after the vector.
        unit_rms: whether entities are scaled.
    """
    observers: dict[ObservationKind, Callable[[], Observer]] = {
        "image": lambda: ImageObserver(side),
        "state": StateObserver,
        "vsr": lambda: VsrObserver(fusion, codebook, speed=speed, unit_rms=unit_rms),
        "frame": lambda: FrameObserver(side),
        "none": NoObserver,
    }
    return observers[kind]()
