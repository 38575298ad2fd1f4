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
    queried,
)
from sfol.literals.positive import Positive
from sfol.literals.search import (
    Constants,
    ExhaustedError,
    Rows,
    Scene,
    Search,
    Step,
    greatest,
    matching,
)
from sfol.operators import least, negation
from sfol.syntax import ANONYMOUS, Atom, Reader
from sfol.temporal import read_pattern

# PyReason has no predicate without arguments: this variable can be one entity alone.
_WHOEVER = f"{ANONYMOUS}whoever"


@dataclass(frozen=True)
class Negated(AtomLiteral):
    """An atom that must be unknown, or false enough.

    It has the bound [1, 1] if its atom is unknown, else [1 − u, 1 − l], and holds if that lower
    bound reaches the rule's negation threshold. Where it has ``_`` it speaks of all atoms at once,
    whatever stands there: u and l are then the greatest of those that are known.
    """

    monotone: ClassVar[bool] = False

    atom: Atom

    @classmethod
    def parse(cls, reader: Reader) -> Self | None:
        if reader.sees("(", ahead=1) or not reader.accept("not"):  # a predicate may be called not
            return None
        return cls(read_pattern(reader))

    def __str__(self) -> str:
        return f"not {self.atom}"

    @property
    def terms(self) -> tuple[str, ...]:
        """The variables and constants that it names; ``_`` names nothing."""
        return tuple(term for term in self.atom.arguments if term != ANONYMOUS)

    @classmethod
    def opposite_of(cls, literal: Literal) -> Literal | None:
        match literal:
            case Negated(atom):
                return Positive(atom)
            case Positive(atom, 0.0):
                return cls(atom)
        return None

    def substituted(self, values: Mapping[str, str]) -> Self:
        return type(self)(self.atom.substituted(values))

    def matched(self, target: Literal, values: Mapping[str, str]) -> Mapping[str, str] | None:
        return self.atom.matched(target.atom, values) if isinstance(target, Negated) else None

    def known(self, scene: Scene) -> Bound | None:
        if not self.atom.is_pattern:
            return scene.bound(self.atom)
        return greatest(matching(scene, self.atom))

    def bound(self, known: Bound | None) -> Bound:
        return TRUE if known is None else negation(known)

    def holds(self, thresholds: Thresholds) -> Reading:
        enough = least(thresholds.negation_threshold)
        return lambda known: negation(known) if 1.0 - known[1] >= enough else None

    def reaches(self, confidence: float) -> Reading:
        enough = least(confidence)
        return lambda known: negation(known) if 1.0 - known.midpoint >= enough else None

    def step(self, number: int, slots: Mapping[str, int], criterion: Criterion, then: Step) -> Step:
        if self.atom.is_pattern:
            return self._step_of_all(number, slots, criterion, then)
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

    def _step_of_all(
        self, number: int, slots: Mapping[str, int], criterion: Criterion, then: Step
    ) -> Step:
        predicate, reading = self.atom.predicate, criterion(self)
        places = [slots.get(term) for term in self.atom.arguments]

        def step(search: Search) -> None:
            key = tuple([ANONYMOUS if slot is None else search.values[slot] for slot in places])
            rows = matching(search.scene, Atom(predicate, key))
            search.left -= len(rows)
            if search.left < 0:
                raise ExhaustedError
            known = greatest(rows)
            bound = TRUE if known is None else reading(known)
            if bound is not None:
                search.keys[number] = key
                search.bounds[number] = bound
                then(search)

        return step

    def refutation(self, scene: Scene, thresholds: Thresholds) -> str:
        value = scene.value(self.atom)
        return f"{self} (it is {self.known(scene) if value is None else f'{value:.6g}'})"

    def batch_bounds(self, atoms: BatchBounds, rows: Array) -> tuple[Array, Array]:
        where, known = atoms.backend.where, atoms.known(rows)
        lower = where(known, 1.0 - atoms.upper(rows), 1.0)
        return lower, where(known, 1.0 - atoms.lower(rows), 1.0)

    def batch_holds(self, atoms: BatchBounds, rows: Array, thresholds: Thresholds) -> Array:
        lower = atoms.backend.where(atoms.known(rows), 1.0 - atoms.upper(rows), 1.0)
        return lower >= least(thresholds.negation_threshold, atoms.backend.tolerance)

    def query(self, thresholds: Thresholds) -> QueryClause:
        # PyReason's own negation fails on unknown atoms, so it reads a predicate of its own.
        where = [f".{i}" for i, term in enumerate(self.atom.arguments) if term == ANONYMOUS]
        name = f"not.{queried(self.atom.predicate)}{''.join(where)}"
        return QueryClause(name, self.terms or (_WHOEVER,), least(thresholds.negation_threshold))

    def query_rows(self, scene: Scene, domain: Sequence[str]) -> Rows:
        if not self.terms:
            return {(domain[0],): self.bound(self.known(scene))}
        rows: dict[Constants, Bound] = {}
        places = [i for i, term in enumerate(self.atom.arguments) if term != ANONYMOUS]
        for constants in itertools.product(domain, repeat=len(places)):
            arguments = list(self.atom.arguments)
            for place, constant in zip(places, constants, strict=True):
                arguments[place] = constant
            ground = type(self)(Atom(self.atom.predicate, tuple(arguments)))
            rows[constants] = self.bound(ground.known(scene))
        return rows
