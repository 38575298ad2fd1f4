"""Comparisons that give way: 1 where they hold, and less the farther they are from holding.

``below(x, limit, margin=m)`` is 1 up to the limit; at a distance of m outside it is
`value_at_margin`, 0.1 if nothing else is said, and the shape says how it falls. Without a margin a
comparison is crisp, 1 or 0, and holds at its limits.

Source: Tassa et al., "DeepMind Control Suite", arXiv 1801.00690, and the function `tolerance` of
that suite. What is usual there and differs here is the default shape: a linear one ends, so that
far away an atom is known to be false.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from sfol import arrays
from sfol.arithmetic import COMPARISONS, FUNCTIONS, OPERATORS, Operation
from sfol.arrays import Array

DEFAULT_SHAPE = "linear"
DEFAULT_VALUE = 0.1

_Falling = Callable[[Array], Array]


@dataclass(frozen=True)
class _Maths:
    """The functions that soft comparisons are made of, for numbers or for arrays."""

    exp: Callable[[Array], Array]
    cos: Callable[[Array], Array]
    minimum: Callable[[Array, Array], Array]
    maximum: Callable[[Array, Array], Array]
    where: Callable[[Array, Array, Array], Array]
    divide: Callable[[Array, Array], Array]


_MIN, _MAX, _WHERE, _DIVIDE = *(FUNCTIONS[name] for name in ("min", "max", "where")), OPERATORS["/"]
_NUMBERS = _Maths(
    math.exp,
    math.cos,
    _MIN.of_numbers,
    _MAX.of_numbers,
    _WHERE.of_numbers,
    _DIVIDE.of_numbers,
)
_ARRAYS = _Maths(
    arrays.exp,
    arrays.cos,
    _MIN.of_arrays,
    _MAX.of_arrays,
    _WHERE.of_arrays,
    _DIVIDE.of_arrays,
)


@dataclass(frozen=True)
class Shape:
    """How a soft comparison falls.

    Attributes:
        falling: from functions and v, the value at the margin, makes a function of r, the distance
            in margins, that is 1 at r = 0 and v at r = 1.
        formula: the same for the documentation.
        takes_zero: whether v may be 0.
    """

    falling: Callable[[_Maths, float], _Falling]
    formula: str
    takes_zero: bool


def _linear(maths: _Maths, value: float) -> _Falling:
    return lambda r: maths.maximum(1.0 - (1.0 - value) * r, 0.0)


def _gaussian(maths: _Maths, value: float) -> _Falling:
    rate = math.log(value)
    return lambda r: maths.exp(rate * (r * r))


def _long_tail(maths: _Maths, value: float) -> _Falling:
    rate = 1.0 / value - 1.0
    return lambda r: 1.0 / (1.0 + rate * (r * r))


def _cosine(maths: _Maths, value: float) -> _Falling:
    rate = math.acos(2.0 * value - 1.0)
    return lambda r: (1.0 + maths.cos(maths.minimum(rate * r, math.pi))) / 2.0


def _hard(maths: _Maths, value: float) -> _Falling:
    return lambda r: maths.where(r > 0, maths.where(r <= 1, value, 0.0), 1.0 + 0.0 * r)


SHAPES: Mapping[str, Shape] = {
    "linear": Shape(_linear, "max(1 − (1 − v) r, 0)", takes_zero=True),
    "gaussian": Shape(_gaussian, "v^(r²)", takes_zero=False),
    "long_tail": Shape(_long_tail, "1 / (1 + (1/v − 1) r²)", takes_zero=False),
    "cosine": Shape(_cosine, "(1 + cos(min(r arccos(2v − 1), π))) / 2", takes_zero=True),
    "hard": Shape(_hard, "v up to r = 1, then 0", takes_zero=True),
}


@dataclass(frozen=True)
class SoftComparison:
    """A comparison that may have a margin.

    Attributes:
        crisp: the comparison without a margin.
        excess: with a function for the greater of two, how far the arguments are from holding; 0
            or less where they hold.
        meaning: where it is 1, for the documentation.
    """

    crisp: Operation
    excess: Callable[..., Array]
    meaning: str

    def soft(self, shape: str, value_at_margin: float) -> Operation:
        """Return the comparison as an operation whose last argument is the margin.

        Args:
            shape: one of `SHAPES`.
            value_at_margin: below 1 and above 0, or 0 for a shape that takes it.
        """
        count = self.crisp.least + 1
        of_numbers, of_arrays = (
            self._with(maths, SHAPES[shape].falling(maths, value_at_margin))
            for maths in (_NUMBERS, _ARRAYS)
        )
        return Operation(of_numbers, of_arrays, count, count)

    def _with(self, maths: _Maths, falling: _Falling) -> Callable[..., Array]:
        excess, maximum, where, divide = self.excess, maths.maximum, maths.where, maths.divide

        def function(*arguments: Array) -> Array:
            *compared, margin = arguments
            distance = maximum(excess(maximum, *compared), 0.0)
            if isinstance(margin, float) and margin > 0.0:  # as it mostly is
                return falling(distance / margin)
            # What holds does so with a margin of 0, too; a margin below 0 means nothing.
            margins = where(distance == 0, 0.0, divide(distance, margin))
            return falling(where(margin < 0, math.nan, margins))

        return function


def _crisp(holds: Callable[..., Array], arguments: int) -> Operation:
    return Operation(holds, holds, arguments, arguments)


_at_most, _at_least = COMPARISONS["<="].of_arrays, COMPARISONS[">="].of_arrays

SOFT_COMPARISONS: Mapping[str, SoftComparison] = {
    "below": SoftComparison(
        COMPARISONS["<="], lambda maximum, x, limit: x - limit, "below(x, limit): x ≤ limit"
    ),
    "above": SoftComparison(
        COMPARISONS[">="], lambda maximum, x, limit: limit - x, "above(x, limit): x ≥ limit"
    ),
    "between": SoftComparison(
        _crisp(lambda x, low, high: _at_least(x, low) * _at_most(x, high), 3),
        lambda maximum, x, low, high: maximum(low - x, x - high),
        "between(x, low, high): low ≤ x ≤ high",
    ),
    "near": SoftComparison(
        COMPARISONS["=="], lambda maximum, x, target: abs(x - target), "near(x, target): x = target"
    ),
}
