"""Where the results of operations lie, if it is known where their arguments do.

Source: interval arithmetic, as in IEEE 1788-2015, with ends that are rounded like the numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple


class Range(NamedTuple):
    """Where the values of a lane lie, as far as that is known beforehand."""

    low: float = -math.inf
    high: float = math.inf
    nan: bool = True  # whether any may be NaN
    minus_zero: bool = True  # whether any may be the zero with a minus

    @property
    def is_finite(self) -> bool:
        """Whether every value is a finite number."""
        return not self.nan and math.isfinite(self.low) and math.isfinite(self.high)

    @property
    def is_positive(self) -> bool:
        """Whether every value is a number from 0 up, and no zero has a minus."""
        return not self.nan and self.low >= 0.0 and not self.minus_zero


ANY = Range()


def _sum(a: Range, b: Range) -> Range:
    nan = a.nan or b.nan or a.high == -b.low == math.inf or b.high == -a.low == math.inf
    low, high = a.low + b.low, a.high + b.high
    if math.isnan(low) or math.isnan(high):
        return ANY
    return Range(low, high, nan, a.minus_zero and b.minus_zero)


def _difference(a: Range, b: Range) -> Range:
    return _sum(a, _negated(b))._replace(minus_zero=a.minus_zero)


def _negated(a: Range) -> Range:
    return Range(-a.high, -a.low, a.nan)


def _product(a: Range, b: Range) -> Range:
    corners = [x * y for x in a[:2] for y in b[:2]]
    if a.nan or b.nan or any(map(math.isnan, corners)):
        return ANY
    inner = [c.low <= 0.0 <= c.high for c in (a, b)]
    endless = [math.inf in (-c.low, c.high) for c in (a, b)]
    nan = (inner[0] and endless[1]) or (inner[1] and endless[0])
    return Range(min(corners), max(corners), nan, not (a.is_positive and b.is_positive))


def _quotient(a: Range, b: Range) -> Range:
    if a.nan or not (0.0 < b.low == b.high < math.inf):
        return ANY
    return Range(a.low / b.low, a.high / b.low, nan=False, minus_zero=not a.is_positive)


def _absolute(a: Range) -> Range:
    low, high = (a.low, a.high) if a.low >= 0.0 else (max(0.0, -a.high), max(-a.low, a.high))
    return Range(low, high, a.nan, minus_zero=False)


def _either(low: float, high: float, a: Range, b: Range) -> Range:
    return Range(low, high, a.nan or b.nan, a.minus_zero or b.minus_zero)


# Rounding is monotone, so that computed ends are ends of what is computed.
RANGES: Mapping[str, Callable[..., Range]] = {
    "+": _sum,
    "-": _difference,
    "*": _product,
    "/": _quotient,
    "neg": _negated,
    "abs": _absolute,
    "minimum": lambda a, b: _either(min(a.low, b.low), min(a.high, b.high), a, b),
    "maximum": lambda a, b: _either(max(a.low, b.low), max(a.high, b.high), a, b),
    "where": lambda _, a, b: _either(min(a.low, b.low), max(a.high, b.high), a, b),
}
