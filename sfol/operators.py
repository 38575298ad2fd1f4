"""The operators of soft logic, each defined once for every engine.

All work on truth values between 0 and 1 and are applied to lower bounds and to upper bounds apart,
so that a bound stays a bound: each is monotone in every argument.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

from sfol import arrays
from sfol.arrays import Array
from sfol.facts import TRUE, Bound


@dataclass(frozen=True)
class Operator:
    """Several truth values become one.

    Attributes:
        name: as the key `semantics` of a knowledge base names it.
        formula: in the usual notation.
        source: where it is defined.
        combine: the function itself, of numbers; its argument is never empty.
        pair: combines two arrays; several, one after the other, and then finished, are the whole.
        finish: what remains to be done, given what `pair` came to and how many it combined.
        neutral: what changes nothing, given to `pair`.
        absent: what no other argument makes more of than anything else is, given to `pair`.
        pooled: the same from the sum of any number of truth values and their number, for a
            conjunction that may pool all substitutions of a body; None where that is not defined.
    """

    name: str
    formula: str
    source: str
    combine: Callable[[Sequence[float]], float]
    pair: Callable[[Array, Array], Array]
    finish: Callable[[Array, int], Array] = lambda total, count: total
    neutral: float = 1.0
    absent: float = 0.0
    pooled: Callable[[Array, Array], Array] | None = None

    def __call__(self, bounds: Iterable[Bound]) -> Bound:
        """Combine lower bounds with lower, upper with upper.

        Args:
            bounds: at least one.

        Returns:
            The combined bound.
        """
        lowers, uppers = zip(*bounds, strict=True)
        return Bound(self.combine(lowers), self.combine(uppers))

    def elementwise(self, values: Sequence[Array]) -> Array:
        """Combine arrays of shapes that broadcast; at least one."""
        return self.finish(reduce(self.pair, values), len(values))

    @property
    def is_idempotent(self) -> bool:
        """Whether a truth value taken twice is as good as once."""
        return self.combine((0.5, 0.5)) == 0.5

    @property
    def can_grow(self) -> bool:
        """Whether a further truth value can raise the result; no t-norm does that."""
        return self.combine((0.5, 1.0)) > 0.5


def _average(values: Sequence[float]) -> float:
    # fsum rounds once, so that the order of facts cannot change even the last digit
    return math.fsum(values) / len(values)


def _lukasiewicz(values: Sequence[float]) -> float:
    return max(0.0, math.fsum(values) - (len(values) - 1))


def _probabilistic_sum(values: Sequence[Any]) -> Any:
    # 1 - (1 - x) is 0 for a tiny x. Added up like this, one value is itself, and what is above zero
    # stays above zero.
    return reduce(_probabilistic_pair, values)


def _probabilistic_pair(total: Any, value: Any) -> Any:
    return total + value * (1.0 - total)


CONJUNCTIONS: Mapping[str, Operator] = {
    entry.name: entry
    for entry in (
        Operator(
            "average",
            "(1/n) Σ xᵢ",
            "the paper's equation for τ_H",
            _average,
            operator.add,
            operator.truediv,
            neutral=0.0,
            absent=-math.inf,
            pooled=operator.truediv,
        ),
        Operator("minimum", "min xᵢ", "Gödel t-norm", min, arrays.minimum),
        Operator("product", "Π xᵢ", "product t-norm", math.prod, operator.mul),
        Operator(
            "lukasiewicz",
            "max(0, Σ xᵢ − (n − 1))",
            "Łukasiewicz t-norm",
            _lukasiewicz,
            operator.add,
            lambda total, count: arrays.maximum(total - (count - 1), 0.0),
            neutral=0.0,
            absent=-math.inf,
        ),
    )
}

DISJUNCTIONS: Mapping[str, Operator] = {
    entry.name: entry
    for entry in (
        Operator("maximum", "max xᵢ", "the paper, on rules that share a head", max, arrays.maximum),
        Operator(
            "probabilistic_sum",
            "1 − Π (1 − xᵢ)",
            "product t-conorm",
            _probabilistic_sum,
            _probabilistic_pair,
        ),
    )
}

# τ̂ from a bound's lower and upper end, for numbers and arrays.
CONFIDENCES: Mapping[str, Callable[[Any, Any], Any]] = {
    "midpoint": lambda lower, upper: (lower + upper) / 2,
    "lower": lambda lower, upper: lower,
    "upper": lambda lower, upper: upper,
}


# By which share of itself a threshold may be missed: 1 − 0.8 is a little less than 0.2.
TOLERANCE = 1e-9


def least(threshold: float, tolerance: float = TOLERANCE) -> float:
    """Return the least number that reaches a threshold.

    Bounds are rounded, and thresholds are ordinary decimals, so that what is equal on paper may be
    a little less: the mean of three 0.7 is less than 0.7.

    Args:
        threshold: as written in a knowledge base.
        tolerance: the share of it that rounding may take away.
    """
    return threshold * (1.0 - tolerance)


def times(bound: Bound, certainty: Bound) -> Bound:
    """Return [l·c_l, u·c_u], the bound of what follows with a certainty from what has a bound.

    Source: the implication of annotated logic programs whose annotations are multiplied, as the
    attenuation of M. H. van Emden, "Quantitative deduction and its fixpoint theory", 1986.
    """
    return Bound(bound.lower * certainty.lower, bound.upper * certainty.upper)


def with_certainty(conjunction: Operator, certainty: Bound) -> Callable[[Iterable[Bound]], Bound]:
    """Return what makes the bound of a rule of those of its literals.

    Args:
        conjunction: combines these.
        certainty: the rule's own; [1, 1] leaves the conjunction as it is.
    """
    if certainty == TRUE:
        return conjunction
    return lambda bounds: times(conjunction(bounds), certainty)


def negation(bound: Bound) -> Bound:
    """Return [1 − u, 1 − l], the bound of the negated atom."""
    return Bound(1.0 - bound.upper, 1.0 - bound.lower)
