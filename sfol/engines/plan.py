"""Plans: how to find the substitutions that satisfy a body."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

from sfol.clauses import Body
from sfol.engines.flat import Flat
from sfol.engines.matching import chained, makers, visit
from sfol.engines.support import Forest, Reduction, Support, grow
from sfol.engines.tables import Tables
from sfol.errors import WorkLimitError
from sfol.facts import Bound
from sfol.literals import Criterion, Search, Step
from sfol.literals.search import WORK_LIMIT, Constants, ExhaustedError
from sfol.syntax import Atom, is_anonymous, is_variable, variables

_Found = TypeVar("_Found")


@dataclass(frozen=True)
class Plan:
    """How to find the substitutions that satisfy a body.

    The body is compiled once into nested functions, one for each literal, of which each calls the
    next for every way in which it can hold.

    Attributes:
        body: the body itself.
        variables: its variables; those that are given beforehand come first.
        given: how many are.
        owner: what the body belongs to, for error messages.
        limit: how many known atoms a search may look at.
    """

    body: Body
    variables: tuple[str, ...]
    given: int
    owner: str
    limit: int
    _constants: tuple[str, ...]
    _needed: frozenset[str]
    _first: Step
    _forest: Forest
    _flat: Flat | None

    @classmethod
    def of(
        cls,
        body: Body,
        criterion: Criterion,
        given: Sequence[str] = (),
        *,
        owner: str = "a body",
        limit: int = WORK_LIMIT,
    ) -> Plan:
        """Make the plan of a body.

        Args:
            body: what must hold; every variable stands in a literal that binds or in `given`.
            criterion: when its literals hold.
            given: variables that have a value beforehand.
            owner: see `Plan`.
            limit: see `Plan`.
        """
        names = tuple(dict.fromkeys([*given, *variables(*body.terms)]))
        constants = tuple(term for term in body.terms if not is_variable(term))
        slots = {term: slot for slot, term in enumerate((*names, *constants))}
        known = frozenset([*given, *constants])
        first = chained(makers(body, criterion, slots, known), visit)
        needed = frozenset(lit.atom.predicate for lit in body.atom_literals if lit.binds)
        forest = grow(body, criterion, slots, known)
        flat = Flat.of(body, criterion, slots, known)
        return cls(body, names, len(given), owner, limit, constants, needed, first, forest, flat)

    def search(
        self, tables: Tables, visit: Callable[[Search], None], given: Sequence[str] = ()
    ) -> None:
        """Visit every substitution that satisfies the body.

        Args:
            tables: the scene.
            visit: is called with the search, whose values, keys and bounds are those of the
                substitution and change after the call.
            given: values of the variables that are given.

        Raises:
            WorkLimitError: more atoms had to be looked at than the limit allows.
        """
        if not tables.has_all(self._needed):
            return
        literals = len(self.body.atom_literals)
        try:
            self._first(Search(tables, self._values(given), literals, visit, self.limit))
        except ExhaustedError:
            raise self.too_much(tables) from None

    @property
    def is_flat(self) -> bool:
        """Whether one loop finds all atoms, so that `bounds` does what `search` does, faster."""
        return self._flat is not None

    def bounds(self, tables: Tables, given: Sequence[str] = ()) -> Sequence[Bound]:
        """Return the bounds of a flat body's atoms, over all substitutions that satisfy it.

        An atom that stands for two literals is there twice; there are none if no substitution
        satisfies the body.

        Raises:
            WorkLimitError: see `search`.
        """
        assert self._flat is not None, "asked only of flat bodies"
        if not tables.has_all(self._needed):
            return ()
        try:
            return self._flat.bounds(tables, self._values(given), self.limit)
        except ExhaustedError:
            raise self.too_much(tables) from None

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

        Raises:
            WorkLimitError: see `search`.
        """
        return self._reduced(self._forest.support, tables, given, {})

    def holds(self, tables: Tables, given: Sequence[str] = ()) -> bool:
        """Tell whether some substitution satisfies the body, at the cost of `support`.

        Raises:
            WorkLimitError: see `search`.
        """
        return self._reduced(self._forest.holds, tables, given, False)

    def _reduced(
        self,
        of: Callable[[Reduction], _Found],
        tables: Tables,
        given: Sequence[str],
        nothing: _Found,
    ) -> _Found:
        if not tables.has_all(self._needed):
            return nothing
        literals = len(self.body.atom_literals)
        try:
            return of(Reduction(tables, self._values(given), literals, self.limit))
        except ExhaustedError:
            raise self.too_much(tables) from None

    def too_much(self, tables: Tables) -> WorkLimitError:
        """Return the error of a search that has reached the limit."""
        entities = sorted(tables.entities())
        shown = ", ".join(entities[:5]) + (", …" if len(entities) > 5 else "")
        return WorkLimitError(
            f"{self.owner} has too many substitutions among {len(entities)} entities ({shown}): "
            f"after {self.limit:,} atoms the search for them was given up",
            name=self.owner,
            suggestion="let its literals share variables, give fewer entities, or raise the limit: "
            "RewardFunction(…, work_limit=…)",
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

    def substitutions(
        self, tables: Tables, given: Sequence[str] = (), *, most: int | None = None
    ) -> list[dict[str, str]]:
        """Return distinct substitutions of named variables by constants that satisfy the body.

        Args:
            tables: the scene.
            given: values of the variables that are given.
            most: how many to look for, as examples: at the limit of the search the rest is left
                out. All by default.

        Raises:
            WorkLimitError: see `search`; only if all are looked for.
        """
        found: dict[Constants, None] = {}
        slots = [slot for slot, name in enumerate(self.variables) if not is_anonymous(name)]
        names = [self.variables[slot] for slot in slots]

        def keep(search: Search) -> None:
            found[tuple([search.values[slot] for slot in slots])] = None
            if len(found) == most:
                raise _EnoughError

        with suppress(_EnoughError, *([] if most is None else [WorkLimitError])):
            self.search(tables, keep, given)
        return [dict(zip(names, values, strict=True)) for values in found]


class _EnoughError(Exception):
    """As many substitutions were found as were asked for."""
