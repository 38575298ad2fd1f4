"""Functions over all entities of a sort that are there: ``min(P.distance for P in person)``.

Over nobody each but `mean` has a value, too, the one that changes nothing: `min` is infinite, `sum`
0, `any` 0 and `all` 1; `mean` is 0/0, NaN. `any` and `all` are the greatest and the least of
confidences, the quantifiers of Gödel's logic (Hájek, "Metamathematics of Fuzzy Logic", 1998).
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import reduce

from sfol import arrays
from sfol.arithmetic import FUNCTIONS, OPERATORS
from sfol.arrays import Array


@dataclass(frozen=True)
class Quantifier:
    """A function over any number of entities.

    Attributes:
        fold: combines two numbers.
        combine: the same, of arrays.
        reduce: combines the numbers along the first axis of an array, which is not empty.
        of_nobody: its value over nobody.
    """

    fold: Callable[[float, float], float]
    combine: Callable[[Array, Array], Array]
    reduce: Callable[[Array], Array]
    of_nobody: float

    def of_numbers(self, numbers: Iterable[float]) -> float:
        """Return its value over a number for each entity."""
        return reduce(self.fold, numbers, self.of_nobody)

    def of_arrays(self, values: Array, there: Array) -> Array:
        """Return its value along the first axis.

        Args:
            values: (n, ...), a number for each entity.
            there: truth values, of a shape that broadcasts: which entities are there.
        """
        masked = arrays.where(there, values, self.of_nobody)
        if not masked.shape[0]:
            return arrays.total(masked) + self.of_nobody
        return self.combine(self.reduce(masked), self.of_nobody)


class _Mean(Quantifier):
    """The sum of the numbers by how many there are."""

    def of_numbers(self, numbers: Iterable[float]) -> float:
        every = list(numbers)
        mean: float = _BY.of_numbers(super().of_numbers(every), float(len(every)))
        return mean

    def of_arrays(self, values: Array, there: Array) -> Array:
        ones = arrays.where(there, 1.0, 0.0 * values)
        return _BY.of_arrays(super().of_arrays(values, there), super().of_arrays(ones, there))


def _smallest(values: Array) -> Array:
    return -arrays.largest(-values)


_MIN, _MAX, _BY = FUNCTIONS["min"], FUNCTIONS["max"], OPERATORS["/"]

QUANTIFIERS: Mapping[str, Quantifier] = {
    "min": Quantifier(_MIN.of_numbers, _MIN.of_arrays, _smallest, math.inf),
    "max": Quantifier(_MAX.of_numbers, _MAX.of_arrays, arrays.largest, -math.inf),
    "sum": Quantifier(operator.add, operator.add, arrays.total, 0.0),
    "mean": _Mean(operator.add, operator.add, arrays.total, 0.0),
    "all": Quantifier(_MIN.of_numbers, _MIN.of_arrays, _smallest, 1.0),
    "any": Quantifier(_MAX.of_numbers, _MAX.of_arrays, arrays.largest, 0.0),
}
