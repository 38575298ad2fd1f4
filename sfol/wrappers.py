"""Gymnasium wrappers: any environment, rewarded by rules."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, SupportsFloat, TypeVar

from sfol.errors import UsageError, expect, missing_extra
from sfol.facts import Facts
from sfol.outcome import Outcome
from sfol.reward import RewardFunction

try:
    import gymnasium
except ImportError as error:
    raise missing_extra("gymnasium", "the wrappers need it", extra="gymnasium") from error

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
    """Replaces the reward of an environment by that of a knowledge base.

    Facts and signals are read off observations as the knowledge base says; functions may make them
    instead, or the signals that it does not read. A step is rewarded by the facts of the state
    before it, or of the state after it if the knowledge base says `facts_at: next`. ``info`` of
    every step gets ``reward_<term>`` (they sum to the reward), ``weight_<name>``,
    ``confidence_<head>``, and the environment's own reward as ``original_reward``.

    Args:
        env: any environment.
        reward: the reward function.
        facts: makes facts of (observation, info, env); called at reset and after each step. None
            reads them off the observation.
        signals: makes signals of a transition, by name; the others are read off it.

    Raises:
        UsageError: an argument is of another type, or the knowledge base does not say how facts
            are read and there is no function that makes them.
    """

    def __init__(
        self,
        env: gymnasium.Env[Observation, Action],
        reward: RewardFunction,
        *,
        facts: Callable[[Observation, Mapping[str, Any], gymnasium.Env[Any, Any]], Facts]
        | None = None,
        signals: Callable[[Transition[Observation, Action]], Mapping[str, float]] | None = None,
    ) -> None:
        expect(env, gymnasium.Env, "the environment", "give a gymnasium.Env")
        expect(reward, RewardFunction, "the reward", "give a sfol.RewardFunction")
        _expect_function(facts, "facts", "give a function (observation, info, env) → Facts")
        _expect_function(signals, "signals", "give a function of a Transition → signals")
        if facts is None and not reward.reads_facts:
            raise UsageError(
                f"'{reward.kb.name}' does not say how facts are read off an observation",
                name="facts",
                suggestion="add the sections observation and facts, or give facts=…",
            )
        # So that Gymnasium can make the environment again from its specification.
        gymnasium.utils.RecordConstructorArgs.__init__(
            self, reward=reward, facts=facts, signals=signals, _disable_deepcopy=True
        )
        gymnasium.Wrapper.__init__(self, env)
        self._reward = reward
        self._facts_of = facts
        self._signals_of = signals

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; see `gymnasium.Env.reset`."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._remember(observation, info)
        return observation, info

    def step(self, action: Action) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Take a step and reward it; see `gymnasium.Env.step`."""
        observation, original, terminated, truncated, info = self.env.step(action)
        transition = Transition(
            self._observation, action, observation, original, terminated, truncated, info
        )
        signals = self._signals(transition)
        before = self._facts
        self._remember(observation, info)
        facts = before if self._reward.kb.facts_at == "state" else self._facts
        outcome = self._reward.evaluate(facts, **signals)
        info = {**info, **log_items(outcome), "original_reward": original}
        return observation, outcome.reward, terminated, truncated, info

    def _remember(self, observation: Observation, info: Mapping[str, Any]) -> None:
        # Environments may use one array for all their observations.
        self._observation = copy.deepcopy(observation)
        if self._facts_of is None:
            self._facts = self._reward.observe(observation)
        else:
            self._facts = self._facts_of(observation, info, self.env)

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


def _expect_function(value: object, what: str, suggestion: str) -> None:
    if value is not None:
        expect(value, Callable, what, suggestion)  # type: ignore[arg-type]


def log_items(outcome: Outcome) -> dict[str, float]:
    """Return the parts of an outcome under the names that loggers get.

    Args:
        outcome: of one step.

    Returns:
        ``reward_<term>``, ``weight_<name>`` and ``confidence_<head>``.
    """
    return {
        **{f"reward_{name}": value for name, value in outcome.terms.items()},
        **{f"weight_{name}": value for name, value in outcome.weights.items()},
        **{f"confidence_{name}": value for name, value in outcome.confidences.items()},
    }
