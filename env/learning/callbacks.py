"""What happens while PPO learns: curriculum, what is written down and told."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from env.driving.setup import Setup

Progress = Callable[[int, str], None]

_RECENT = 50  # episodes whose successes the progress tells


class BetweenUpdates(BaseCallback):
    """Does something between two updates, when that many steps have passed since the last time.

    Args:
        interval: of steps.
        action: what is done with the model.
        last: how many steps were done the last time, be it before the training was stopped.
    """

    def __init__(self, interval: int, action: Callable[[Any], None], *, last: int) -> None:
        super().__init__()
        self._interval = interval
        self._action = action
        self._last = last

    def _on_rollout_start(self) -> None:
        if self.num_timesteps - self._last >= self._interval:
            self._last = self.num_timesteps
            self._action(self.model)

    def _on_step(self) -> bool:
        return True


class Curriculum(BaseCallback):
    """Changes the cells where the setup says so."""

    def __init__(self, setup: Setup) -> None:
        super().__init__()
        self._setup = setup
        self._cells = setup.stages[0].cells

    def _on_rollout_start(self) -> None:
        cells = self._setup.stage_at(self.num_timesteps).cells
        if cells != self._cells:
            self._cells = cells
            self.training_env.env_method("use", cells)

    def _on_step(self) -> bool:
        return True


class RewardParts(BaseCallback):
    """Writes what rewards were made of: sums of terms and means of weights over each episode."""

    def _on_training_start(self) -> None:
        self._sums: list[dict[str, float]] = [{} for _ in range(self.training_env.num_envs)]
        self._lengths = [0] * self.training_env.num_envs

    def _on_step(self) -> bool:
        for street, (info, done) in enumerate(
            zip(self.locals["infos"], self.locals["dones"], strict=True)
        ):
            sums = self._sums[street]
            for name, value in info.items():
                if name.startswith(("reward_", "weight_", "confidence_")):
                    sums[name] = sums.get(name, 0.0) + float(value)
            self._lengths[street] += 1
            if done:
                self._write(sums, self._lengths[street])
                for ending in ("is_success", "collision", "timeout"):
                    self.logger.record_mean(f"Episode/{ending}", float(info[ending]))
                self._sums[street], self._lengths[street] = {}, 0
        return True

    def _write(self, sums: dict[str, float], length: int) -> None:
        for name, total in sums.items():
            kind, part = name.split("_", 1)
            if kind == "reward":
                self.logger.record_mean(f"Episode_Reward/{part}", total)
            else:
                self.logger.record_mean(f"{kind.capitalize()}/{part}", total / length)


class Episodes(BaseCallback):
    """Passes on how many steps were done when an episode ended, and the last info of it."""

    def __init__(self, record: Callable[[int, dict[str, Any]], None]) -> None:
        super().__init__()
        self._record = record

    def _on_step(self) -> bool:
        for info, done in zip(self.locals["infos"], self.locals["dones"], strict=True):
            if done:
                self._record(self.num_timesteps, info)
        return True


class ProgressReport(BaseCallback):
    """Reports how far the training is, and how many of its last episodes were a success."""

    def __init__(self, setup: Setup, progress: Progress) -> None:
        super().__init__()
        self._setup = setup
        self._report = progress
        self._successes: deque[bool] = deque(maxlen=_RECENT)

    def _on_step(self) -> bool:
        endings = zip(self.locals["infos"], self.locals["dones"], strict=True)
        self._successes.extend(info["is_success"] for info, done in endings if done)
        stage = self._setup.stage_at(self.num_timesteps)
        text = "/".join(stage.traffic)
        if self._successes:
            text += f", {np.mean(self._successes):.0%} of {len(self._successes)} succeed"
        self._report(self.num_timesteps, text)
        return True
