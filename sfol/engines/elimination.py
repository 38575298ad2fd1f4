"""Elimination of variables: what a body comes to for each value of some of its variables.

A body is a product of factors, each an array with an axis for each variable of the rule, of size 1
where the factor does not name it, and scenes along the last axis. A variable that is no longer
needed is taken out by combining the factors that name it and reducing along its axis. In a body
that is a tree no array on the way is larger than the largest factor.

Source: R. Dechter, "Bucket elimination: a unifying framework for reasoning", Artificial
Intelligence 113, 1999; for truth values it is the full reducer of `sfol.engines.support`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import reduce

from sfol.arrays import Array

Names = frozenset[str]


def elimination_order(
    factors: Iterable[Names], keep: Names, sizes: Mapping[str, int]
) -> tuple[tuple[str, ...], int]:
    """Return an order in which to eliminate variables, and how large arrays get on the way.

    Args:
        factors: the variables that each factor names.
        keep: those that stay.
        sizes: variable → how many values it has.

    Returns:
        The order is greedy: always the variable that makes the smallest array.
    """

    def size(names: Names) -> int:
        return math.prod(sizes[name] for name in names)

    left = [frozenset(factor) for factor in factors]
    order: list[str] = []
    largest = max(map(size, left), default=1)
    while waiting := frozenset().union(*left) - keep:
        joined = {
            name: frozenset().union(*(factor for factor in left if name in factor))
            for name in sorted(waiting)
        }
        name = min(joined, key=lambda name: size(joined[name]))
        order.append(name)
        largest = max(largest, size(joined[name]))
        left = [factor for factor in left if name not in factor] + [joined[name] - {name}]
    return tuple(order), max(largest, size(frozenset().union(*left)))


def eliminated(
    factors: Sequence[tuple[Names, Array]],
    order: Sequence[str],
    combine: Callable[[Array, Array], Array],
    along: Callable[[str, Array], Array],
) -> Array:
    """Return the product of factors with some variables eliminated.

    Args:
        factors: the variables that each names, and its array; at least one.
        order: the variables to eliminate.
        combine: of two arrays; it distributes over the reduction.
        along: reduces an array along the axis of a variable, which stays with size 1.
    """
    left = list(factors)
    for name in order:
        touched = [factor for factor in left if name in factor[0]]
        names = frozenset().union(*(names for names, _ in touched))
        joined = along(name, reduce(combine, (array for _, array in touched)))
        left = [factor for factor in left if name not in factor[0]] + [(names - {name}, joined)]
    return reduce(combine, (array for _, array in left))
