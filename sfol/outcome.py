"""What an evaluation gives: the reward with everything that it was made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sfol.arrays import Array
from sfol.engines.batched import Bounds
from sfol.engines.conclusions import Conclusions
from sfol.facts import Bound
from sfol.syntax import Atom


@dataclass(frozen=True)
class Outcome:
    """What one evaluation gave.

    Attributes:
        reward: R, the sum of the terms in their order.
        terms: term → weight × formula, signed.
        weights: weight → w.
        confidences: head → τ̂ of the subject, 0 where it is unknown.
        bounds: head → bound of the subject, None where it is unknown: neither concluded by a rule
            nor asserted by a fact.
        derived: every concluded atom with its bound.
        conclusions: what all of it was computed from; `RewardFunction.explain` and
            `RewardFunction.entity_weights` take them in place of the facts.
    """

    reward: float
    terms: Mapping[str, float]
    weights: Mapping[str, float]
    confidences: Mapping[str, float]
    bounds: Mapping[str, Bound | None]
    derived: Mapping[Atom, Bound]
    conclusions: Conclusions = field(repr=False, compare=False)

    @property
    def fired(self) -> frozenset[str]:
        """The names of the rules that concluded something, for whichever entity."""
        return self.conclusions.fired


@dataclass(frozen=True, eq=False)
class BatchOutcome:
    """What one evaluation of B scenes gave; arrays of the caller's kind.

    Attributes:
        reward: float (B,), R.
        terms: term → float (B,), weight × formula, signed.
        weights: weight → float (B,), w.
        confidences: head → float (B,), τ̂ of the subject, 0 where nothing was concluded.
        bounds: head → bounds of the subject, with what is known.
    """

    reward: Array
    terms: Mapping[str, Array]
    weights: Mapping[str, Array]
    confidences: Mapping[str, Array]
    bounds: Mapping[str, Bounds]


def log_items(outcome: Outcome | BatchOutcome) -> dict[str, Any]:
    """Return the parts of an outcome under the names that loggers get.

    Args:
        outcome: of one step, or of B steps.

    Returns:
        Numbers, or arrays (B,): ``reward_<term>``, ``weight_<name>`` and ``confidence_<head>``.
    """
    return named(reward=outcome.terms, weight=outcome.weights, confidence=outcome.confidences)


def named(**groups: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of groups under the names ``<group>_<name>``."""
    return {f"{group}_{name}": v for group, items in groups.items() for name, v in items.items()}
