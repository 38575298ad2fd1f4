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

    @property
    def is_finite(self) -> bool:
        """Whether every value is a finite number."""
        return not self.nan and math.isfinite(self.low) and math.isfinite(self.high)


ANY = Range()


def _sum(a: Range, b: Range) -> Range:
    nan = a.nan or b.nan or a.high == -b.low == math.inf or b.high == -a.low == math.inf
    low, high = a.low + b.low, a.high + b.high
    return ANY if math.isnan(low) or math.isnan(high) else Range(low, high, nan)


def _negated(a: Range) -> Range:
    return Range(-a.high, -a.low, a.nan)


def _product(a: Range, b: Range) -> Range:
    corners = [x * y for x in a[:2] for y in b[:2]]
    if a.nan or b.nan or any(map(math.isnan, corners)):
        return ANY
    inner = [c.low <= 0.0 <= c.high for c in (a, b)]
    endless = [math.inf in (-c.low, c.high) for c in (a, b)]
    nan = (inner[0] and endless[1]) or (inner[1] and endless[0])
    return Range(min(corners), max(corners), nan)


def _quotient(a: Range, b: Range) -> Range:
    if a.nan or not (0.0 < b.low == b.high < math.inf):
        return ANY
    return Range(a.low / b.low, a.high / b.low, nan=False)


def _absolute(a: Range) -> Range:
    if a.low >= 0.0:
        return a
    return Range(max(0.0, -a.high), max(-a.low, a.high), a.nan)


# Rounding is monotone, so that computed ends are ends of what is computed.
RANGES: Mapping[str, Callable[..., Range]] = {
    "+": _sum,
    "-": lambda a, b: _sum(a, _negated(b)),
    "*": _product,
    "/": _quotient,
    "neg": _negated,
    "abs": _absolute,
    "minimum": lambda a, b: Range(min(a.low, b.low), min(a.high, b.high), a.nan or b.nan),
    "maximum": lambda a, b: Range(max(a.low, b.low), max(a.high, b.high), a.nan or b.nan),
    "where": lambda _, a, b: Range(min(a.low, b.low), max(a.high, b.high), a.nan or b.nan),
}
