"""Negated literals: ``not P(X)``."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

from sfol.arrays import Array
from sfol.facts import TRUE, Bound
from sfol.literals.literal import (
    AtomLiteral,
    BatchBounds,
    Criterion,
    Literal,
    QueryClause,
    Reading,
    Thresholds,
)
from sfol.literals.search import Rows, Scene, Search, Step
from sfol.operators import least, negation
from sfol.syntax import Atom, Reader


@dataclass(frozen=True)
class Negated(AtomLiteral):
    """An atom that must be unknown, or false enough.

    It has the bound [1, 1] if its atom is unknown, else [1 − u, 1 − l], and holds if that lower
    bound reaches the rule's negation threshold.
    """

    monotone: ClassVar[bool] = False

    atom: Atom

    @classmethod
    def parse(cls, reader: Reader) -> Self | None:
        if reader.sees("(", ahead=1) or not reader.accept("not"):  # a predicate may be called not
            return None
        return cls(reader.atom())

    def __str__(self) -> str:
        return f"not {self.atom}"

    def substituted(self, values: Mapping[str, str]) -> Self:
        return type(self)(self.atom.substituted(values))

    def matched(self, target: Literal, values: Mapping[str, str]) -> Mapping[str, str] | None:
        return self.atom.matched(target.atom, values) if isinstance(target, Negated) else None

    def bound(self, known: Bound | None) -> Bound:
        return TRUE if known is None else negation(known)

    def holds(self, thresholds: Thresholds) -> Reading:
        enough = least(thresholds.negation_threshold)
        return lambda known: negation(known) if 1.0 - known[1] >= enough else None

    def reaches(self, confidence: float) -> Reading:
        enough = least(confidence)
        return lambda known: negation(known) if 1.0 - known.midpoint >= enough else None

    def step(self, number: int, slots: Mapping[str, int], criterion: Criterion, then: Step) -> Step:
        predicate, reading, key_of = self.atom.predicate, criterion(self), self.atom.key(slots)

        def step(search: Search) -> None:
            key = key_of(search.values)
            known = search.scene.rows(predicate).get(key)
            bound = TRUE if known is None else reading(known)
            if bound is not None:
                search.keys[number] = key
                search.bounds[number] = bound
                then(search)

        return step

    def refutation(self, scene: Scene, thresholds: Thresholds) -> str:
        return f"{self} (it is {scene.bound(self.atom)})"

    def batch_bounds(self, atoms: BatchBounds, rows: Array) -> tuple[Array, Array]:
        where, known = atoms.backend.where, atoms.known(rows)
        lower = where(known, 1.0 - atoms.upper(rows), 1.0)
        return lower, where(known, 1.0 - atoms.lower(rows), 1.0)

    def batch_holds(self, atoms: BatchBounds, rows: Array, thresholds: Thresholds) -> Array:
        lower = atoms.backend.where(atoms.known(rows), 1.0 - atoms.upper(rows), 1.0)
        return lower >= least(thresholds.negation_threshold, atoms.backend.tolerance)

    def query(self, thresholds: Thresholds) -> QueryClause:
        # PyReason's own negation fails on unknown atoms, so it reads a predicate of its own.
        return QueryClause(
            f"not.{self.atom.predicate}", self.terms, least(thresholds.negation_threshold)
        )

    def query_rows(self, scene: Scene, domain: Sequence[str]) -> Rows:
        rows = scene.rows(self.atom.predicate)
        return {
            arguments: self.bound(rows.get(arguments))
            for arguments in itertools.product(domain, repeat=len(self.terms))
        }
