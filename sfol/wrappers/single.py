"""A wrapper of one environment."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, SupportsFloat, TypeVar

import gymnasium

from sfol.errors import UsageError, expect
from sfol.facts import Facts
from sfol.outcome import Outcome
from sfol.reward import RewardFunction
from sfol.wrappers.modes import (
    EPISODE,
    EpisodeSums,
    check_reads,
    expect_function,
    is_silent,
    log_items,
    named,
    shaping_of,
    total,
    warn_of_silence,
)

Observation = TypeVar("Observation")
Action = TypeVar("Action")


@dataclass(frozen=True)
class Transition(Generic[Observation, Action]):
    """One step (s, a, s') of an environment.

    Attributes:
        observation: of s.
        action: a.
        next_observation: of s'.
        native: the environment's own reward.
        terminated: whether the step terminated the episode.
        truncated: whether the episode was truncated after it.
        info: what the environment says of the step.
    """

    observation: Observation
    action: Action
    next_observation: Observation
    native: SupportsFloat
    terminated: bool
    truncated: bool
    info: Mapping[str, Any]


class RuleReward(
    gymnasium.Wrapper[Observation, Action, Observation, Action],
    gymnasium.utils.RecordConstructorArgs,
):
    """Rewards the steps of an environment by a knowledge base.

    Facts and signals are read off observations as the knowledge base says; functions may make them
    instead, or the signals that it does not read. A step is rewarded by the facts of the state
    before it, or of the state after it if the knowledge base says `facts_at: next`. If no rule
    concludes anything about the subject in the first episode, a `SilentZeroWarning` says so.

    In mode ``replace`` the reward is that of the knowledge base, R, in mode ``add`` the sum of it
    and the environment's own. In mode ``potential`` the environment's own reward is shaped by
    γ φ(s') − φ(s), where φ(s) is R of one state, or a weight; φ of a terminal state is 0, so that
    every policy that was optimal is so still (Ng, Harada, Russell 1999).

    ``info`` of every step gets ``reward_<term>`` (they sum to what the rules gave), and the
    environment's own reward as ``original_reward``; ``weight_<name>`` and ``confidence_<head>``, or
    ``potential_<term>`` of s' in mode ``potential``. At the end of an episode ``sfol.episode`` has
    its sums: ``return``, ``original_return``, ``length`` and ``terms``.

    Args:
        env: any environment.
        reward: the reward function.
        facts: makes facts of (observation, info, env); called at reset and after each step. None
            reads them off the observation.
        signals: makes signals of a transition, by name; the others are read off it.
        mode: ``replace``, ``add`` or ``potential``.
        potential: in mode ``potential``, a weight that is φ; None for R, which may then have no
            signals but those of one state.
        discount: in mode ``potential``, γ, that of the agent.

    Raises:
        UsageError: an argument is of another type or does not belong to the mode, or the knowledge
            base does not say how something is read and there is no function that makes it.
    """

    def __init__(  # noqa: PLR0913 (six have defaults and are given by name)
        self,
        env: gymnasium.Env[Observation, Action],
        reward: RewardFunction,
        *,
        facts: Callable[[Observation, Mapping[str, Any], gymnasium.Env[Any, Any]], Facts]
        | None = None,
        signals: Callable[[Transition[Observation, Action]], Mapping[str, float]] | None = None,
        mode: str = "replace",
        potential: str | None = None,
        discount: float | None = None,
    ) -> None:
        expect(env, gymnasium.Env, "the environment", "give a gymnasium.Env")
        expect(reward, RewardFunction, "the reward", "give a sfol.RewardFunction")
        expect_function(facts, "facts", "give a function (observation, info, env) → Facts")
        expect_function(signals, "signals", "give a function of a Transition → signals")
        shaping = shaping_of(reward, mode, potential, discount)
        if shaping and signals:
            raise UsageError(
                "a potential has no signals of a transition",
                name="signals",
                suggestion="leave the function out",
            )
        check_reads(
            reward,
            facts=facts is None,
            signals=shaping is None and signals is None,
            instead=", or give {}=…",
        )
        # So that Gymnasium can make the environment again from its specification.
        gymnasium.utils.RecordConstructorArgs.__init__(
            self,
            reward=reward,
            facts=facts,
            signals=signals,
            mode=mode,
            potential=potential,
            discount=discount,
            _disable_deepcopy=True,
        )
        gymnasium.Wrapper.__init__(self, env)
        self._reward = reward
        self._facts_of = facts
        self._signals_of = signals
        self._shaping = shaping
        self._mode = mode
        self._silent = bool(reward.kb.heads)  # until a rule concludes something

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; see `gymnasium.Env.reset`."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._remember(observation, info)
        self._sums = EpisodeSums()
        return observation, info

    def step(self, action: Action) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Take a step and reward it; see `gymnasium.Env.step`."""
        observation, original, terminated, truncated, info = self.env.step(action)
        transition = Transition(
            self._observation, action, observation, original, terminated, truncated, info
        )
        ruled, terms, items = self._ruled(transition)
        value = ruled if self._mode == "replace" else float(original) + ruled
        self._sums.add(value, float(original), terms)
        info = {**info, **items, "original_reward": original}
        if terminated or truncated:
            info[EPISODE] = self._sums.items()
            if self._silent:
                self._silent = False
                warn_of_silence(self._reward, self._facts)
        return observation, value, terminated, truncated, info

    def _ruled(
        self, transition: Transition[Observation, Action]
    ) -> tuple[float, Mapping[str, float], dict[str, float]]:
        """Return what the rules give for a step, its summands, and the items of info."""
        if self._shaping is None:
            outcome = self._judged(transition)
            return outcome.reward, outcome.terms, log_items(outcome)
        before = self._potential
        self._remember(transition.next_observation, transition.info)
        terms = self._shaping.terms(before, self._potential, transition.terminated)
        return total(terms), terms, named(reward=terms, potential=self._potential)

    def _judged(self, transition: Transition[Observation, Action]) -> Outcome:
        signals, before = self._signals(transition), self._facts
        self._remember(transition.next_observation, transition.info)
        facts = before if self._reward.kb.facts_at == "state" else self._facts
        return self._heard(self._reward.evaluate(facts, **signals))

    def _heard(self, outcome: Outcome) -> Outcome:
        if self._silent:
            self._silent = is_silent(outcome.bounds)
        return outcome

    def _remember(self, observation: Observation, info: Mapping[str, Any]) -> None:
        # Environments may use one array for all their observations.
        self._observation = copy.deepcopy(observation)
        if self._facts_of is None:
            self._facts = self._reward.observe(observation)
        else:
            self._facts = self._facts_of(observation, info, self.env)
        if self._shaping is not None:
            self._potential = self._potential_of(observation, self._shaping.weight)

    def _potential_of(self, observation: Observation, weight: str | None) -> Mapping[str, float]:
        """Return the summands of the potential of the state whose facts are remembered."""
        if weight is not None:
            value = self._reward.weights(self._facts)[weight]
            self._silent = self._silent and not value
            return {weight: value}
        signals = self._reward.observe_signals(observation)
        return self._heard(self._reward.evaluate(self._facts, **signals)).terms

    def _signals(self, transition: Transition[Observation, Action]) -> Mapping[str, float]:
        given = {} if self._signals_of is None else self._signals_of(transition)
        return self._reward.observe_signals(
            transition.observation,
            transition.action,
            transition.next_observation,
            transition.native,
            transition.terminated,
            transition.truncated,
            **given,
        )
