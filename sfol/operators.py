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
from sfol.arrays import Array, Backend
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


@dataclass(frozen=True)
class Gathering:
    """What several substitutions for one head come to.

    Like an `Operator` it takes lower bounds with lower, upper with upper, and is monotone: neither
    a greater bound nor a further substitution lowers what it gives.

    Attributes:
        name: as the key `groundings` names it.
        formula: of the numbers to which the substitutions come.
        source: where it is defined.
        combine: the function itself, of as many numbers as are needed, or more.
        along: the same along an axis of an array, which is kept with size 1.
        absent: what stands in that array for a substitution that does not hold.
        needed: how many substitutions there have to be.
    """

    name: str
    formula: str
    source: str
    combine: Callable[[Sequence[float]], float]
    along: Callable[[Backend, Array, int], Array]
    absent: float = 0.0
    needed: int = 1

    def __call__(self, bounds: Sequence[Bound]) -> Bound:
        """Return what the bounds of substitutions come to; there must be as many as are needed."""
        lowers, uppers = zip(*bounds, strict=True)
        return Bound(self.combine(lowers), self.combine(uppers))


def _probabilistic_sum_along(backend: Backend, values: Array, axis: int) -> Array:
    """Combine halves with each other until one is left: as many steps as its length has digits."""
    before = (slice(None),) * axis
    while (size := values.shape[axis]) > 1:
        half = size // 2
        first, second = values[(*before, slice(half))], values[(*before, slice(half, 2 * half))]
        both = _probabilistic_pair(first, second)
        rest = [values[(*before, slice(2 * half, size))]] if size % 2 else []
        values = backend.joined_along([both, *rest], axis) if rest else both
    return values if size else backend.sum_along(values, (axis,))


def nth_greatest(number: int) -> Gathering:
    """Return what gives the n-th greatest number, of n or more."""
    return Gathering(
        "best" if number == 1 else f"greatest {number}",
        "max xᵢ" if number == 1 else f"the {number}-th greatest xᵢ",
        "Gödel t-conorm" if number == 1 else "the n-th order statistic from above",
        max if number == 1 else lambda values: sorted(values)[-number],
        lambda backend, values, axis: backend.nth_largest_along(values, axis, number),
        absent=-math.inf,
        needed=number,
    )


BEST = nth_greatest(1)
# What `groundings` may say besides `pooled`, which combines atoms and not substitutions.
GATHERINGS: Mapping[str, Gathering] = {
    entry.name: entry
    for entry in (
        BEST,
        Gathering(
            "sum",
            "min(1, Σ xᵢ)",
            "Łukasiewicz t-conorm, bounded sum",
            lambda values: min(1.0, math.fsum(values)),
            lambda backend, values, axis: backend.minimum(backend.sum_along(values, (axis,)), 1.0),
        ),
        Gathering(
            "probabilistic_sum",
            "1 − Π (1 − xᵢ)",
            "product t-conorm: as if the substitutions were independent of each other",
            _probabilistic_sum,
            _probabilistic_sum_along,
        ),
    )
}
POOLED = "pooled"
GROUNDINGS = (POOLED, *GATHERINGS)


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


def greater(left: Bound, right: Bound) -> Bound:
    """Return the greater one of the lower bounds, and of the upper bounds."""
    return Bound(max(left.lower, right.lower), max(left.upper, right.upper))


def negation(bound: Bound) -> Bound:
    """Return [1 − u, 1 − l], the bound of the negated atom."""
    return Bound(1.0 - bound.upper, 1.0 - bound.lower)
