"""The occluded pedestrian crossing as a Gymnasium environment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.error import ResetNeeded

import sfol
from env.actors import TRAFFIC, Behaviour, Corridor, Ego, EgoParameters, Pedestrians, Traffic
from env.camera import DashCamera, DashCameraParameters, third_person
from env.meshes import VehicleSize
from env.metrics import STANDSTILL, stopping_distance
from env.pipeline import Scene, ScenePipeline
from env.world import PERSON_RADIUS, Occlusion, World
from sfol.errors import UsageError, did_you_mean
from sfol.wrappers import log_items
from vsr.segmentation import Frame

Array = npt.NDArray[np.float64]
Observation = npt.NDArray[np.uint8]

PHYSICS_HZ = 100


@dataclass(frozen=True, eq=False)
class _Stretch:
    """What happened between two actions, at each instant of the physics.

    Attributes:
        egos: ego's states, S of them.
        positions: float (S, N, 2), where the people were, in m.
        collided: whether it ended with a contact.
    """

    egos: list[Ego]
    positions: Array
    collided: bool

    @property
    def fronts(self) -> Array:
        return np.array([ego.position for ego in self.egos])

    @property
    def speeds(self) -> Array:
        return np.array([ego.speed for ego in self.egos])


class OccludedCrossing(gymnasium.Env[Observation, npt.NDArray[np.float32]]):
    """Drive along a street, past a crosswalk that a parked vehicle hides in part, to the goal.

    The action is one number in [-1, 1], throttle above 0 and brake below. The observation is the
    frame of the dash camera, uint8 (224, 224, 1). The reward is the knowledge base's, of the facts
    and the speed before the action.

    ``info`` of every step has ``reward_<term>`` (they sum to the reward), ``weight_<name>``,
    ``confidence_<head>``, ``speed`` in m/s, ``position`` of ego's front in m, ``distance`` d in m
    and ``ttc`` in s (the smallest of the step, infinite when there is none). At an episode's end it
    also has ``is_success``, ``collision``, ``timeout``, ``stopping_distance`` in m (nan when ego
    did not stop for anybody) and ``contact_at_rest``, the instants at which somebody touched ego
    while it stood.

    Args:
        traffic: ``low``, ``medium`` or ``high`` (10, 25 or 50 pedestrians).
        occlusion: ``partial``, a parked car, or ``full``, a parked box truck.
        behaviour: of the pedestrian who crosses before ego: ``briefly_visible`` or ``hidden``;
            drawn for each episode when None.
        rules: a knowledge base, the path of one, or the name of a bundled one. Its grounding
            gives the camera's field of view and height.
        control_hz: actions a second, a divisor of 100.
        max_seconds: after which an episode is cut off.
        render_mode: None or ``rgb_array``, a view of the street from behind ego.

    Raises:
        UsageError: an argument is none of these.
        InvalidKnowledgeBase: the rules have errors.

    Source: paper, section "Occluded Pedestrian Crossing Scenario using CARLA".
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 (as in gymnasium)

    def __init__(  # noqa: PLR0913 (each is an option of `gymnasium.make`)
        self,
        *,
        traffic: str = "medium",
        occlusion: str = "full",
        behaviour: str | None = None,
        rules: sfol.KnowledgeBase | str | Path = "crossing",
        control_hz: int = 10,
        max_seconds: float = 60.0,
        render_mode: str | None = None,
    ) -> None:
        self.traffic: Traffic = _one_of("traffic", traffic, get_args(Traffic))
        self.occlusion: Occlusion = _one_of("occlusion", occlusion, get_args(Occlusion))
        self._behaviours: tuple[Behaviour, ...] = get_args(Behaviour)
        if behaviour is not None:
            self._behaviours = (_one_of("behaviour", behaviour, self._behaviours),)
        if render_mode is not None:
            _one_of("render_mode", render_mode, self.metadata["render_modes"])
        _check_timing(control_hz, max_seconds)
        self.render_mode = render_mode
        self.control_dt = 1.0 / control_hz
        self._substeps = PHYSICS_HZ // control_hz
        self._max_steps = math.ceil(max_seconds * control_hz)
        self.metadata = {**self.metadata, "render_fps": control_hz}

        self.pipeline = ScenePipeline(rules)
        self._ego_parameters = EgoParameters()
        car = self._ego_parameters
        size = VehicleSize(car.length, car.width, car.height)
        self.world = World(TRAFFIC[self.traffic].people, self.occlusion, size)
        lens = self.pipeline.grounding.camera
        self.camera = DashCamera(self.world, DashCameraParameters(fov=lens.fov, height=lens.height))
        self.corridor = Corridor(self.world.geometry.ego_lane, car.width)

        side = self.camera.parameters.size
        self.observation_space = spaces.Box(0, 255, (side, side, 1), np.uint8)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.ego = Ego(car)
        self._ended = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; see `gymnasium.Env.reset`. There are no options."""
        super().reset(seed=seed, options=options)
        rng = self.np_random
        self.behaviour: Behaviour = self._behaviours[int(rng.integers(len(self._behaviours)))]
        self.people = Pedestrians(
            TRAFFIC[self.traffic], self.behaviour, rng, self.world.geometry, self.corridor
        )
        self.world.dress(rng)
        self.ego = Ego(self._ego_parameters)
        self._speeds: list[float] = []
        self._distances: list[float] = []
        self._contacts_at_rest = 0
        self._ended = False
        self._look()
        return self._observation(), {**self._state(), "behaviour": self.behaviour}

    def step(
        self, action: npt.NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive for one control period; see `gymnasium.Env.step`.

        Raises:
            ResetNeeded: the episode has ended or none has begun.
            UsageError: the action is not one finite number.
        """
        if self._ended:
            raise ResetNeeded("call reset() before step(): there is no episode to go on with")
        speed, facts = self.ego.speed, self.scene.facts
        stretch = self._drive(_pedal(action))
        distance = self._distance(stretch)
        outcome = self.pipeline.reward.evaluate(facts, v=speed, v_next=self.ego.speed, d=distance)
        self._record(stretch)
        self._look()

        success = not stretch.collided and self.ego.position >= self.world.geometry.goal
        terminated = success or stretch.collided
        truncated = not terminated and len(self._speeds) >= self._max_steps
        self._ended = terminated or truncated
        info = {
            **log_items(outcome),
            **self._state(),
            "distance": distance,
            "ttc": self._ttc(stretch),
        }
        if self._ended:
            info |= self._ending(success, stretch.collided, truncated)
        return self._observation(), outcome.reward, terminated, truncated, info

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Return a view from behind ego, uint8 (360, 480, 3), in the mode ``rgb_array``."""
        if self.render_mode is None:
            return None
        return third_person(self.world, self.ego.position)

    def close(self) -> None:
        """Free the physics client; a second call does nothing."""
        self.world.close()

    def _drive(self, pedal: float) -> _Stretch:
        dt = 1.0 / PHYSICS_HZ
        self.people.decide(self.ego, self.control_dt)
        egos = [self.ego.after(pedal, dt)]
        while len(egos) < self._substeps:
            egos.append(egos[-1].after(pedal, dt))
        positions = self.people.paths(np.arange(1, self._substeps + 1) / PHYSICS_HZ)
        contact = self._first_contact(egos, positions)
        end = self._substeps if contact is None else contact + 1
        self.ego = egos[end - 1]
        self.people.advance(end * dt)
        return _Stretch(egos[:end], positions[:end], contact is not None)

    def _first_contact(self, egos: list[Ego], positions: Array) -> int | None:
        """Return the first instant at which ego, moving, touches somebody."""
        reach = PERSON_RADIUS + 0.1
        fronts = np.array([ego.position for ego in egos])[:, None]
        x, offset = positions[..., 0], positions[..., 1] - self.corridor.centre
        near = (
            (np.abs(offset) < self.corridor.width / 2 + reach)
            & (x < fronts + reach)
            & (x > fronts - self._ego_parameters.length - reach)
        )
        for instant in np.flatnonzero(near.any(axis=1)).tolist():
            ego, who = egos[instant], np.flatnonzero(near[instant])
            if self.world.touches(ego.position, who.tolist(), positions[instant, who]):
                if ego.speed >= STANDSTILL:
                    return int(instant)
                self._contacts_at_rest += 1
        return None

    def _distance(self, stretch: _Stretch) -> float:
        if stretch.collided:
            return 0.0
        velocities = self.people.velocities
        distances = self.corridor.distances(stretch.fronts, stretch.positions, velocities)
        return float(distances.min())

    def _ttc(self, stretch: _Stretch) -> float:
        if stretch.collided:
            return 0.0
        times = self.corridor.times_to_collision(
            stretch.fronts, stretch.speeds, stretch.positions, self.people.velocities
        )
        return float(times.min())

    def _record(self, stretch: _Stretch) -> None:
        last = self.corridor.distances(
            stretch.fronts[-1:], stretch.positions[-1:], self.people.velocities
        )
        self._speeds.append(self.ego.speed)
        self._distances.append(float(last.min()))

    def _look(self) -> None:
        """Take a frame and perceive it."""
        people = self.people
        self.world.place_people(people.positions, people.headings, people.phases, people.speeds)
        self.frame: Frame = self.camera.capture(self.ego.position)
        self.scene: Scene = self.pipeline.perceive([self.frame])[0]

    def _observation(self) -> Observation:
        return self.frame.gray[..., None]

    def _state(self) -> dict[str, Any]:
        return {"speed": self.ego.speed, "position": self.ego.position}

    def _ending(self, success: bool, collision: bool, timeout: bool) -> dict[str, Any]:
        return {
            "is_success": success,
            "collision": collision,
            "timeout": timeout,
            "stopping_distance": stopping_distance(self._speeds, self._distances, self.control_dt),
            "contact_at_rest": self._contacts_at_rest,
        }


def _one_of(name: str, value: str, allowed: Sequence[Any]) -> Any:
    if value not in allowed:
        raise UsageError(
            f"{name} can't be {value!r}, only one of {', '.join(allowed)}",
            name=str(value),
            suggestion=did_you_mean(str(value), allowed),
        )
    return value


def _check_timing(control_hz: int, max_seconds: float) -> None:
    if control_hz < 1 or PHYSICS_HZ % control_hz:
        raise UsageError(
            f"control_hz can't be {control_hz}",
            name="control_hz",
            suggestion=f"a divisor of {PHYSICS_HZ}, such as 10",
        )
    if not 0.0 < max_seconds < math.inf:
        raise UsageError(
            f"max_seconds can't be {max_seconds}", name="max_seconds", suggestion="above 0, in s"
        )


def _pedal(action: npt.NDArray[np.float32]) -> float:
    numbers = np.asarray(action, float).ravel()
    if numbers.size != 1 or not np.isfinite(numbers[0]):
        raise UsageError(f"an action is one finite number, not {action}", name="action")
    return float(np.clip(numbers[0], -1.0, 1.0))
