"""What a search through a scene holds, so that a literal can take part in it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Protocol

from sfol.facts import TRUE, Bound
from sfol.syntax import ANONYMOUS, Atom

Constants = tuple[str, ...]
Row = tuple[Constants, Bound]
Rows = Mapping[Constants, Bound]

WORK_LIMIT = 2_000_000  # some two seconds


class Scene(Protocol):
    """The known atoms of a scene."""

    def bound(self, atom: Atom) -> Bound | None:
        """Return the bound of a ground atom, or None if it is unknown."""
        ...

    def value(self, atom: Atom) -> float | None:
        """Return the value that a ground comparison is of, or None if there is none."""
        ...

    def rows(self, predicate: str) -> Rows:
        """Return all known atoms of a predicate: arguments → bound."""
        ...

    def rows_with(self, predicate: str, position: int, constant: str) -> Collection[Row]:
        """Return the known atoms that have a constant at a position."""
        ...


def matching(scene: Scene, pattern: Atom) -> Collection[Row]:
    """Return the known atoms that a ground pattern stands for, as ``Near(p1, _)`` does."""
    fixed = [(i, constant) for i, constant in enumerate(pattern.arguments) if constant != ANONYMOUS]
    if not fixed:
        return scene.rows(pattern.predicate).items()
    rows = scene.rows_with(pattern.predicate, *fixed[0])
    if len(fixed) == 1:
        return rows
    return [row for row in rows if all(row[0][i] == constant for i, constant in fixed)]


def greatest(rows: Iterable[Row]) -> Bound | None:
    """Return the greatest lower and the greatest upper bound of atoms; None if there are none."""
    bounds = [bound for _, bound in rows]
    if not bounds:
        return None
    return Bound(max(bound.lower for bound in bounds), max(bound.upper for bound in bounds))


class Search:
    """One run of a plan over a scene.

    Attributes:
        scene: its known atoms.
        values: the constant in each slot of the plan; variables first, then the rule's constants.
        keys: the ground arguments of each literal that stands for an atom, where it is matched.
        bounds: the bound of each of them, where it is matched.
        visit: called for every substitution that satisfies the body.
        left: how many more known atoms may be looked at; a step that looks through some takes
            them off beforehand, and raises `ExhaustedError` if there are none left.
    """

    __slots__ = ("bounds", "keys", "left", "scene", "values", "visit")

    def __init__(
        self,
        scene: Scene,
        values: list[str],
        atoms: int,
        visit: Callable[[Search], None],
        limit: int = WORK_LIMIT,
    ) -> None:
        self.scene = scene
        self.values = values
        self.keys: list[Constants] = [()] * atoms
        self.bounds: list[Bound] = [TRUE] * atoms
        self.visit = visit
        self.left = limit


class ExhaustedError(Exception):
    """A search has looked at as many atoms as it may."""


# A step of a plan: calls the next one for every way in which its literal can hold.
Step = Callable[[Search], None]
Make = Callable[[Step], Step]
