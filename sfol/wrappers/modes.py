"""What the rules' reward of a step does to the environment's own, and what is logged of it."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
import numpy.typing as npt

from sfol import arrays
from sfol.arrays import Array
from sfol.errors import UsageError, did_you_mean, expect
from sfol.observations.plans import Observation, plan_of
from sfol.reward import RewardFunction

MODES = ("replace", "add", "potential")
EPISODE = "sfol.episode"  # the key in `info` of an episode's sums; of no other package
FIRED = "sfol.fired"  # the key in `info` of which rules fired


@dataclass(frozen=True)
class Shaping:
    """Potential-based shaping: a step gets γ φ(s') − φ(s), which changes no optimal policy.

    Source: Ng, Harada, Russell, Policy invariance under reward transformations, ICML 1999.

    Attributes:
        weight: φ is this weight, or the whole reward if it is None.
        discount: γ, that of the agent's return.
    """

    weight: str | None
    discount: float

    def terms(
        self, before: Mapping[str, Array], after: Mapping[str, Array], terminated: Array
    ) -> dict[str, Array]:
        """Return what a step gets, for each summand of the potential.

        Args:
            before: the summands of φ(s).
            after: those of φ(s').
            terminated: whether s' is terminal; its potential is 0 then.
        """
        alive = self.discount * (1.0 - terminated)
        return {name: alive * after[name] - before[name] for name in before}

    def potentials(
        self, reward: RewardFunction, observations: Observation
    ) -> dict[str, npt.NDArray[np.float64]]:
        """Return the summands of φ of B states.

        Args:
            reward: the reward function.
            observations: of the states, with an axis B before all others.
        """
        if self.weight is not None:
            weights = reward.weights_of_many(observations)
            return {self.weight: arrays.plain(weights[self.weight])}
        terms = reward.transitions(observations, None, observations).terms
        return {name: arrays.plain(value) for name, value in terms.items()}


class EpisodeSums:
    """Sums over the steps of an episode of one environment."""

    def __init__(self) -> None:
        self._totals: dict[str, float] = {}
        self._terms: dict[str, float] = {}

    def add(self, value: float, original: float, terms: Mapping[str, float]) -> None:
        """Add what a step gave.

        Args:
            value: its reward.
            original: the environment's own.
            terms: what the rules gave, by term.
        """
        new = {"return": value, "original_return": original, "length": 1}
        self._totals = {name: self._totals.get(name, 0) + item for name, item in new.items()}
        self._terms = {name: self._terms.get(name, 0) + item for name, item in terms.items()}

    def items(self) -> dict[str, Any]:
        """Return ``return``, ``original_return``, ``length`` and, by name, ``terms``."""
        return {**self._totals, "terms": self._terms}


class ManyEpisodeSums:
    """Sums over the steps of an episode of each of B environments, in one array.

    Args:
        terms: the names of what the rules give.
        count: B.
    """

    def __init__(self, terms: Iterable[str], count: int) -> None:
        self._terms = tuple(terms)
        self._sums = np.zeros((3 + len(self._terms), count))
        self._rows = [*self._sums]

    def add(
        self, values: Array, original: Array, terms: Mapping[str, Array], steps: Array = 1
    ) -> None:
        """Add what a step gave.

        Args:
            values: (B,), its rewards.
            original: (B,), the environments' own.
            terms: what the rules gave (B,), by term.
            steps: 0 where no step was taken.
        """
        new = (values, original, steps, *terms.values())
        for sums, numbers in zip(self._rows, new, strict=True):
            np.add(sums, numbers, out=sums)

    def end(self, ended: Array) -> dict[str, Any]:
        """Return what `EpisodeSums` do, (B,) each, and begin anew where an episode has ended.

        Args:
            ended: (B,), whether it has; the sums of the others are given as 0.
        """
        sums = np.where(ended, self._sums, 0.0)
        np.copyto(self._sums, 0.0, where=ended)
        value, original, lengths, *terms = sums
        return self._items(value, original, lengths.astype(np.int64), terms)

    def restart(self, chosen: Array) -> None:
        """Begin anew in some environments."""
        np.copyto(self._sums, 0.0, where=chosen)

    def items_of(self, index: int) -> dict[str, Any]:
        """Return what `EpisodeSums` do of one environment, as plain numbers."""
        value, original, length, *terms = self._sums[:, index].tolist()
        return self._items(value, original, int(length), terms)

    def _items(
        self, value: Any, original: Any, length: Any, terms: Sequence[Any]
    ) -> dict[str, Any]:
        totals = {"return": value, "original_return": original, "length": length}
        return {**totals, "terms": dict(zip(self._terms, terms, strict=True))}


def shaping_of(
    reward: RewardFunction,
    mode: str,
    potential: str | None,
    discount: float | None,
    *,
    signals: object = None,
) -> Shaping | None:
    """Check the arguments that say what is made of a reward; return how it shapes, if it does.

    Args:
        reward: the reward function.
        mode: ``replace``, ``add`` or ``potential``.
        potential: a weight, or None for the reward.
        discount: γ, needed for a potential.
        signals: a function that makes signals of a transition, of which no potential is.

    Raises:
        UsageError: one is of another type, does not exist or does not belong to the mode; or the
            potential reads more than one state.
    """
    expect(mode, str, "mode", f"one of {', '.join(MODES)}")
    if mode not in MODES:
        raise UsageError(
            f"there is no mode '{mode}'", name=mode, suggestion=did_you_mean(mode, MODES)
        )
    if mode != "potential":
        for name, value in (("potential", potential), ("discount", discount)):
            if value is not None:
                raise UsageError(
                    f"the mode '{mode}' has no {name}", name=name, suggestion="mode='potential' has"
                )
        return None
    if reward.kb.has_memory:
        raise UsageError(
            f"'{reward.kb.name}' has rules over time, and a potential is one of a state alone",
            name="potential",
            suggestion="mode='add' adds their reward to the environment's own",
        )
    if signals is not None:
        raise UsageError(
            "a potential has no signals of a transition",
            name="signals",
            suggestion="leave the function out",
        )
    if potential is None:
        _check_state_alone(reward)
    else:
        expect(potential, str, "potential", "give the name of a weight")
        if potential not in reward.kb.weights:
            raise UsageError(
                f"'{reward.kb.name}' has no weight '{potential}'",
                name=potential,
                suggestion=did_you_mean(potential, reward.kb.weights),
            )
    return Shaping(potential, _discount(discount))


def checked_shaping(  # noqa: PLR0913, PLR0917 (the arguments of a wrapper, in their order)
    reward: RewardFunction,
    facts: object,
    signals: object,
    mode: str,
    potential: str | None,
    discount: float | None,
    *,
    of: str = "(observation, info, env)",
) -> Shaping | None:
    """Check the arguments of a wrapper, and return how it shapes, if it does.

    Args:
        reward: the reward function.
        facts: a function that makes facts, or None.
        signals: a function that makes signals of a transition, or None.
        mode: as for `shaping_of`, and so are the others.
        potential: likewise.
        discount: likewise.
        of: the arguments that the function that makes facts gets, for messages.

    Raises:
        UsageError: one is of another type or does not belong to the mode, or the knowledge base
            does not say how something is read and there is no function that makes it.
    """
    expect(reward, RewardFunction, "the reward", "give a sfol.RewardFunction")
    expect_function(facts, "facts", f"give a function {of} → Facts")
    expect_function(signals, "signals", "give a function of a Transition → signals")
    shaping = shaping_of(reward, mode, potential, discount, signals=signals)
    check_reads(
        reward,
        facts=facts is None,
        signals=shaping is None and signals is None,
        instead=", or give {}=…",
    )
    return shaping


def check_reads(
    reward: RewardFunction, *, facts: bool = True, signals: bool = True, instead: str = ""
) -> None:
    """Make sure that a knowledge base says how everything is read off an observation.

    Args:
        reward: the reward function.
        facts: whether it must say so of facts.
        signals: whether it must say so of signals.
        instead: what may be given in place of that, for messages, with a place for its name.

    Raises:
        UsageError: it does not.
    """
    kb = reward.kb
    if facts and not reward.reads_facts:
        raise UsageError(
            f"'{kb.name}' does not say how facts are read off an observation",
            name="facts",
            suggestion=f"add the sections observation and facts{instead.format('facts')}",
        )
    read = kb.observed_signals
    missing = [n for n, s in kb.signals.items() if n not in read and s.default is None]
    if signals and missing:
        raise UsageError(
            f"'{kb.name}' does not say how the signal '{missing[0]}' is read",
            name=missing[0],
            suggestion=f"give it from or a default{instead.format('signals')}",
        )


def check_together(reward: RewardFunction, instead: str) -> None:
    """Make sure that many environments can be rewarded by one evaluation.

    Args:
        reward: the reward function.
        instead: what to do otherwise, for messages.

    Raises:
        UsageError: each has an episode of its own to remember.
    """
    if reward.kb.has_memory:
        raise UsageError(
            f"'{reward.kb.name}' has rules over time, and each environment its own past",
            name=reward.kb.name,
            suggestion=instead,
        )


def expect_function(value: object, what: str, suggestion: str) -> None:
    """Make sure that an argument is a function or None.

    Raises:
        UsageError: it is neither.
    """
    if value is not None:
        expect(value, Callable, what, suggestion)  # type: ignore[arg-type]


def item_names(reward: RewardFunction) -> tuple[str, ...]:
    """Return the names of `log_items` of every outcome of a reward function, in their order."""
    kb = reward.kb
    groups = {"reward": kb.terms, "weight": kb.weights, "confidence": reward.subject_heads}
    return tuple(f"{group}_{name}" for group, names in groups.items() for name in names)


def term_names(reward: RewardFunction, shaping: Shaping | None) -> tuple[str, ...]:
    """Return the names of what the rules give for a step, in their order."""
    potential = None if shaping is None else shaping.weight
    return (*reward.kb.terms,) if potential is None else (potential,)


def total(terms: Mapping[str, Array]) -> Array:
    """Return the sum of terms, from left to right."""
    return reduce(operator.add, terms.values(), 0.0)


def _check_state_alone(reward: RewardFunction) -> None:
    """Refuse a reward that is of a transition, and no function of a state."""
    check_reads(reward)
    for name, formula in reward.kb.observed_signals.items():
        plan = plan_of(reward.kb, formula)
        wholes = {r.whole for r in plan.readings} | {r.whole for r in plan.quantified.values()}
        read = sorted(wholes - {""})
        if read:
            raise UsageError(
                f"the reward is no potential: the signal '{name}' reads '{read[0]}'",
                name=name,
                suggestion="a potential is of one state: potential=… takes a weight alone",
            )


def _discount(value: object) -> float:
    number = None if value is None else arrays.as_float(value)
    if number is None or not 0.0 <= number <= 1.0:
        raise UsageError(
            f"the discount is {value!r:.80}",
            name="discount",
            suggestion="give the agent's γ, from 0 to 1, such as discount=0.99",
        )
    return number
