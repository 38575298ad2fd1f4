"""An environment in which nothing happens, so that what a wrapper costs can be seen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces


class Still(gymnasium.Env[Any, Any]):
    """An environment that always shows the same.

    Args:
        observation: what it shows: an array of float64, or a mapping of names to such.
    """

    def __init__(self, observation: Any) -> None:
        self._observation = observation
        self.observation_space = _space_of(observation)
        self.action_space = spaces.Discrete(1)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode; see `gymnasium.Env.reset`."""
        super().reset(seed=seed)
        return self._observation, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Do nothing; see `gymnasium.Env.step`."""
        return self._observation, 0.0, False, False, {}


def _space_of(observation: Any) -> spaces.Space[Any]:
    if isinstance(observation, Mapping):
        return spaces.Dict({name: _space_of(part) for name, part in observation.items()})
    return spaces.Box(-np.inf, np.inf, np.shape(observation), np.float64)
