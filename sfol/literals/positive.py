"""Positive literals: ``P(X)``, ``P(X) >= 0.5``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

from sfol.arrays import Array
from sfol.facts import Bound
from sfol.literals.literal import (
    AtomLiteral,
    BatchBounds,
    Literal,
    QueryClause,
    Reading,
    Thresholds,
    queried,
)
from sfol.literals.search import Rows, Scene
from sfol.operators import least
from sfol.syntax import ANONYMOUS, Atom, Reader
from sfol.temporal import read_pattern


@dataclass(frozen=True)
class Positive(AtomLiteral):
    """An atom that must be known, possible, and certain enough.

    It has the bound of its atom, and holds if the upper bound is above 0 and the lower bound
    reaches the rule's threshold, and its own minimum.
    """

    binds: ClassVar[bool] = True

    atom: Atom
    minimum: float = 0.0

    @classmethod
    def parse(cls, reader: Reader) -> Self | None:
        atom = read_pattern(reader)
        return cls(atom, reader.share() if reader.accept(">=") else 0.0)

    def __str__(self) -> str:
        if not self.minimum:
            return str(self.atom)
        return f"{self.atom} >= {repr(self.minimum).removesuffix('.0')}"

    def substituted(self, values: Mapping[str, str]) -> Self:
        return type(self)(self.atom.substituted(values), self.minimum)

    def named_apart(self, names: Iterator[str]) -> Self:
        arguments = (next(names) if term == ANONYMOUS else term for term in self.atom.arguments)
        return type(self)(Atom(self.atom.predicate, tuple(arguments)), self.minimum)

    def matched(self, target: Literal, values: Mapping[str, str]) -> Mapping[str, str] | None:
        if not isinstance(target, Positive) or self.minimum > target.minimum:
            return None
        return self.atom.matched(target.atom, values)

    def bound(self, known: Bound | None) -> Bound | None:
        return known

    def holds(self, thresholds: Thresholds) -> Reading:
        enough = least(self.threshold(thresholds))
        return lambda known: known if known[1] > 0.0 and known[0] >= enough else None

    def reaches(self, confidence: float) -> Reading:
        enough, minimum = least(confidence), least(self.minimum)
        if not minimum:
            return lambda known: known if known.midpoint >= enough else None
        return lambda known: known if known.midpoint >= enough and known.lower >= minimum else None

    def threshold(self, thresholds: Thresholds) -> float:
        """Return the least lower bound with which it holds in a rule."""
        return max(thresholds.threshold, self.minimum)

    def refutation(self, scene: Scene, thresholds: Thresholds) -> str:
        bound = scene.bound(self.atom)
        if bound is None:
            return str(self)
        value = scene.value(self.atom)
        if bound.upper == 0.0:
            return f"{self} ({'known to be false' if value is None else f'it is {value:.6g}'})"
        threshold = self.threshold(thresholds)
        if bound.lower < least(threshold):
            return f"{self} (its {bound} is below the threshold {threshold:.4g})"
        return f"{self} together with the rest"

    def batch_bounds(self, atoms: BatchBounds, rows: Array) -> tuple[Array, Array]:
        return atoms.lower(rows), atoms.upper(rows)

    def batch_holds(self, atoms: BatchBounds, rows: Array, thresholds: Thresholds) -> Array:
        possible = atoms.possible(rows)
        # Every literal of every batch comes here, and most ask for nothing themselves.
        asked = self.threshold(thresholds) if self.minimum else thresholds.threshold
        enough = least(asked, atoms.backend.tolerance)
        return possible & (atoms.lower(rows) >= enough) if enough > 0.0 else possible

    def query(self, thresholds: Thresholds) -> QueryClause:
        return QueryClause(
            queried(self.atom.predicate), self.terms, least(self.threshold(thresholds))
        )

    def query_rows(self, scene: Scene, domain: Sequence[str]) -> Rows:
        # PyReason would let an atom that is known to be false pass at threshold 0.
        rows = scene.rows(self.atom.predicate).items()
        return {arguments: bound for arguments, bound in rows if bound.upper > 0}
