"""Counts: ``count(P: Pedestrian(P), OnRoad(P)) >= 2``, ``exists(P: Near(P, X))``."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Self

from sfol.errors import ClauseError
from sfol.literals.literal import Literal, Thresholds
from sfol.literals.positive import Positive
from sfol.literals.quantified import (
    COUNT,
    EXISTS,
    Quantified,
    begins,
    bound_inside,
    check_not_negated,
    read_literals,
    read_quantified,
)
from sfol.literals.search import Row, Scene, matching
from sfol.syntax import ANONYMOUS, Atom, Reader, variables

MAXIMUM_COUNT = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Count(Quantified):
    """That at least so many entities, or groups of entities, satisfy literals.

    Attributes:
        counted: what each must satisfy.
        minimum: how many there must be, 1 or more.
    """

    counted: tuple[Literal, ...]
    minimum: int = 1

    @classmethod
    def parse(cls, reader: Reader) -> Self | None:
        check_not_negated(reader, (COUNT, EXISTS), "a count")
        if not begins(reader, (COUNT, EXISTS)):
            return None
        exists = reader.accept(EXISTS) or not reader.accept(COUNT)
        quantified = read_quantified(reader)
        literals = read_literals(reader, "a count")
        minimum = 1 if exists else _minimum(reader)
        return cls(quantified, counted=literals, minimum=minimum)

    def __str__(self) -> str:
        inside = f"{self._beginning}{', '.join(map(str, self.literals))})"
        return f"{EXISTS}{inside}" if self.minimum == 1 else f"{COUNT}{inside} >= {self.minimum}"

    @property
    def literals(self) -> tuple[Literal, ...]:
        return self.counted

    @property
    def needed(self) -> tuple[Literal, ...]:
        return self.counted

    def with_literals(self, change: Callable[[Literal], Literal]) -> Self:
        return replace(self, counted=tuple(map(change, self.counted)))

    def _covers(self, target: Quantified) -> bool:
        return (
            isinstance(target, Count)
            and self.minimum <= target.minimum
            and len(self.counted) == len(target.counted)
        )

    def faults(self) -> Iterator[tuple[str, str, str]]:
        yield from super().faults()
        bound = bound_inside(self.counted)
        for name in self.named:
            if name not in bound:
                yield self._unbound(name)

    def never_holds(self) -> bool:
        return any(literal.never_holds() for literal in self.literals)


@dataclass(frozen=True, kw_only=True)
class Counted(Positive):
    """A count as engines see it: an atom that rules of its own conclude.

    Attributes:
        atom: its arguments are the shared variables of the count.
        count: what it stands for.
        each: the atom of one that counts: of the counted variables, then the shared ones.
    """

    count: Count
    each: Atom

    def __str__(self) -> str:
        return str(self.count)

    def substituted(self, values: Mapping[str, str]) -> Self:
        given = {name: value for name, value in values.items() if name not in self.count.quantified}
        return replace(
            self,
            atom=self.atom.substituted(given),
            count=self.count.substituted(given),
            each=self.each.substituted(given),
        )

    def named_apart(self, names: Iterator[str]) -> Self:
        return self

    def refutation(self, scene: Scene, thresholds: Thresholds) -> str:
        if scene.bound(self.atom) is not None or variables(*self.atom.arguments):
            return super().refutation(scene, thresholds)
        return f"{self} (it counts {len(self.ones(scene))})"

    def ones(self, scene: Scene) -> Collection[Row]:
        """Return the atoms of those that count, if its shared variables have values."""
        anyone = (ANONYMOUS,) * len(self.count.quantified)
        return matching(scene, Atom(self.each.predicate, (*anyone, *self.atom.arguments)))


def _minimum(reader: Reader) -> int:
    reader.expect(">=", "a count says how many there are at least: count(P: A(P)) >= 2")
    offset = reader.offset
    number = reader.number()
    if not (1 <= number <= MAXIMUM_COUNT and number.is_integer()):
        raise ClauseError(
            f"a count can't be at least {number:g}",
            name=f"{number:g}",
            suggestion=f"give a whole number from 1 to {MAXIMUM_COUNT}",
            offset=offset,
        )
    return int(number)
