"""A wrapper of vectorised environments: one evaluation for all of them."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper

from sfol import arrays
from sfol.arrays import Array
from sfol.errors import UsageError, expect
from sfol.observations.plans import Observation
from sfol.outcome import log_items, named
from sfol.reward import RewardFunction
from sfol.wrappers.modes import (
    EPISODE,
    EpisodeSums,
    check_reads,
    shaping_of,
    total,
)
from sfol.wrappers.silence import Silence

_Reals = npt.NDArray[np.float64]
_Mask = npt.NDArray[np.bool_]
_Ruled = tuple[Array, Mapping[str, Array], Mapping[str, Array]]


class VectorRuleReward(VectorWrapper):
    """Rewards the steps of vectorised environments by a knowledge base.

    What `RuleReward` is for one environment, this is for B of them, with one evaluation for all.
    Every step is rewarded by the transition that really happened, whichever way environments begin
    anew (`gymnasium.vector.AutoresetMode`): where one does so in place of a step (``NEXT_STEP``)
    its reward is 0, and where one does so after its last step (``SAME_STEP``) that step leads to
    ``final_obs``. Observations are arrays with an axis B before all others.

    ``info`` gets what it gets from `RuleReward`, each an array (B,), with a mask ``_<key>`` that
    says whose step it is of. They are all at the top, none in ``final_info``. The sums in
    ``sfol.episode`` are those of environments whose episode has just ended.

    Args:
        envs: vectorised environments.
        reward: the reward function; its knowledge base says how facts and signals are read.
        mode: ``replace``, ``add`` or ``potential``, as for `RuleReward`.
        potential: in mode ``potential``, a weight that is φ; None for the reward.
        discount: in mode ``potential``, γ, that of the agent.

    Raises:
        UsageError: an argument is of another type or does not belong to the mode, the knowledge
            base does not say how something is read, or the environments do not say how they begin
            anew.
    """

    def __init__(
        self,
        envs: VectorEnv[Any, Any, Any],
        reward: RewardFunction,
        *,
        mode: str = "replace",
        potential: str | None = None,
        discount: float | None = None,
    ) -> None:
        expect(envs, VectorEnv, "the environments", "give a gymnasium.vector.VectorEnv")
        expect(reward, RewardFunction, "the reward", "give a sfol.RewardFunction")
        shaping = shaping_of(reward, mode, potential, discount)
        check_reads(reward, signals=shaping is None)
        self._autoreset = _autoreset_mode(envs)
        super().__init__(envs)
        self._reward = reward
        self._mode = mode
        self._silence = Silence(reward)
        self._shaping = shaping

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Start episodes, all or those in ``options["reset_mask"]``; see `VectorEnv.reset`."""
        chosen = (options or {}).get("reset_mask")
        observations, infos = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        if chosen is None:
            self._sums = EpisodeSums()
            self._begins = np.zeros(self.num_envs, dtype=np.bool_)
        else:
            self._sums.restart(chosen)
            self._begins = self._begins & ~chosen
        self._remember(observations)
        return observations, infos

    def step(self, actions: Any) -> tuple[Any, _Reals, _Mask, _Mask, dict[str, Any]]:
        """Take a step in each environment and reward all; see `VectorEnv.step`."""
        observations, native, terminated, truncated, infos = self.env.step(actions)
        ended = np.logical_or(terminated, truncated)
        landed = self._landed(observations, ended, infos)
        taken = ~self._begins
        step = (self._observations, actions, landed, native, terminated, truncated)
        ruled, terms, items = self._ruled(step, taken)
        self._silence.hear(items)
        rewards = ruled if self._mode == "replace" else native + ruled
        self._sums.add(rewards, native, terms, taken.astype(np.int64))
        infos = {**infos, **_with_masks({**items, "original_reward": np.array(native)}, taken)}
        if ended.any():
            infos |= _with_masks({EPISODE: _sums(self._sums.items(), ended)}, ended)
            self._sums.restart(ended)
            self._silence.end()
        self._begins = ended & (self._autoreset is AutoresetMode.NEXT_STEP)
        self._remember(observations, landed)
        return observations, rewards, terminated, truncated, infos

    def _ruled(self, step: tuple[Any, ...], taken: _Mask) -> _Ruled:
        """Return what the rules give, its summands and the items of info; 0 for who began anew."""
        if self._shaping is not None:
            *_, landed, _, terminated, _ = step
            self._landed_potential = self._shaping.potentials(self._reward, landed)
            given = self._shaping.terms(self._potential, self._landed_potential, terminated)
            terms = {name: np.where(taken, term, 0.0) for name, term in given.items()}
            return total(terms), terms, named(reward=terms, potential=self._landed_potential)
        if not taken.any():
            terms = dict.fromkeys(self._reward.kb.terms, np.zeros(self.num_envs))
            return np.zeros(self.num_envs), terms, named(reward=terms)
        spread: Callable[[Array], _Reals] = arrays.plain
        if taken.all():
            outcome = self._reward.transitions(*step)
        else:
            outcome = self._reward.transitions(*(_rows(part, taken) for part in step))
            spread = partial(_spread, mask=taken)
        items = {name: spread(value) for name, value in log_items(outcome).items()}
        terms = {name: items[f"reward_{name}"] for name in outcome.terms}
        return spread(outcome.reward), terms, items

    def _landed(self, observations: Observation, ended: _Mask, infos: Mapping[str, Any]) -> Any:
        """Return what was observed after each step, before an environment began anew."""
        if self._autoreset is not AutoresetMode.SAME_STEP or not ended.any():
            return observations
        if "final_obs" not in infos:
            raise UsageError(
                "the environments begin anew in the same step and give no final_obs",
                name="final_obs",
                suggestion="their info must have the last observations of episodes",
            )
        final = infos["final_obs"]
        return _replaced(observations, {i: _row(final, i) for i in np.flatnonzero(ended).tolist()})

    def _remember(self, observations: Observation, landed: Observation = None) -> None:
        if self._shaping is not None:
            same = landed is observations
            self._potential = (
                self._landed_potential
                if same
                else self._shaping.potentials(self._reward, observations)
            )
        # Environments may use one array for all their observations.
        self._observations = copy.deepcopy(observations)


