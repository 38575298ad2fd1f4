"""What the rules give for the steps of one environment."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, NamedTuple, SupportsFloat, TypeVar

from sfol.facts import Facts
from sfol.outcome import Outcome, log_items, named
from sfol.reward import RewardFunction
from sfol.wrappers.modes import FIRED, Shaping, item_names, total

Observation = TypeVar("Observation")
Action = TypeVar("Action")


class Transition(NamedTuple, Generic[Observation, Action]):
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


class Judgement(NamedTuple):
    """What the rules give for a step.

    Attributes:
        value: the sum of the terms.
        terms: its summands by name.
        items: what `info` gets.
    """

    value: float
    terms: Mapping[str, float]
    items: dict[str, Any]


class Judge(Generic[Observation, Action]):
    """Judges the steps of one environment, one after the other.

    Args:
        reward: the reward function.
        facts: makes facts of an observation, its `info` and `context`; None reads them off it.
        signals: makes signals of a transition, by name; the others are read off it.
        shaping: how the environment's own reward is shaped, if it is.
        context: further arguments of `facts`.

    Attributes:
        observation: of the state in which the environment is.
        facts: of that state.
        reports_fired: whether `info` gets which rules fired.
    """

    def __init__(
        self,
        reward: RewardFunction,
        *,
        facts: Callable[..., Facts] | None = None,
        signals: Callable[[Transition[Observation, Action]], Mapping[str, float]] | None = None,
        shaping: Shaping | None = None,
        context: tuple[Any, ...] = (),
    ) -> None:
        self.observation: Observation
        self.reports_fired = False
        self._reward = reward
        self._facts_of = facts
        self._signals_of = signals
        self._shaping = shaping
        self._context = context
        self._names = item_names(reward)
        self._episode = reward.episode() if reward.kb.has_memory else None
        own = (facts, signals, shaping, self._episode)
        self._reads_all = all(part is None for part in own)

    def begin(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Begin an episode with a state."""
        if self._episode is not None:
            self._episode.reset()
        self._go_on(observation, info)

    def _go_on(self, observation: Observation, info: Mapping[str, Any]) -> None:
        # Environments may use one array for all their observations.
        self.observation = copy.deepcopy(observation)
        self._facts: Facts | None
        if self._facts_of is None:
            self._facts = self._reward.observe(observation)
        else:
            self._facts = self._facts_of(observation, info, *self._context)
        if self._shaping is not None:
            self._potential = self._potential_of(observation, self._shaping.weight)

    def step(self, transition: Transition[Observation, Action]) -> Judgement:
        """Judge a step from the present state, and go on from the one that it led to."""
        if self._shaping is None:
            return self._rewarded(transition)
        before = self._potential
        self._go_on(transition.next_observation, transition.info)
        terms = self._shaping.terms(before, self._potential, transition.terminated)
        items: dict[str, Any] = named(reward=terms, potential=self._potential)
        if self.reports_fired:
            items[FIRED] = self._fired(self._reward.conclude(self.facts).fired)
        return Judgement(total(terms), terms, items)

    def _rewarded(self, transition: Transition[Observation, Action]) -> Judgement:
        if self._reads_all:
            found = self._reward.repeated(transition[:6], fired=self.reports_fired)
            if found is not None:
                self.observation = copy.deepcopy(transition.next_observation)
                self._facts = None  # read when they are asked for
                return self._repeated(found)
        outcome = self._judged(transition)
        items = log_items(outcome)
        if self.reports_fired:
            items[FIRED] = self._fired(outcome.fired)
        return Judgement(outcome.reward, outcome.terms, items)

    def _repeated(self, found: Sequence[float]) -> Judgement:
        value, *numbers = found
        kb = self._reward.kb
        terms = dict(zip(kb.terms, numbers, strict=False))
        items: dict[str, Any] = dict(zip(self._names, numbers, strict=False))
        if self.reports_fired:
            fired = map(bool, numbers[len(self._names) :])
            items[FIRED] = dict(zip(kb.rules, fired, strict=True))
        return Judgement(value, terms, items)

    def _judged(self, transition: Transition[Observation, Action]) -> Outcome:
        signals, before = self._signals(transition), self.facts
        self._go_on(transition.next_observation, transition.info)
        facts = before if self._reward.kb.facts_at == "state" else self.facts
        evaluate = self._reward.evaluate if self._episode is None else self._episode.step
        return evaluate(facts, **signals)

    @property
    def facts(self) -> Facts:
        """The facts of that state; read when they are asked for, after a step was repeated."""
        if self._facts is None:
            self._facts = self._reward.observe(self.observation)
        return self._facts

    def _fired(self, rules: frozenset[str]) -> dict[str, bool]:
        return {rule: rule in rules for rule in self._reward.kb.rules}

    def _potential_of(self, observation: Observation, weight: str | None) -> Mapping[str, float]:
        """Return the summands of the potential of the state whose facts are remembered."""
        if weight is not None:
            return {weight: self._reward.weights(self.facts)[weight]}
        signals = self._reward.observe_signals(observation)
        return self._reward.evaluate(self.facts, **signals).terms

    def _signals(self, transition: Transition[Observation, Action]) -> Mapping[str, float]:
        given = {} if self._signals_of is None else self._signals_of(transition)
        return self._reward.observe_signals(*transition[:6], **given)
