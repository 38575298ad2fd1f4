"""Counts: ``count(P: Pedestrian(P), OnRoad(P)) >= 2``, ``exists(P: Near(P, X))``."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Self

from sfol.errors import ClauseError
from sfol.literals.literal import Literal, Thresholds
from sfol.literals.negated import Negated
from sfol.literals.not_equal import NotEqual
from sfol.literals.positive import Positive
from sfol.literals.search import Row, Scene, matching
from sfol.syntax import ANONYMOUS, Atom, Reader, is_anonymous, is_variable, variables

MAXIMUM_COUNT = 1_000_000
_COUNT, _EXISTS = "count", "exists"
# An atom is what remains, as in a body; a count stands in no other.
_INSIDE: tuple[type[Literal], ...] = (Negated, NotEqual, Positive)


@dataclass(frozen=True)
class Count(Literal):
    """That at least so many entities, or groups of entities, satisfy literals.

    It has a bound, which takes part in the conjunction, but no atom. In the program that an engine
    runs, rules of their own conclude the bound, and a `Counted` stands in its place.

    Attributes:
        counted: the variables whose values are counted, all of them together.
        literals: what each must satisfy.
        minimum: how many there must be, 1 or more.
        shared: those of its variables that stand in other literals of the body as well, which say
            what they are; its other ones are known inside of it alone.
    """

    counted: tuple[str, ...]
    literals: tuple[Literal, ...]
    minimum: int = 1
    shared: tuple[str, ...] = ()

    # -- text -----------------------------------------------------------------------------------

    @classmethod
    def parse(cls, reader: Reader) -> Self | None:
        _check_not_negated(reader)
        if not _begins(reader):
            return None
        exists = reader.accept(_EXISTS) or not reader.accept(_COUNT)
        reader.expect("(")
        counted = [_counted(reader, [])]
        while reader.accept(","):
            counted.append(_counted(reader, counted))
        reader.expect(":")
        literals = [_literal(reader)]
        while reader.accept(","):
            literals.append(_literal(reader))
        reader.expect(")", "in a count literals are joined by commas alone: count(P: A(P), B(P))")
        return cls(tuple(counted), tuple(literals), 1 if exists else _minimum(reader))

    def __str__(self) -> str:
        inside = f"({', '.join(self.counted)}: {', '.join(map(str, self.literals))})"
        return f"{_EXISTS}{inside}" if self.minimum == 1 else f"{_COUNT}{inside} >= {self.minimum}"

    # -- terms ----------------------------------------------------------------------------------

    @property
    def terms(self) -> tuple[str, ...]:
        """The shared variables, and the constants that it names."""
        constants = (term for term in self._inside if not is_variable(term))
        return tuple(dict.fromkeys([*self.shared, *constants]))

    @property
    def _inside(self) -> tuple[str, ...]:
        return tuple(term for literal in self.literals for term in literal.terms)

    @property
    def local(self) -> frozenset[str]:
        """The variables that are known inside of it alone."""
        return frozenset(variables(*self.counted, *self._inside)).difference(self.shared)

    @property
    def atoms(self) -> tuple[Atom, ...]:
        return tuple(atom for literal in self.literals for atom in literal.atoms)

    def within(self, outside: Collection[str]) -> Self:
        """Return the count as it is beside other literals, given the terms that these name."""
        named = variables(*self.counted, *self._inside)
        shared = (name for name in named if name in outside and not is_anonymous(name))
        return replace(self, shared=tuple(shared))

    def named_apart(self, names: Iterator[str]) -> Self:
        return replace(self, literals=tuple(lit.named_apart(names) for lit in self.literals))

    def substituted(self, values: Mapping[str, str]) -> Self:
        given = {name: value for name, value in values.items() if name not in self.local}
        shared = variables(*(given.get(name, name) for name in self.shared))
        literals = tuple(literal.substituted(given) for literal in self.literals)
        return replace(self, literals=literals, shared=shared)

    def matched(self, target: Literal, values: Mapping[str, str]) -> Mapping[str, str] | None:
        """Return the substitution; names that are known inside alone must be the same in both."""
        if not isinstance(target, Count) or self.minimum > target.minimum:
            return None
        same = (self.counted, self.local) == (target.counted, target.local)
        if not same or len(self.literals) != len(target.literals):
            return None
        extended: Mapping[str, str] | None = {**values, **{name: name for name in self.local}}
        for mine, theirs in zip(self.literals, target.literals, strict=True):
            extended = None if extended is None else mine.matched(theirs, extended)
        if extended is None:
            return None
        return {name: value for name, value in extended.items() if name not in self.local}

    def faults(self) -> Iterator[tuple[str, str, str]]:
        for name in self.counted:
            if name in self.shared:
                yield (
                    name,
                    f"the variable '{name}' is counted by '{self}' and stands outside of it",
                    "call one of the two differently",
                )
        binding = (literal.terms for literal in self.literals if literal.binds)
        bound = {term for terms in binding for term in terms}
        for name in variables(*self.counted, *self._inside):
            if name not in bound:
                yield (
                    name,
                    f"the variable '{name}' stands in no positive literal inside of '{self}'",
                    f"add a literal such as Predicate({name}) there, or rename the variable",
                )

    def never_holds(self) -> bool:
        return any(literal.never_holds() for literal in self.literals)

    def refutation(self, scene: Scene, thresholds: Thresholds) -> str:
        return str(self)


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
        given = {name: value for name, value in values.items() if name not in self.count.counted}
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
        anyone = (ANONYMOUS,) * len(self.count.counted)
        return matching(scene, Atom(self.each.predicate, (*anyone, *self.atom.arguments)))


def _begins(reader: Reader, at: int = 0) -> bool:
    """Tell whether a count begins some tokens ahead; a predicate may be called like one."""
    if not (reader.sees(_COUNT, at) or reader.sees(_EXISTS, at)) or not reader.sees("(", at + 1):
        return False
    last = at + 2
    while reader.sees(",", last + 1):
        last += 2
    return reader.sees(":", last + 1)


def _counted(reader: Reader, others: Collection[str]) -> str:
    offset = reader.offset
    name = reader.name("a variable to count")
    if not is_variable(name):
        raise ClauseError(
            f"'{name}' is no variable, so that it can't be counted",
            name=name,
            suggestion="a variable begins with an upper-case letter: count(P: Pedestrian(P)) >= 2",
            offset=offset,
        )
    if name in others:
        raise ClauseError(
            f"the variable '{name}' is counted twice",
            name=name,
            suggestion="name it once",
            offset=offset,
        )
    return name


def _literal(reader: Reader) -> Literal:
    if _begins(reader):
        raise ClauseError(
            "a count stands inside of another one",
            suggestion="let a rule of its own conclude the inner one",
            offset=reader.offset,
        )
    tried = (kind.parse(reader) for kind in _INSIDE)
    return next(literal for literal in tried if literal is not None)


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


def _check_not_negated(reader: Reader) -> None:
    if reader.sees("not") and _begins(reader, at=1):
        raise ClauseError(
            "a count can't be negated",
            name="not",
            suggestion="let a rule of its own conclude it, and negate the head of that rule",
            offset=reader.offset,
        )