def _autoreset_mode(envs: VectorEnv[Any, Any, Any]) -> AutoresetMode:
    said = envs.metadata.get("autoreset_mode")
    try:
        return AutoresetMode(said)
    except ValueError:
        raise UsageError(
            f"the environments begin anew in the mode {said!r}",
            name="autoreset_mode",
            suggestion="their metadata must have a gymnasium.vector.AutoresetMode",
        ) from None


def _with_masks(items: Mapping[str, Any], mask: _Mask) -> dict[str, Any]:
    """Return items as `gymnasium.vector` has them, each with who it is of."""
    return {**items, **{f"_{name}": mask for name in items}}


def _sums(items: Mapping[str, Any], ended: _Mask) -> dict[str, Any]:
    """Return sums of those whose episode has ended, and 0 for the others, with masks."""
    parts = {
        name: _sums(part, ended) if isinstance(part, Mapping) else np.where(ended, part, 0)
        for name, part in items.items()
    }
    return _with_masks(parts, ended)


# -- observations and actions, nested in any way ------------------------------------------------


def _rows(batch: Any, mask: _Mask) -> Any:
    """Return some of B observations."""
    if batch is None:
        return None
    if isinstance(batch, Mapping):
        return {key: _rows(part, mask) for key, part in batch.items()}
    if isinstance(batch, tuple):
        return tuple(_rows(part, mask) for part in batch)
    return batch[mask] if arrays.is_array(batch) else np.asarray(batch)[mask]


def _spread(values: Array, mask: _Mask) -> _Reals:
    """Return values of some of B environments as an array (B,), with 0 for the others."""
    spread = np.zeros(len(mask))
    spread[mask] = arrays.plain(values)
    return spread


def _row(batch: Any, index: int) -> Any:
    """Return one of B observations."""
    if isinstance(batch, Mapping):
        return {key: _row(part, index) for key, part in batch.items()}
    if isinstance(batch, tuple):
        return tuple(_row(part, index) for part in batch)
    return batch[index]


def _replaced(batch: Any, rows: Mapping[int, Any]) -> Any:
    """Return B observations with some of them replaced."""
    if isinstance(batch, Mapping):
        return {key: _replaced(part, _under(rows, key)) for key, part in batch.items()}
    if isinstance(batch, tuple):
        return tuple(_replaced(part, _under(rows, key)) for key, part in enumerate(batch))
    replaced = copy.copy(batch)
    for index, row in rows.items():
        replaced[index] = row
    return replaced


def _under(rows: Mapping[int, Any], key: Any) -> dict[int, Any]:
    return {index: row[key] for index, row in rows.items()}
