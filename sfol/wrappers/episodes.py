"""An episode of one subject: its steps rewarded by rules, and what is logged of them."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, SupportsFloat, TypeVar

from sfol.errors import UsageError, expect
from sfol.facts import Facts
from sfol.outcome import Outcome, log_items, named
from sfol.reward import RewardFunction
from sfol.wrappers.modes import (
    EPISODE,
    EpisodeSums,
    Shaping,
    check_reads,
    expect_function,
    shaping_of,
    total,
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


@dataclass(frozen=True)
class Rewarding:
    """By what steps are rewarded.

    Attributes:
        reward: the reward function.
        signals_of: makes signals of a transition; None reads all of them.
        mode: ``replace``, ``add`` or ``potential``.
        shaping: what the mode ``potential`` does.
    """

    reward: RewardFunction
    signals_of: Callable[..., Mapping[str, float]] | None
    mode: str
    shaping: Shaping | None

    @classmethod
    def checked(  # noqa: PLR0913, PLR0917 (the arguments of a wrapper, in their order)
        cls,
        reward: RewardFunction,
        facts: Callable[..., Facts] | None,
        signals: Callable[..., Mapping[str, float]] | None,
        mode: str,
        potential: str | None,
        discount: float | None,
    ) -> Rewarding:
        """Check the arguments of a wrapper; see `RuleReward`.

        Raises:
            UsageError: one is of another type or does not belong to the mode, or the knowledge base
                does not say how something is read and there is no function that makes it.
        """
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
        return cls(reward, signals, mode, shaping)


class RuledEpisode(Generic[Observation, Action]):
    """The steps of an episode, one after the other.

    Args:
        rewarding: by what.
        observation: the first one.
        facts: of its state.
    """

    def __init__(self, rewarding: Rewarding, observation: Observation, facts: Facts) -> None:
        self._rewarding = rewarding
        self._reward = rewarding.reward
        self._shaping = rewarding.shaping
        self._sums = EpisodeSums()
        self._remember(observation, facts)

    @property
    def observation(self) -> Observation:
        """What was observed last."""
        return self._observation

    def step(
        self, transition: Transition[Observation, Action], facts_of: Callable[[], Facts]
    ) -> tuple[float, dict[str, Any]]:
        """Return the reward of a step, and its info with what is logged.

        Args:
            transition: from the observation before.
            facts_of: makes the facts of s'.
        """
        ruled, terms, items = self._ruled(transition, facts_of)
        original = transition.native
        value = ruled if self._rewarding.mode == "replace" else float(original) + ruled
        self._sums.add(value, float(original), terms)
        info = {**transition.info, **items, "original_reward": original}
        if transition.terminated or transition.truncated:
            info[EPISODE] = self._sums.items()
        return value, info

    def _ruled(
        self, transition: Transition[Observation, Action], facts_of: Callable[[], Facts]
    ) -> tuple[float, Mapping[str, float], dict[str, float]]:
        """Return what the rules give for a step, its summands, and the items of info."""
        if self._shaping is None:
            outcome = self._judged(transition, facts_of)
            return outcome.reward, outcome.terms, log_items(outcome)
        before = self._potential
        self._remember(transition.next_observation, facts_of())
        terms = self._shaping.terms(before, self._potential, transition.terminated)
        return total(terms), terms, named(reward=terms, potential=self._potential)

    def _judged(
        self, transition: Transition[Observation, Action], facts_of: Callable[[], Facts]
    ) -> Outcome:
        signals, before = self._signals(transition), self._facts
        self._remember(transition.next_observation, facts_of())
        facts = before if self._reward.kb.facts_at == "state" else self._facts
        return self._reward.evaluate(facts, **signals)

    def _remember(self, observation: Observation, facts: Facts) -> None:
        # Environments may use one array for all their observations.
        self._observation = copy.deepcopy(observation)
        self._facts = facts
        if self._shaping is not None:
            self._potential = self._potential_of(observation, self._shaping.weight)

    def _potential_of(self, observation: Observation, weight: str | None) -> Mapping[str, float]:
        """Return the summands of the potential of the state whose facts are remembered."""
        if weight is not None:
            return {weight: self._reward.weights(self._facts)[weight]}
        signals = self._reward.observe_signals(observation)
        return self._reward.evaluate(self._facts, **signals).terms

    def _signals(self, transition: Transition[Observation, Action]) -> Mapping[str, float]:
        signals_of = self._rewarding.signals_of
        given = {} if signals_of is None else signals_of(transition)
        return self._reward.observe_signals(
            transition.observation,
            transition.action,
            transition.next_observation,
            transition.native,
            transition.terminated,
            transition.truncated,
            **given,
        )
