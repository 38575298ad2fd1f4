"""What a search through a scene holds, so that a literal can take part in it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Protocol

from sfol.facts import TRUE, Bound
from sfol.syntax import Atom

Constants = tuple[str, ...]
Row = tuple[Constants, Bound]
Rows = Mapping[Constants, Bound]


class Scene(Protocol):
    """The known atoms of a scene."""

    def bound(self, atom: Atom) -> Bound | None:
        """Return the bound of a ground atom, or None if it is unknown."""
        ...

    def rows(self, predicate: str) -> Rows:
        """Return all known atoms of a predicate: arguments → bound."""
        ...

    def rows_with(self, predicate: str, position: int, constant: str) -> Iterable[Row]:
        """Return the known atoms that have a constant at a position."""
        ...


class Search:
    """One run of a plan over a scene.

    Attributes:
        scene: its known atoms.
        values: the constant in each slot of the plan; variables first, then the rule's constants.
        keys: the ground arguments of each literal that stands for an atom, where it is matched.
        bounds: the bound of each of them, where it is matched.
        visit: called for every substitution that satisfies the body.
    """

    __slots__ = ("bounds", "keys", "scene", "values", "visit")

    def __init__(
        self, scene: Scene, values: list[str], atoms: int, visit: Callable[[Search], None]
    ) -> None:
        self.scene = scene
        self.values = values
        self.keys: list[Constants] = [()] * atoms
        self.bounds: list[Bound] = [TRUE] * atoms
        self.visit = visit


# A step of a plan: calls the next one for every way in which its literal can hold.
Step = Callable[[Search], None]
Make = Callable[[Step], Step]
