"""The occluded pedestrian crossing as a Gymnasium environment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from numbers import Real
from operator import itemgetter
from pathlib import Path
from typing import Any, Literal, get_args

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from numpy.random import Generator

import sfol
from env.perception.pipeline import Scene
from env.street.observation import Observation, ObservationKind, Observer, observer_of
from env.street.perceptions import PERCEPTIONS
from env.world.actors import (
    PHYSICS_HZ,
    TRAFFIC,
    Behaviour,
    Corridor,
    Ego,
    EgoParameters,
    Pedestrians,
    Walkers,
)
from env.world.bullet import NotCopied
from env.world.camera import DashCamera, DashCameraParameters, Renderer, third_person
from env.world.cells import Traffic
from env.world.kinematics import STANDSTILL, stopping_distance
from env.world.meshes import VehicleSize
from env.world.window import Window
from env.world.world import PERSON_RADIUS, Occlusion, StreetGeometry, World
from sfol.errors import UsageError, did_you_mean
from sfol.wrappers import log_items
from vsr.grounding import SegmentationGrounding
from vsr.segmentation import Frame

Array = npt.NDArray[np.float64]
RenderMode = Literal["rgb_array", "human"]
RenderView = Literal["third_person", "dash"]

SPEED_LIMITS = (10.0, 130.0)  # km/h, the least and the greatest


@dataclass(frozen=True, eq=False)
class _Stretch:
    """What happened between two actions, at each instant of the physics.

    Attributes:
        fronts: float (S,), x of ego's front bumper, in m.
        speeds: float (S,), of ego, in m/s.
        positions: float (S, N, 2), where the people were, in m.
        collided: whether it ended with a contact.
    """

    fronts: Array
    speeds: Array
    positions: Array
    collided: bool


class OccludedCrossing(NotCopied, gymnasium.Env[Observation, npt.NDArray[np.float32]]):
    """Drive along a street, past a crosswalk that a parked vehicle hides in part, to the goal.

    The action is one number in [-1, 1], throttle above 0 and brake below; what lies outside is
    clipped. The reward is the knowledge base's, of the facts and the speed before the action. Rules
    over time remember the steps since the last reset.

    ``info`` of every step has ``reward_<term>`` (they sum to the reward), ``weight_<name>``,
    ``confidence_<head>``, ``speed`` in m/s, ``position`` of ego's front in m, ``distance`` d in m
    and ``ttc`` in s (the smallest of the step, infinite when there is none). At an episode's end it
    also has ``is_success``, ``collision``, ``timeout``, ``stopping_distance`` in m (nan when ego
    did not stop for anybody) and ``contact_at_rest``, the instants at which somebody touched ego
    while it stood.

    Args:
        traffic: ``low``, ``medium`` or ``high`` (10, 25 or 50 pedestrians).
        occlusion: ``partial``, a parked car; ``full``, a parked box truck; ``cpnco``, both.
        behaviour: of the pedestrian who crosses before ego: ``briefly_visible`` or ``hidden``;
            drawn for each episode when None.
        perception: where the facts come from: ``simulator``, the renderer's own class map;
            ``truth``, the world's state and rays cast through it, without any picture; ``unet``, a
            trained network's segmentation of the frame; ``none``, for those who perceive elsewhere:
            no facts but the background's, and the reward of these.
        observation: what the policy is given: ``image``, the dash camera's frame, uint8
            (224, 224, 1); ``state``, ``vsr`` and ``frame``, see `env.street.observation`; ``none``,
            for those who observe elsewhere; or an `env.street.observation.Observer`, which streets
            may share.
        renderer: what draws the frames: ``street``, the street's own renderer, or ``tiny``,
            pybullet's TinyRenderer, which takes some ten times as long.
        fusion: of SSI and SF: ``add``, ``multiply``, ``ssi`` or ``sf``; only for ``vsr``.
        rules: a knowledge base, the path of one, or the name of a bundled one. Its grounding
            gives the camera's field of view and height.
        speed_limit: what full throttle approaches, in km/h, from 10 to 130. People step out so that
            ego can stop at 40, but for the one who crosses before ego, who grants time and not
            distance; above, nobody promises that an episode can be survived.
        control_hz: actions a second, a divisor of 100.
        max_seconds: after which an episode is cut off.
        render_mode: None; ``rgb_array``, `render` returns a picture; ``human``, a window shows it.
        render_view: of that picture: ``third_person``, from behind ego, or ``dash``, the frame.

    A street that nobody closes is closed when it is no longer used. It can't be copied or pickled.

    Raises:
        UsageError: an argument is none of these, there are no weights for ``unet``, or no screen
            for ``human``; or rules over time count on steps of another length.
        InvalidKnowledgeBase: the rules have errors.

    Source: paper, section "Occluded Pedestrian Crossing Scenario using CARLA".
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 10}  # noqa: RUF012 (as in gymnasium)

    def __init__(  # noqa: PLR0913 (each is an option of `gymnasium.make`)
        self,
        *,
        traffic: str = "medium",
        occlusion: str = "full",
        behaviour: str | None = None,
        perception: str = "simulator",
        observation: str | Observer = "image",
        renderer: str = "street",
        fusion: str = "add",
        rules: sfol.KnowledgeBase | str | Path = "crossing",
        speed_limit: float = 40.0,
        control_hz: int = 10,
        max_seconds: float = 60.0,
        render_mode: str | None = None,
        render_view: str = "third_person",
    ) -> None:
        self.traffic: Traffic = _one_of("traffic", traffic, get_args(Traffic))
        self.occlusion: Occlusion = _one_of("occlusion", occlusion, get_args(Occlusion))
        self._behaviours: tuple[Behaviour, ...] = get_args(Behaviour)
        if behaviour is not None:
            self._behaviours = (_one_of("behaviour", behaviour, self._behaviours),)
        self.perception: str = _one_of("perception", perception, list(PERCEPTIONS))
        self.renderer: Renderer = _one_of("renderer", renderer, get_args(Renderer))
        if render_mode is not None:
            _one_of("render_mode", render_mode, get_args(RenderMode))
        self.render_mode = render_mode
        self.render_view: RenderView = _one_of("render_view", render_view, get_args(RenderView))
        _check_numbers(speed_limit, control_hz, max_seconds)
        self._window = Window("OccludedCrossing") if render_mode == "human" else None
        control_hz = int(control_hz)  # 10.0 is as good as 10
        self.control_dt = 1.0 / control_hz
        self._substeps = PHYSICS_HZ // control_hz
        self._instants = np.arange(1, self._substeps + 1) / PHYSICS_HZ
        self._max_steps = math.ceil(max_seconds * control_hz)
        self.metadata = {**self.metadata, "render_fps": control_hz}

        kb = rules if isinstance(rules, sfol.KnowledgeBase) else sfol.KnowledgeBase.load(rules)
        _check_step(kb, self.control_dt)
        self._ego_parameters = EgoParameters(top_speed=speed_limit / 3.6)
        car = self._ego_parameters
        size = VehicleSize(car.length, car.width, car.height)
        self.world = World(TRAFFIC[self.traffic].people, self.occlusion, size)
        camera = kb.grounding_of("segmentation", SegmentationGrounding).camera
        self.lens = DashCameraParameters(fov=camera.fov, height=camera.height)
        self.camera = DashCamera(self.world, self.lens, self.renderer)
        self.corridor = Corridor(self.world.geometry.ego_lane, car.width)
        self._perceive = PERCEPTIONS[self.perception](kb, self.world, self.lens)
        self.pipeline = self._perceive.pipeline
        self._episode = self.pipeline.reward.episode() if kb.has_memory else None

        self._observer = self._observer_of(observation, fusion)
        self.observation_space = self._observer.space
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.ego = Ego(car)
        self._frame: Frame | None = None
        self._begun = False
        self._ended = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; see `gymnasium.Env.reset`. There are no options.

        Raises:
            UsageError: the seed is no whole number from 0 on, or the street is closed.
        """
        super().reset(seed=_seed(seed), options=options)
        self._ended = True  # until all of the next episode is there
        rng = self.np_random
        self.behaviour: Behaviour = self._behaviours[int(rng.integers(len(self._behaviours)))]
        self.people = self._populate(rng)
        self.world.dress(rng)
        self.ego = self._start()
        self._speeds: list[float] = []
        self._distances: list[float] = []
        self.gap = self._gap()
        self._contacts_at_rest = 0
        self._begun = True
        self._perceive.reset(self)
        if self._episode is not None:
            self._episode.reset()
        self._look()
        observation = self._observer(self)
        self._ended = False
        return observation, {**self._state(), "behaviour": self.behaviour}

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
        speed, seen = self.ego.speed, self.scene.conclusions
        stretch = self._drive(_pedal(action))
        distances = self.corridor.distances(
            stretch.fronts, stretch.positions, self.people.velocities
        ).tolist()
        distance = 0.0 if stretch.collided else min(distances)
        outcome = self.pipeline.reward.evaluate(seen, v=speed, v_next=self.ego.speed, d=distance)
        self.outcome = outcome
        self._speeds.append(self.ego.speed)
        self.gap = distances[-1]
        self._distances.append(self.gap)
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
        return self._observer(self), outcome.reward, terminated, truncated, info

    @property
    def geometry(self) -> StreetGeometry:
        """Where lanes, crosswalk and goal are."""
        return self.world.geometry

    @property
    def frame(self) -> Frame:
        """What the dash camera shows now; it is taken when somebody asks for it first.

        Raises:
            ResetNeeded: no episode has begun.
        """
        if self._frame is None:
            self._place_people()
            self._frame = self.camera.capture(self.ego.position)
        return self._frame

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Return a picture in the mode ``rgb_array``, None in the others.

        Returns:
            uint8, RGB: (360, 480, 3) from behind ego, or (224, 224, 3) from the dashboard.

        Raises:
            ResetNeeded: no episode has begun.
        """
        return self._picture() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Free the physics client and the window; a second call does nothing."""
        self._ended = True
        self.world.close()
        if self._window is not None:
            self._window.close()

    def _observer_of(self, observation: str | Observer, fusion: str) -> Observer:
        if not isinstance(observation, str):
            return observation
        kind = _one_of("observation", observation, get_args(ObservationKind))
        return observer_of(kind, self.lens.size, fusion)

    def _populate(self, rng: Generator) -> Walkers:
        """Return the people of an episode; a street with other people overrides this."""
        return Pedestrians(
            TRAFFIC[self.traffic], self.behaviour, rng, self.world.geometry, self.corridor
        )

    def _start(self) -> Ego:
        """Return ego as an episode finds it; a street with another start overrides this."""
        return Ego(self._ego_parameters)

    def _gap(self) -> float:
        """Return how far the nearest pedestrian in the way is, as in `Corridor.distances`, in m."""
        fronts, people = np.array([self.ego.position]), self.people
        return self.corridor.distances(fronts, people.positions[None], people.velocities).item()

    def _drive(self, pedal: float) -> _Stretch:
        dt = 1.0 / PHYSICS_HZ
        self.people.decide(self.ego, self.control_dt)
        states = self.ego.course(pedal, dt, self._substeps)
        fronts, speeds = states[:, 0].copy(), states[:, 1].copy()
        positions = self.people.paths(self._instants)
        contact = self._first_contact(fronts, speeds, positions)
        end = self._substeps if contact is None else contact + 1
        self.ego = Ego(self.ego.parameters, *states[end - 1].tolist())
        self.people.advance(end * dt)
        return _Stretch(fronts[:end], speeds[:end], positions[:end], contact is not None)

    def _first_contact(self, fronts: Array, speeds: Array, positions: Array) -> int | None:
        """Return the first instant at which ego, moving, touches somebody."""
        length, reach = self._ego_parameters.length, PERSON_RADIUS + 0.1
        near = self.corridor.alongside(fronts, positions, length, reach).tolist()
        for instant, pairs in groupby(near, itemgetter(0)):
            who = [person for _, person in pairs]
            if self.world.touches(float(fronts[instant]), who, positions[instant, who]):
                if speeds[instant] >= STANDSTILL:
                    return instant
                self._contacts_at_rest += 1
        return None

    def _ttc(self, stretch: _Stretch) -> float:
        if stretch.collided:
            return 0.0
        times = self.corridor.times_to_collision(
            stretch.fronts, stretch.speeds, stretch.positions, self.people.velocities
        )
        return float(min(times.tolist()))

    def _look(self) -> None:
        """Perceive the scene as it is now, and show it where there is a window."""
        self._frame = None
        scene = self._perceive(self)
        if self._episode is not None:
            scene = replace(scene, conclusions=self._episode.conclude(scene.facts))
        self.scene: Scene = scene
        if self._window is not None:
            self._window.show(self._picture())

    def _picture(self) -> npt.NDArray[np.uint8]:
        if self.render_view == "dash":
            return np.repeat(self.frame.gray[..., None], 3, axis=2)
        self._place_people()
        return third_person(self.world, self.ego.position)

    def _place_people(self) -> None:
        if not self._begun:
            raise ResetNeeded("call reset() before render(): there is nobody on the street yet")
        people = self.people
        self.world.place_people(people.positions, people.headings, people.phases, people.speeds)

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


def _check_numbers(speed_limit: float, control_hz: float, max_seconds: float) -> None:
    numbers = {"speed_limit": speed_limit, "control_hz": control_hz, "max_seconds": max_seconds}
    for name, number in numbers.items():
        if isinstance(number, bool) or not isinstance(number, Real):
            raise _refused(name, number, "a number")
    if not SPEED_LIMITS[0] <= speed_limit <= SPEED_LIMITS[1]:
        raise _refused("speed_limit", speed_limit, "from {} to {}, in km/h".format(*SPEED_LIMITS))
    if control_hz < 1 or control_hz % 1 or PHYSICS_HZ % control_hz:
        raise _refused("control_hz", control_hz, f"a divisor of {PHYSICS_HZ}, such as 10")
    if not 0.0 < max_seconds < math.inf:
        raise _refused("max_seconds", max_seconds, "above 0, in s")


def _check_step(kb: sfol.KnowledgeBase, control_dt: float) -> None:
    """Make sure that a step is as long as rules over time say."""
    if kb.has_memory and kb.time and not math.isclose(kb.time.step, control_dt):
        raise UsageError(
            f"a step of the street takes {control_dt:g} s, and one of '{kb.name}' {kb.time.step:g} "
            f"{kb.time.unit}",
            name="control_hz",
            suggestion=f"let an overlay say time: {{step: {control_dt:g}, unit: s}}",
        )


def _seed(seed: object) -> int | None:
    """Return a seed as gymnasium takes it."""
    if seed is None:
        return None
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise _refused("seed", seed, "a whole number from 0 on")
    return int(seed)


def _refused(name: str, value: object, suggestion: str) -> UsageError:
    return UsageError(f"{name} can't be {value!r}", name=name, suggestion=suggestion)


def _pedal(action: npt.NDArray[np.float32]) -> float:
    numbers = np.asarray(action, float).ravel().tolist()
    if len(numbers) != 1 or not math.isfinite(numbers[0]):
        raise UsageError(f"an action is one finite number, not {action}", name="action")
    return min(max(numbers[0], -1.0), 1.0)
