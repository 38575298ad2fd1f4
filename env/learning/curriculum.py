"""The street that a policy learns on: episodes in several cells, and actions that are held."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from env.driving.drivers import Driver
from env.street.crossing import OccludedCrossing
from env.street.observation import Observer
from env.street.seeds import TRAINING
from env.world.bullet import NotCopied
from env.world.cells import Cell


class StreetsInTurn(NotCopied, gymnasium.Env[Any, npt.NDArray[np.float32]]):
    """Draws a cell for every episode. A cell's street is built when it is needed first, and kept.

    A step is a decision: its action is held for some control steps, fewer where the episode ends,
    and it is rewarded by the sum of their rewards. In its info, ``reward_<term>`` is a sum, too,
    ``weight_<name>`` and ``confidence_<head>`` are means, and all else is as at its end; besides
    there are ``control_steps``, and ``traffic`` and ``occlusion`` of the cell.

    Args:
        cells: traffic and occlusion to draw from, each as likely; `use` changes them.
        observer: gives the observations, one at each decision.
        decision_steps: how many control steps an action is held.
        seeds: to draw those of the episodes from.
        teacher: if there is one, the info has what it would do now, ``teacher``, after a reset as
            after a step.
        options: arguments of `OccludedCrossing`, for all streets.

    Attributes:
        street: on which the present episode is driven.
    """

    metadata = OccludedCrossing.metadata

    def __init__(
        self,
        cells: tuple[Cell, ...],
        observer: Observer,
        *,
        decision_steps: int = 1,
        seeds: range = TRAINING,
        teacher: Driver | None = None,
        **options: Any,
    ) -> None:
        self._observer = observer
        self._decision_steps = decision_steps
        self._options = options
        self._streets: dict[Cell, OccludedCrossing] = {}
        self._cells = cells
        self._seeds = seeds
        self._teacher = teacher
        self._cell = cells[0]
        self.street = self._street_of(self._cell)
        self.observation_space = observer.space
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
        _, info = self.street.reset(seed=episode_seed, options=options)
        if self._teacher is not None:
            self._teacher.reset()
        return self._observer(self.street), info | self._said()

    def step(
        self, action: npt.NDArray[np.float32]
    ) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Hold an action; see `OccludedCrossing.step`."""
        rewards: list[float] = []
        infos: list[dict[str, Any]] = []
        terminated = truncated = False
        while len(infos) < self._decision_steps and not (terminated or truncated):
            _, reward, terminated, truncated, info = self.street.step(action)
            rewards.append(reward)
            infos.append(info)
        info = _together(infos) | self._said()
        return self._observer(self.street), sum(rewards), terminated, truncated, info

    def close(self) -> None:
        """Free all streets."""
        for street in self._streets.values():
            street.close()

    def _said(self) -> dict[str, Any]:
        """Return what this environment adds to an info."""
        taught = {} if self._teacher is None else {"teacher": self._teacher(self.street)}
        return {**self._cell._asdict(), **taught}

    def _street_of(self, cell: Cell) -> OccludedCrossing:
        if cell not in self._streets:
            self._streets[cell] = OccludedCrossing(
                **cell._asdict(), observation="none", **self._options
            )
        return self._streets[cell]


def _together(infos: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return what is said of a decision, from what is said of its control steps."""
    together = {**infos[-1], "control_steps": len(infos)}
    for name in together:
        if name.startswith("reward_"):
            together[name] = sum(info[name] for info in infos)
        elif name.startswith(("weight_", "confidence_")):
            together[name] = sum(info[name] for info in infos) / len(infos)
    return together
