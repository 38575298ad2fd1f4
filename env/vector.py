"""Many streets at once: workers render, and one pipeline perceives, rewards and describes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from env.description import Describer
from env.observation import with_speed
from env.pipeline import Scene, ScenePipeline
from sfol.wrappers import log_items
from vsr.segmentation import Frame

Array = npt.NDArray[np.float32]
Frames = Mapping[str, npt.NDArray[Any]]


class DescribedStreets(VecEnvWrapper):
    """Streets whose frames are perceived together, in this process, once a step.

    The networks run in batches here instead of one by one in the workers. The reward of a step is
    that of the facts before it. The last frame of an episode, which comes with the reset that
    follows it, is perceived and described as well.

    Args:
        streets: of `OccludedCrossing`, made with ``observation="frame"`` and ``perception="none"``.
        pipeline: perceives frames and has the reward.
        describer: makes the observations, float32 (D,), of frames and scenes.
        speed: whether observations also have ego's speed, see `env.observation.with_speed`.

    Source: paper, section "Vector Semantic Representation".
    """

    def __init__(
        self,
        streets: VecEnv,
        pipeline: ScenePipeline,
        describer: Describer,
        *,
        speed: bool = False,
    ) -> None:
        space = spaces.Box(-np.inf, np.inf, (describer.dimension + speed,), np.float32)
        super().__init__(streets, observation_space=space)
        self._pipeline = pipeline
        self._describer = describer
        self._with_speed = speed
        self._scenes: list[Scene] = []
        self._speeds: list[float] = []

    def reset(self) -> Array:
        """Start an episode in every street and return the observations, float32 (B, D)."""
        frames = _frames(cast(Frames, self.venv.reset()))
        self._speeds = [info["speed"] for info in self.venv.reset_infos]
        observations, self._scenes = self._describe(frames, self._speeds)
        return observations

    def step_wait(self) -> tuple[Array, Array, npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Return observations, rewards, which episodes ended, and infos, as every `VecEnv`."""
        streams, _, dones, infos = self.venv.step_wait()
        ended = np.flatnonzero(dones).tolist()
        last = [_frame(infos[i]["terminal_observation"]) for i in ended]
        speeds = [
            (self.venv.reset_infos[i] if done else info)["speed"]
            for i, (done, info) in enumerate(zip(dones, infos, strict=True))
        ]
        described, scenes = self._describe(
            [*_frames(cast(Frames, streams)), *last], [*speeds, *(infos[i]["speed"] for i in ended)]
        )
        rewards = np.array([self._reward(i, info) for i, info in enumerate(infos)], np.float32)
        for i, observation in zip(ended, described[len(infos) :], strict=True):
            infos[i]["terminal_observation"] = observation
        self._scenes, self._speeds = scenes[: len(infos)], speeds
        return described[: len(infos)], rewards, dones, list(infos)

    def _describe(
        self, frames: Sequence[Frame], speeds: Sequence[float]
    ) -> tuple[Array, list[Scene]]:
        scenes = self._pipeline.perceive(frames)
        vectors = self._describer(frames, scenes)
        return with_speed(vectors, speeds) if self._with_speed else vectors, scenes

    def _reward(self, street: int, info: dict[str, Any]) -> float:
        """Return the reward of a street's step, and add what it is made of to the info."""
        outcome = self._pipeline.reward.evaluate(
            self._scenes[street].facts,
            v=self._speeds[street],
            v_next=info["speed"],
            d=info["distance"],
        )
        info |= log_items(outcome)
        return float(outcome.reward)


def _frames(streams: Frames) -> list[Frame]:
    columns = zip(streams["gray"], streams["classes"], streams["instances"], strict=True)
    return [Frame(gray[..., 0], classes, instances) for gray, classes, instances in columns]


def _frame(stream: Frames) -> Frame:
    return Frame(stream["gray"][..., 0], stream["classes"], stream["instances"])
