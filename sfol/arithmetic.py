"""The arithmetic of formulas: that of IEEE 754, on numbers as on arrays.

Nothing raises here: 1 / 0 is infinite, so is what is too large, the root of −1 is NaN, and NaN
stays NaN, in `min` and `max` too; both branches of `where` are computed. So one number, and every
element of numpy's arrays and of torch's tensors, give the same. Whether a result will do is asked
once, at the end.

Source: IEEE 754-2019, 7.2 and 7.3; but (−∞)**0.5 may be NaN, as the root of −∞ is.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce

import numpy as np

from sfol import arrays
from sfol.arrays import Array


@dataclass(frozen=True)
class Operation:
    """An operation of formulas.

    Attributes:
        of_numbers: for Python's own real numbers.
        of_arrays: for real numbers and arrays.
        least: the fewest arguments.
        most: the most arguments.
    """

    of_numbers: Callable[..., float]
    of_arrays: Callable[..., Array]
    least: int
    most: int


def _total(of_numbers: Callable[..., float], of_any: Callable[..., float]) -> Callable[..., float]:
    """Return a function of numbers that has a value where Python's raises."""

    def function(*numbers: float) -> float:
        try:
            return of_numbers(*numbers)
        except (ArithmeticError, ValueError):
            with np.errstate(all="ignore"):
                return float(of_any(*numbers))

    return function


_divide = _total(operator.truediv, np.true_divide)
_power = _total(math.pow, np.power)


def _minimum(left: float, right: float) -> float:
    return right if right < left or math.isnan(right) else left


def _maximum(left: float, right: float) -> float:
    return right if right > left or math.isnan(right) else left


def _where(condition: float, then: float, otherwise: float) -> float:
    return then if condition else otherwise


def _lifted(
    of_numbers: Callable[..., float], of_arrays: Callable[..., Array]
) -> Callable[..., Array]:
    """Return a function of arrays that takes numbers alone as well."""

    def function(*values: Array) -> Array:
        if all(type(value) is float for value in values):
            return of_numbers(*values)
        return of_arrays(*values)

    return function


def _operation(
    of_numbers: Callable[..., float], of_arrays: Callable[..., Array], arguments: int
) -> Operation:
    return Operation(of_numbers, _lifted(of_numbers, of_arrays), arguments, arguments)


def _comparison(compare: Callable[[Array, Array], Array]) -> Operation:
    def as_number(left: Array, right: Array) -> Array:
        return 1.0 * compare(left, right)

    return Operation(as_number, as_number, 2, 2)


def _folded(
    of_numbers: Callable[[float, float], float], of_arrays: Callable[[Array, Array], Array]
) -> Operation:
    lifted = _lifted(of_numbers, of_arrays)
    return Operation(
        lambda *values: reduce(of_numbers, values), lambda *values: reduce(lifted, values), 2, 8
    )


def _clip(
    minimum: Callable[[Array, Array], Array], maximum: Callable[[Array, Array], Array]
) -> Callable[[Array, Array, Array], Array]:
    return lambda value, low, high: minimum(maximum(value, low), high)


OPERATORS: Mapping[str, Operation] = {
    "+": _operation(operator.add, operator.add, 2),
    "-": _operation(operator.sub, operator.sub, 2),
    "*": _operation(operator.mul, operator.mul, 2),
    "/": _operation(_divide, operator.truediv, 2),
    "**": _operation(_power, operator.pow, 2),
}
SIGNS: Mapping[str, Operation] = {
    "+": _operation(operator.pos, operator.pos, 1),
    "-": _operation(operator.neg, operator.neg, 1),
}
COMPARISONS: Mapping[str, Operation] = {
    "==": _comparison(operator.eq),
    "!=": _comparison(operator.ne),
    "<": _comparison(operator.lt),
    "<=": _comparison(operator.le),
    ">": _comparison(operator.gt),
    ">=": _comparison(operator.ge),
}
FUNCTIONS: Mapping[str, Operation] = {
    "abs": _operation(abs, abs, 1),
    "exp": _operation(_total(math.exp, np.exp), arrays.exp, 1),
    "log": _operation(_total(math.log, np.log), arrays.log, 1),
    "sqrt": _operation(_total(math.sqrt, np.sqrt), arrays.sqrt, 1),
    "hypot": _operation(math.hypot, arrays.hypot, 2),
    "atan2": _operation(math.atan2, arrays.atan2, 2),
    "min": _folded(_minimum, arrays.minimum),
    "max": _folded(_maximum, arrays.maximum),
    "clip": _operation(
        _clip(_minimum, _maximum),
        _clip(_lifted(_minimum, arrays.minimum), _lifted(_maximum, arrays.maximum)),
        3,
    ),
    "where": _operation(_where, arrays.where, 3),
}
