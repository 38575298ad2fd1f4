"""Bodies with ``or`` and ``implies``: as they are written, and every way in which they can hold.

A body of literals alone holds in one way. ``P(X), (Q(X) or R(X))`` holds in two: ``P(X), Q(X)`` and
``P(X), R(X)``; its disjunctive normal form has a disjunct for each. ``P(X) implies Q(X)`` stands
for ``not P(X) or Q(X)``.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

from sfol.errors import ClauseError
from sfol.literals import KINDS, Literal

AND, OR, IMPLIES = ",", "or", "implies"
MAXIMUM_WAYS = 64


@dataclass(frozen=True)
class Joined:
    """Parts of a body that one connective joins.

    Attributes:
        connective: ``,``, ``or`` or ``implies``.
        parts: two or more; of ``implies`` just two.
    """

    connective: str
    parts: tuple[Tree, ...]

    def __str__(self) -> str:
        between = ", " if self.connective == AND else f" {self.connective} "
        return between.join(
            f"({part})" if isinstance(part, Joined) else str(part) for part in self.parts
        )


Tree = Joined | Literal


def ways(body: Tree) -> list[tuple[Literal, ...]]:
    """Return every way in which a body can hold: the literals of each, in the order of the text.

    Raises:
        ClauseError: there are too many, or something to the left of ``implies`` has no opposite.
    """
    plain = _without_implies(body)
    count = _count(plain)
    if count > MAXIMUM_WAYS:
        raise ClauseError(
            f"the body can hold in {'more than a million' if count > 1e6 else count} ways, each of "
            f"which is a rule; {MAXIMUM_WAYS} are the limit",
            suggestion="let a rule of its own conclude what stands in parentheses",
        )
    return list(_ways(plain))


def opposite(body: Tree) -> Tree:
    """Return what holds where a body does not.

    Raises:
        ClauseError: a literal of it has no opposite.
    """
    if isinstance(body, Literal):
        found = (opposed for kind in KINDS if (opposed := kind.opposite_of(body)))
        if (literal := next(found, None)) is None:
            raise ClauseError(
                f"'{body}' can't stand to the left of '{IMPLIES}': nothing says that it is not so",
                name=str(body),
                suggestion="P(X) and not P(X) can",
            )
        return literal
    if body.connective == IMPLIES:
        condition, consequence = body.parts
        return Joined(AND, (condition, opposite(consequence)))
    other = OR if body.connective == AND else AND
    return Joined(other, tuple(map(opposite, body.parts)))


def _without_implies(body: Tree) -> Tree:
    if isinstance(body, Literal):
        return body
    if body.connective == IMPLIES:
        condition, consequence = body.parts
        body = Joined(OR, (opposite(condition), consequence))
    return Joined(body.connective, tuple(map(_without_implies, body.parts)))


def _count(body: Tree) -> int:
    if isinstance(body, Literal):
        return 1
    counts = map(_count, body.parts)
    return math.prod(counts) if body.connective == AND else sum(counts)


def _ways(body: Tree) -> Iterator[tuple[Literal, ...]]:
    if isinstance(body, Literal):
        yield (body,)
    elif body.connective == AND:
        for chosen in itertools.product(*(list(_ways(part)) for part in body.parts)):
            yield tuple(literal for way in chosen for literal in way)
    else:
        for part in body.parts:
            yield from _ways(part)
