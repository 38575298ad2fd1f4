"""Statements about all: ``forall(P: Pedestrian(P), OnRoad(P))(not Near(P, X))``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

from sfol.arrays import Array
from sfol.facts import TRUE
from sfol.literals.literal import BatchBounds, Literal, Reading, Thresholds
from sfol.literals.negated import Negated
from sfol.literals.positive import Positive
from sfol.literals.quantified import (
    FORALL,
    Quantified,
    begins,
    bound_inside,
    check_not_negated,
    read_literals,
    read_quantified,
)
from sfol.literals.search import Row, Scene, matching
from sfol.syntax import Reader


@dataclass(frozen=True, kw_only=True)
class ForAll(Quantified):
    """That all entities, or groups of entities, that satisfy some literals satisfy others.

    Attributes:
        guard: what says of whom it speaks.
        body: what each of these must satisfy.
    """

    monotone: ClassVar[bool] = False

    guard: tuple[Literal, ...]
    body: tuple[Literal, ...]

    @classmethod
    def parse(cls, reader: Reader) -> Self | None:
        check_not_negated(reader, (FORALL,), "a forall")
        if not begins(reader, (FORALL,)):
            return None
        reader.expect(FORALL)
        quantified = read_quantified(reader)
        guard = read_literals(reader, "a forall")
        reader.expect("(", "what holds of all stands behind: forall(P: A(P))(B(P))")
        return cls(quantified, guard=guard, body=read_literals(reader, "a forall"))

    def __str__(self) -> str:
        guard, body = (", ".join(map(str, part)) for part in (self.guard, self.body))
        return f"{FORALL}{self._beginning}{guard})({body})"

    @property
    def literals(self) -> tuple[Literal, ...]:
        return (*self.guard, *self.body)

    @property
    def needed(self) -> tuple[Literal, ...]:
        return ()  # it holds of nobody

    @property
    def against(self) -> tuple[Literal, ...]:
        return self.guard

    def with_literals(self, change: Callable[[Literal], Literal]) -> Self:
        guard = tuple(map(change, self.guard))
        return replace(self, guard=guard, body=tuple(map(change, self.body)))

    def _covers(self, target: Quantified) -> bool:
        return isinstance(target, ForAll) and (len(self.guard), len(self.body)) == (
            len(target.guard),
            len(target.body),
        )

    def matched(self, target: Literal, values: Mapping[str, str]) -> Mapping[str, str] | None:
        found = super().matched(target, values)
        # A guard that asks for less speaks of more, so that nothing but the same will do.
        return found if found is not None and self.substituted(found) == target else None

    def faults(self) -> Iterator[tuple[str, str, str]]:
        yield from super().faults()
        in_guard, in_body = (
            {term for literal in part for term in literal.terms} for part in (self.guard, self.body)
        )
        for name in self.named:
            through = name in self.quantified
            binding = self.guard if through or name in in_guard else self.body
            if name in self.shared:
                continue
            if not through and name in in_guard and name in in_body:
                yield (
                    name,
                    f"the variable '{name}' stands on both sides of '{self}', which does not go "
                    "through it",
                    f"name it before the colon: {FORALL}({', '.join((*self.quantified, name))}: …)",
                )
            elif name not in bound_inside(binding):
                yield self._unbound(name)


@dataclass(frozen=True)
class Ranging(Positive):
    """An atom that says over what variables range, and nothing else: it must be known.

    Where it is, it is [1, 1], which changes no minimum.
    """

    def holds(self, thresholds: Thresholds) -> Reading:
        return lambda known: TRUE

    def batch_bounds(self, atoms: BatchBounds, rows: Array) -> tuple[Array, Array]:
        certain = atoms.backend.where(atoms.known(rows), 1.0, 1.0)
        return certain, certain

    def batch_holds(self, atoms: BatchBounds, rows: Array, thresholds: Thresholds) -> Array:
        return atoms.known(rows)


@dataclass(frozen=True, kw_only=True)
class NoCounterexample(Negated):
    """A forall as engines see it: no atom of a counterexample, which a rule of its own concludes.

    Attributes:
        atom: ``_`` for each variable that the forall goes through, then the shared ones.
        forall: what it stands for.
        holding: the predicate of what the body comes to, of the same arguments.
    """

    forall: ForAll
    holding: str

    def __str__(self) -> str:
        return str(self.forall)

    def substituted(self, values: Mapping[str, str]) -> Self:
        given = {name: v for name, v in values.items() if name not in self.forall.quantified}
        return replace(
            self, atom=self.atom.substituted(given), forall=self.forall.substituted(given)
        )

    def refutation(self, scene: Scene, thresholds: Thresholds) -> str:
        worst = next(iter(self.counterexamples(scene)), None)
        if worst is None:
            return str(self)
        bound = self.bound(worst[1])
        values = zip(self.forall.quantified, worst[0], strict=False)
        named = ", ".join(f"{name} = {value}" for name, value in values)
        return f"{self} (it is {bound} for {named})"

    def counterexamples(self, scene: Scene) -> Sequence[Row]:
        """Return the atoms of those of whom it speaks, the worst first, with what they lack."""
        rows = matching(scene, self.atom)
        return sorted(rows, key=lambda row: (row[1].upper, row[1].lower), reverse=True)
