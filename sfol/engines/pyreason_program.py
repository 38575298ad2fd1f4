"""A PyReason program as plain data: what the engine writes and the runtime runs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from sfol.facts import Bound
from sfol.literals import QueryClause
from sfol.literals.search import Constants
from sfol.syntax import Atom


class Query(NamedTuple):
    """One PyReason rule.

    Attributes:
        rule: the name of the knowledge base's rule that it is, or is a part of.
        head: with a predicate of its own.
        body: clauses of one term first, so that PyReason has no reason to reorder them.
        conjunction: the name of the annotation function.
    """

    rule: str
    head: Atom
    body: tuple[QueryClause, ...]
    conjunction: str

    @property
    def name(self) -> str:
        """What PyReason calls it in its trace."""
        return f"{self.rule}: {self.head}"

    @property
    def predicate(self) -> str:
        """The predicate of the knowledge base that it concludes."""
        return self.head.predicate.partition(".")[0]

    def __str__(self) -> str:
        return f"{self.head} : {self.conjunction} <- {', '.join(map(str, self.body))}"


@dataclass(frozen=True)
class Script:
    """A PyReason program: a graph by its nodes and facts, and rules.

    Attributes:
        nodes: every constant.
        facts: what is known, complements of negated predicates among it.
        queries: the rules.
    """

    nodes: tuple[str, ...]
    facts: Mapping[Atom, Bound]
    queries: tuple[Query, ...]


class TraceRow(NamedTuple):
    """One derivation in PyReason's own trace.

    Attributes:
        rule: the rule's name.
        head: what it concluded.
        bound: with which bound; PyReason leaves out a conclusion of [0, 1].
        clauses: for each clause of its body, the atoms that satisfied it.
    """

    rule: str
    head: Atom
    bound: Bound
    clauses: tuple[tuple[str, tuple[Atom, ...]], ...]

    def __str__(self) -> str:
        atoms = "; ".join(", ".join(map(str, found)) for _, found in self.clauses)
        return f"{self.rule}: {self.head} {self.bound} from {atoms}"


def joined(
    relations: Sequence[tuple[Sequence[str], Iterable[Constants]]],
    values: Mapping[str, str] | None = None,
) -> Iterator[dict[str, str]]:
    """Yield every way to give names values such that each relation has a row of them.

    Args:
        relations: the names of each relation's columns, and its rows.
        values: names that have a value already.
    """
    values = dict(values or {})
    if not relations:
        yield values
        return
    (names, rows), *others = relations
    for row in rows:
        more = dict(zip(names, row, strict=True))
        # The second condition is for a name that stands twice.
        if all(values.get(name, value) == value for name, value in more.items()) and (
            tuple(more[name] for name in names) == tuple(row)
        ):
            yield from joined(others, {**values, **more})
