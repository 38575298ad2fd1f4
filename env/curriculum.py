"""Streets of several cells behind one environment: each episode is driven in one of them."""

from __future__ import annotations

from typing import Any, NamedTuple

import gymnasium
import numpy as np
import numpy.typing as npt

from env.cells import Cell
from env.crossing import OccludedCrossing

EPISODE_SEEDS = (2**30, 2**31)  # far from the small ones of the final test


class _Episode(NamedTuple):
    """What an episode can be driven again by."""

    cell: Cell
    seed: int


class StreetsInTurn(gymnasium.Env[Any, npt.NDArray[np.float32]]):
    """Draws a cell for every episode. A cell's street is built when it is drawn first, and kept.

    Every info has ``traffic`` and ``occlusion`` of the cell as well.

    Args:
        cells: traffic and occlusion to draw from, each as likely; `use` changes them.
        retries: share of episodes that are one again in which ego collided, as long as there is
            one; drawn evenly among them, and another ending strikes it off. Collisions are rare
            where a policy drives well, and so it still learns of them. Timeouts are not driven
            again: they take many steps, and more and more of them where ego can't do otherwise.
        options: arguments of `OccludedCrossing`, for all of them; they share one observer.

    Attributes:
        street: on which the present episode is driven.

    Source: retries after the prioritized replay of levels (Jiang et al., "Prioritized Level
    Replay", 2021), with a collision for its estimate of what there is to learn.
    """

    metadata = OccludedCrossing.metadata

    def __init__(self, cells: tuple[Cell, ...], *, retries: float = 0.0, **options: Any) -> None:
        self._options = options
        self._retries = retries
        self._collided: list[_Episode] = []
        self._streets: dict[Cell, OccludedCrossing] = {}
        self._cells = cells
        self._episode = _Episode(cells[0], seed=0)
        self.street = self._street_of(cells[0])
        self.observation_space = self.street.observation_space
        self.action_space = self.street.action_space

    def use(self, cells: tuple[Cell, ...]) -> None:
        """Draw from these cells from the next episode on."""
        self._cells = cells

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode in one of the cells; see `gymnasium.Env.reset`."""
        super().reset(seed=seed)
        self._episode = self._drawn()
        self.street = self._street_of(self._episode.cell)
        observation, info = self.street.reset(seed=self._episode.seed, options=options)
        return observation, info | self._episode.cell._asdict()

    def step(
        self, action: npt.NDArray[np.float32]
    ) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Drive on; see `OccludedCrossing.step`."""
        observation, reward, terminated, truncated, info = self.street.step(action)
        if terminated or truncated:
            self._remember(collision=info["collision"])
        info |= self._episode.cell._asdict()
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        """Free all streets."""
        for street in self._streets.values():
            street.close()

    def _drawn(self) -> _Episode:
        if self._collided and self.np_random.random() < self._retries:
            return self._collided[int(self.np_random.integers(len(self._collided)))]
        cell = self._cells[int(self.np_random.integers(len(self._cells)))]
        return _Episode(cell, int(self.np_random.integers(*EPISODE_SEEDS)))

    def _remember(self, *, collision: bool) -> None:
        """Keep an episode for another try, or strike it off."""
        others = [episode for episode in self._collided if episode != self._episode]
        self._collided = [*others, self._episode] if collision else others

    def _street_of(self, cell: Cell) -> OccludedCrossing:
        if cell not in self._streets:
            self._streets[cell] = OccludedCrossing(**cell._asdict(), **self._options)
        return self._streets[cell]
