"""Streets of several cells behind one environment: each episode is driven in one of them."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from env.street.crossing import OccludedCrossing
from env.street.seeds import TRAINING
from env.world.bullet import NotCopied
from env.world.cells import Cell


class StreetsInTurn(NotCopied, gymnasium.Env[Any, npt.NDArray[np.float32]]):
    """Draws a cell for every episode. A cell's street is built when it is needed first, and kept.

    Every info has ``traffic`` and ``occlusion`` of the cell as well.

    Args:
        cells: traffic and occlusion to draw from, each as likely; `use` changes them.
        seeds: to draw those of the episodes from.
        options: arguments of `OccludedCrossing`, for all of them; they share one observer.

    Attributes:
        street: on which the present episode is driven.
    """

    metadata = OccludedCrossing.metadata

    def __init__(self, cells: tuple[Cell, ...], seeds: range = TRAINING, **options: Any) -> None:
        self._options = options
        self._streets: dict[Cell, OccludedCrossing] = {}
        self._cells = cells
        self._seeds = seeds
        self._cell = cells[0]
        self.street = self._street_of(self._cell)
        self.observation_space = self.street.observation_space
        self.action_space = self.street.action_space

    def use(self, cells: tuple[Cell, ...]) -> None:
        """Draw from these cells from the next episode on."""
        self._cells = cells

    def build(self) -> None:
        """Build the streets of all cells now: where many drive side by side, all at once."""
        for cell in self._cells:
            self._street_of(cell)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode in one of the cells; see `gymnasium.Env.reset`."""
        super().reset(seed=seed)
        self._cell = self._cells[int(self.np_random.integers(len(self._cells)))]
        self.street = self._street_of(self._cell)
        episode_seed = int(self.np_random.integers(self._seeds.start, self._seeds.stop))
        observation, info = self.street.reset(seed=episode_seed, options=options)
        return observation, info | self._cell._asdict()

    def step(
        self, action: npt.NDArray[np.float32]
    ) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Drive on; see `OccludedCrossing.step`."""
        observation, reward, terminated, truncated, info = self.street.step(action)
        return observation, reward, terminated, truncated, info | self._cell._asdict()

    def close(self) -> None:
        """Free all streets."""
        for street in self._streets.values():
            street.close()

    def _street_of(self, cell: Cell) -> OccludedCrossing:
        if cell not in self._streets:
            self._streets[cell] = OccludedCrossing(**cell._asdict(), **self._options)
        return self._streets[cell]
