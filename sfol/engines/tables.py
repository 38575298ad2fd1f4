"""The known atoms of a scene, as a search reads them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

from sfol.comparisons import compared_rows
from sfol.errors import FactError
from sfol.facts import TRUE, Bound, Facts, Relation, Values
from sfol.literals.search import Constants, Row
from sfol.syntax import Atom, Compared

_EMPTY: Relation = {}
_NO_VALUES: Values = {}


class Tables:
    """The known atoms of one scene by predicate, with indices by argument made when needed."""

    __slots__ = ("_indices", "_relations", "_values")

    def __init__(
        self, relations: dict[str, dict[Constants, Bound]], values: Values = _NO_VALUES
    ) -> None:
        self._relations = relations
        self._values = values
        self._indices: dict[tuple[str, int], dict[str, list[Row]]] = {}

    @classmethod
    def of(
        cls,
        facts: Facts,
        background: Sequence[Atom] = (),
        comparisons: Sequence[Compared] = (),
    ) -> Tables:
        """Return the tables of some facts and of the background, which always holds.

        The facts are copied, so that conclusions do not change when the facts do.

        Args:
            facts: ground atoms with bounds, and values.
            background: atoms that always hold.
            comparisons: what is asked of values; here they become atoms with bounds.

        Raises:
            FactError: a fact gives an atom of the background another bound.
        """
        tables = cls({name: dict(relation) for name, relation in facts.relations().items()})
        if comparisons and (values := facts.values()):
            tables._compare(comparisons, {name: dict(known) for name, known in values.items()})
        for atom in background:
            bound = tables._relations.setdefault(atom.predicate, {}).setdefault(
                atom.arguments, TRUE
            )
            if bound != TRUE:
                raise FactError(
                    f"facts give {atom} the bound {bound}, but it always holds",
                    name=str(atom),
                    suggestion="leave it out: it stands in the knowledge base's background",
                )
        return tables

    def _compare(self, comparisons: Sequence[Compared], values: Values) -> None:
        self._values = values
        for predicate in comparisons:
            if predicate not in self._relations and (rows := compared_rows(predicate, values)):
                self._relations[predicate] = rows

    def value(self, atom: Atom) -> float | None:
        """Return the value that a ground comparison is of, or None if there is none."""
        if not isinstance(atom.predicate, Compared):
            return None
        return self._values.get(atom.predicate.attribute, {}).get(atom.arguments)

    def bound(self, atom: Atom) -> Bound | None:
        """Return the bound of a ground atom, or None if it is unknown."""
        return self._relations.get(atom.predicate, _EMPTY).get(atom.arguments)

    def entities(self) -> set[str]:
        """Return every constant that some known atom names."""
        return {
            constant
            for relation in self._relations.values()
            for arguments in relation
            for constant in arguments
        }

    def has_all(self, predicates: frozenset[str]) -> bool:
        """Tell whether something is known of every one of these predicates."""
        return predicates <= self._relations.keys()

    def rows(self, predicate: str) -> Relation:
        """Return all known atoms of a predicate: arguments → bound."""
        return self._relations.get(predicate, _EMPTY)

    def rows_with(self, predicate: str, position: int, constant: str) -> Collection[Row]:
        """Return the known atoms that have a constant at a position."""
        index = self._indices.get((predicate, position))
        if index is None:
            index = self._indices[predicate, position] = {}
            for row in self.rows(predicate).items():
                index.setdefault(row[0][position], []).append(row)
        return index.get(constant, ())

    def items(self) -> Iterator[tuple[Atom, Bound]]:
        """Yield every known atom with its bound."""
        for predicate, relation in self._relations.items():
            for arguments, bound in relation.items():
                yield Atom(predicate, arguments), bound

    def extended(self, conclusions: Mapping[Atom, Bound]) -> Tables:
        """Return what is known with conclusions, or greater bounds, added; this stays as it is."""
        tables = Tables({**self._relations})
        tables._indices = {**self._indices}
        for predicate in {atom.predicate for atom in conclusions}:
            tables._relations[predicate] = {**self.rows(predicate)}
        tables.revise(conclusions)
        return tables

    def without(self, predicates: Collection[str]) -> Tables:
        """Return what is known of all other predicates."""
        tables = Tables({k: rows for k, rows in self._relations.items() if k not in predicates})
        tables._indices = {key: i for key, i in self._indices.items() if key[0] not in predicates}
        return tables

    def revise(self, conclusions: Mapping[Atom, Bound]) -> None:
        """Add conclusions, or greater bounds of them, of predicates that were read before."""
        for atom, bound in conclusions.items():
            self.put(atom, bound)
        revised = {atom.predicate for atom in conclusions}
        self._indices = {key: i for key, i in self._indices.items() if key[0] not in revised}

    def put_all(self, predicate: str, rows: dict[Constants, Bound]) -> None:
        """Make rows all that is known of a predicate, which has no index yet."""
        self._relations[predicate] = rows

    def put(self, atom: Atom, bound: Bound) -> None:
        """Add a conclusion. No index of its predicate exists yet: strata go in order."""
        self._relations.setdefault(atom.predicate, {})[atom.arguments] = bound
