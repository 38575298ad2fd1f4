"""Plans: how to find the substitutions that satisfy a body."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sfol.clauses import Body
from sfol.engines.matching import chained, makers, visit
from sfol.engines.support import Forest, Reduction, Support, grow
from sfol.engines.tables import Tables
from sfol.literals import Criterion, Search, Step
from sfol.literals.search import Constants
from sfol.syntax import Atom, is_variable, variables


@dataclass(frozen=True)
class Plan:
    """How to find the substitutions that satisfy a body.

    The body is compiled once into nested functions, one for each literal, of which each calls the
    next for every way in which it can hold.

    Attributes:
        body: the body itself.
        variables: its variables; those that are given beforehand come first.
        given: how many are.
    """

    body: Body
    variables: tuple[str, ...]
    given: int
    _constants: tuple[str, ...]
    _needed: frozenset[str]
    _first: Step
    _forest: Forest

    @classmethod
    def of(cls, body: Body, criterion: Criterion, given: Sequence[str] = ()) -> Plan:
        """Make the plan of a body.

        Args:
            body: what must hold; every variable stands in a literal that binds or in `given`.
            criterion: when its literals hold.
            given: variables that have a value beforehand.
        """
        names = tuple(dict.fromkeys([*given, *variables(*body.terms)]))
        constants = tuple(term for term in body.terms if not is_variable(term))
        slots = {term: slot for slot, term in enumerate((*names, *constants))}
        known = frozenset([*given, *constants])
        first = chained(makers(body, criterion, slots, known), visit)
        needed = frozenset(lit.atom.predicate for lit in body.atom_literals if lit.binds)
        forest = grow(body, criterion, slots, known)
        return cls(body, names, len(given), constants, needed, first, forest)

    def search(
        self, tables: Tables, visit: Callable[[Search], None], given: Sequence[str] = ()
    ) -> None:
        """Visit every substitution that satisfies the body.

        Args:
            tables: the scene.
            visit: is called with the search, whose values, keys and bounds are those of the
                substitution and change after the call.
            given: values of the variables that are given.
        """
        if tables.has_all(self._needed):
            self._first(Search(tables, self._values(given), len(self.body.atom_literals), visit))

    @property
    def branches(self) -> bool:
        """Whether the body falls apart, so that `support` does less than `search`."""
        return self._forest.branches

    def support(self, tables: Tables, given: Sequence[str] = ()) -> Support:
        """Return what `search` finds, all substitutions together.

        For a body without cycles its cost grows with the facts and not with the substitutions.

        Args:
            tables: the scene.
            given: values of the variables that are given.

        Returns:
            A literal's index and the arguments of an atom that stands for it in some substitution
            that satisfies the body → its bound; empty if there is no such substitution.
        """
        if not tables.has_all(self._needed):
            return {}
        return self._forest.support(
            Reduction(tables, self._values(given), len(self.body.atom_literals))
        )

    def _values(self, given: Sequence[str]) -> list[str]:
        return [*given, *("",) * (len(self.variables) - self.given), *self._constants]

    def reader(self, atom: Atom) -> Callable[[Search], Constants]:
        """Return the function that reads an atom's ground arguments off a search.

        Args:
            atom: its variables are the plan's; any other term is a constant.
        """
        slots = {term: slot for slot, term in enumerate(self.variables)}
        places = [(slots.get(term), term) for term in atom.arguments]
        return lambda search: tuple(
            [term if slot is None else search.values[slot] for slot, term in places]
        )

    def substitutions(self, tables: Tables, given: Sequence[str] = ()) -> list[dict[str, str]]:
        """Return every substitution of variables by constants that satisfies the body."""
        found: list[dict[str, str]] = []
        names = self.variables
        self.search(tables, lambda s: found.append(dict(zip(names, s.values, strict=False))), given)
        return found
