"""A wrapper of vectorised environments: one evaluation for all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper

from sfol.errors import UsageError, expect
from sfol.observations.plans import Observation
from sfol.recorded_steps import Reals
from sfol.reward import RewardFunction
from sfol.wrappers.goals import refuse_hindsight
from sfol.wrappers.judging_many import ManyJudge, Mask
from sfol.wrappers.modes import (
    EPISODE,
    FIRED,
    ManyEpisodeSums,
    check_reads,
    check_together,
    shaping_of,
    term_names,
)
from sfol.wrappers.nested import replaced, row
from sfol.wrappers.silence import Silence


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
            base does not say how something is read or has rules over time, or the environments do
            not say how they begin anew.
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
        check_together(reward, "wrap each in RuleReward, and make the vector of what that gives")
        shaping = shaping_of(reward, mode, potential, discount)
        check_reads(reward, signals=shaping is None)
        self._autoreset = _autoreset_mode(envs)
        super().__init__(envs)
        self._judge = ManyJudge(reward, shaping)
        self._terms = term_names(reward, shaping)
        self._mode = mode
        self._silence = Silence(reward)

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
            self._sums = ManyEpisodeSums(self._terms, self.num_envs)
            self._begins = np.zeros(self.num_envs, dtype=np.bool_)
        else:
            self._sums.restart(chosen)
            self._begins = self._begins & ~chosen
        self._judge.begin(observations)
        return observations, infos

    def step(self, actions: Any) -> tuple[Any, Reals, Mask, Mask, dict[str, Any]]:
        """Take a step in each environment and reward all; see `VectorEnv.step`."""
        observations, native, terminated, truncated, infos = self.env.step(actions)
        ended = np.logical_or(terminated, truncated)
        landed = self._landed(observations, ended, infos)
        taken = ~self._begins
        given = self._judge.step(actions, landed, native, terminated, truncated, taken)
        self._silence.hear(given.items)
        rewards = given.values if self._mode == "replace" else native + given.values
        self._sums.add(rewards, native, given.terms, taken)
        items: dict[str, Any] = {**given.items, "original_reward": np.array(native)}
        if given.fired is not None:
            items[FIRED] = _with_masks(given.fired, taken)
        infos = {**infos, **_with_masks(items, taken)}
        if np.count_nonzero(ended):
            sums = self._sums.end(ended)
            sums["terms"] = _with_masks(sums["terms"], ended)
            infos |= _with_masks({EPISODE: _with_masks(sums, ended)}, ended)
            self._silence.end()
        if self._autoreset is AutoresetMode.NEXT_STEP:
            self._begins = ended.copy()  # which infos have as a mask
        self._judge.go_on(observations, landed)
        return observations, rewards, terminated, truncated, infos

    def call(self, name: str, *arguments: Any, **options: Any) -> tuple[Any, ...]:
        """Call a method of the environments; see `gymnasium.vector.SyncVectorEnv.call`.

        Raises:
            UsageError: hindsight asks for the rewards of other goals, which the environments would
                answer with their own.
        """
        refuse_hindsight(name)
        called: tuple[Any, ...] = self.env.call(name, *arguments, **options)  # type: ignore[attr-defined]
        return called

    def report_fired(self, *, whether: bool = True) -> None:
        """Say whether ``infos`` get ``sfol.fired``: rule → who had it conclude something (B,)."""
        self._judge.reports_fired = whether

    def _landed(self, observations: Observation, ended: Mask, infos: Mapping[str, Any]) -> Any:
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
        return replaced(observations, {i: row(final, i) for i in np.flatnonzero(ended).tolist()})


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


def _with_masks(items: Mapping[str, Any], mask: Mask) -> dict[str, Any]:
    """Return items as `gymnasium.vector` has them, each with who it is of."""
    return {**items, **dict.fromkeys([f"_{name}" for name in items], mask)}
