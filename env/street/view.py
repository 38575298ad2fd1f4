"""What a street shows: the face that observers, drivers and the loop they drive in know.

The bundled pybullet street is one; a street in another simulator docks here. It has to say what
these protocols ask for, in SI units, and needs to inherit nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from env.perception.pipeline import Scene, ScenePipeline
from env.world.actors import Corridor, Ego, Walkers
from env.world.camera import DashCameraParameters
from env.world.world import StreetGeometry
from sfol import Outcome
from vsr.segmentation import Frame


class StreetView(Protocol):
    """A street as it is now, for those who look at it and change nothing.

    What an observer or a driver may use of it is a rule of its own, stated in its docstring.
    """

    @property
    def control_dt(self) -> float:
        """Length of a control step, in s."""
        ...

    @property
    def ego(self) -> Ego:
        """The vehicle that is driven."""
        ...

    @property
    def people(self) -> Walkers:
        """Everybody who walks, seen or hidden."""
        ...

    @property
    def geometry(self) -> StreetGeometry:
        """Where lanes, crosswalk and goal are."""
        ...

    @property
    def corridor(self) -> Corridor:
        """The strip of road that ego sweeps."""
        ...

    @property
    def gap(self) -> float:
        """How far the nearest pedestrian is who is in the way or will be, in m; else infinite."""
        ...

    @property
    def lens(self) -> DashCameraParameters:
        """The dash camera's lens and place."""
        ...

    @property
    def frame(self) -> Frame:
        """What the dash camera shows."""
        ...

    @property
    def scene(self) -> Scene:
        """What perception makes of it."""
        ...

    @property
    def pipeline(self) -> ScenePipeline:
        """The knowledge base, its reward and how scenes are read."""
        ...


class Street(StreetView, Protocol):
    """A street that can be driven: what `env.driving.rollout` needs of an environment.

    `reset` and `step` are Gymnasium's. The last ``info`` of an episode has ``is_success``,
    ``collision``, ``timeout``, ``stopping_distance`` and ``contact_at_rest``; that of every step
    has ``speed``, ``position``, ``distance`` and ``ttc``; see
    `env.street.crossing.OccludedCrossing`.
    """

    @property
    def behaviour(self) -> str:
        """How the target pedestrian behaves in this episode."""
        ...

    @property
    def outcome(self) -> Outcome:
        """What the last step's reward was made of."""
        ...

    def reset(self, *, seed: int | None = None) -> tuple[Any, Mapping[str, Any]]:
        """Start an episode."""
        ...

    def step(
        self, action: npt.NDArray[np.float32]
    ) -> tuple[Any, float, bool, bool, Mapping[str, Any]]:
        """Drive for one control period."""
        ...
