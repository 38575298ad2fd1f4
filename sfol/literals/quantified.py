"""What ``count``, ``exists`` and ``forall`` have in common: they go through entities."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

from sfol.errors import ClauseError
from sfol.literals.literal import Literal, Thresholds
from sfol.literals.negated import Negated
from sfol.literals.not_equal import NotEqual
from sfol.literals.positive import Positive
from sfol.literals.search import Scene
from sfol.syntax import Atom, Reader, is_anonymous, is_variable, variables

COUNT, EXISTS, FORALL = "count", "exists", "forall"
QUANTIFIERS = (COUNT, EXISTS, FORALL)
# An atom is what remains, as in a body; a literal of this kind stands in no other.
_INSIDE: tuple[type[Literal], ...] = (Negated, NotEqual, Positive)


@dataclass(frozen=True)
class Quantified(Literal):
    """A literal about entities, or groups of them, of which other literals speak.

    It has a bound, which takes part in the conjunction, but no atom. In the program that an engine
    runs, rules of their own conclude the bound, and a literal with an atom stands in its place.

    Attributes:
        quantified: the variables that it goes through, all of them together.
        shared: those of its variables that stand in other literals of the body as well, which say
            what they are; its other ones are known inside of it alone.
    """

    quantified: tuple[str, ...]
    shared: tuple[str, ...] = ()

    @property
    @abstractmethod
    def literals(self) -> tuple[Literal, ...]:
        """Those inside of it, in the order of the text."""

    @abstractmethod
    def with_literals(self, change: Callable[[Literal], Literal]) -> Self:
        """Return it with every literal inside of it changed."""

    @property
    @abstractmethod
    def needed(self) -> tuple[Literal, ...]:
        """Those of them without which it never holds."""

    @property
    def against(self) -> tuple[Literal, ...]:
        """Those of them that speak against it where they hold."""
        return ()

    @property
    def terms(self) -> tuple[str, ...]:
        """The shared variables, and the constants that it names."""
        constants = (term for term in self._inside if not is_variable(term))
        return tuple(dict.fromkeys([*self.shared, *constants]))

    @property
    def _inside(self) -> tuple[str, ...]:
        return tuple(term for literal in self.literals for term in literal.terms)

    @property
    def named(self) -> tuple[str, ...]:
        """All of its variables."""
        return variables(*self.quantified, *self._inside)

    @property
    def local(self) -> frozenset[str]:
        """The variables that are known inside of it alone."""
        return frozenset(self.named).difference(self.shared)

    @property
    def atoms(self) -> tuple[Atom, ...]:
        return tuple(atom for literal in self.literals for atom in literal.atoms)

    def within(self, outside: Collection[str]) -> Self:
        """Return it as it is beside other literals, given the terms that these name."""
        shared = (name for name in self.named if name in outside and not is_anonymous(name))
        return replace(self, shared=tuple(shared))

    def named_apart(self, names: Iterator[str]) -> Self:
        return self.with_literals(lambda literal: literal.named_apart(names))

    def substituted(self, values: Mapping[str, str]) -> Self:
        given = {name: value for name, value in values.items() if name not in self.local}
        shared = variables(*(given.get(name, name) for name in self.shared))
        return replace(self.with_literals(lambda lit: lit.substituted(given)), shared=shared)

    def matched(self, target: Literal, values: Mapping[str, str]) -> Mapping[str, str] | None:
        """Return the substitution; names that are known inside alone must be the same in both."""
        if not isinstance(target, Quantified) or not self._covers(target):
            return None
        if (self.quantified, self.local) != (target.quantified, target.local):
            return None
        extended: Mapping[str, str] | None = {**values, **{name: name for name in self.local}}
        for mine, theirs in zip(self.literals, target.literals, strict=True):
            extended = None if extended is None else mine.matched(theirs, extended)
        if extended is None:
            return None
        return {name: value for name, value in extended.items() if name not in self.local}

    @abstractmethod
    def _covers(self, target: Quantified) -> bool:
        """Tell whether it holds where a target does that has the same literals inside."""

    def faults(self) -> Iterator[tuple[str, str, str]]:
        for name in self.quantified:
            if name in self.shared:
                yield (
                    name,
                    f"the variable '{name}' belongs to '{self}' and stands outside of it",
                    "call one of the two differently",
                )

    def _unbound(self, name: str) -> tuple[str, str, str]:
        return (
            name,
            f"the variable '{name}' stands in no positive literal inside of '{self}'",
            f"add a literal such as Predicate({name}) there, or rename the variable",
        )

    def refutation(self, scene: Scene, thresholds: Thresholds) -> str:
        return str(self)

    @property
    def _beginning(self) -> str:
        return f"({', '.join(self.quantified)}: "


def bound_inside(literals: Sequence[Literal]) -> frozenset[str]:
    """Return the terms of the literals that bind."""
    return frozenset(term for literal in literals if literal.binds for term in literal.terms)


def begins(reader: Reader, words: Collection[str], at: int = 0) -> bool:
    """Tell whether one of some words begins a quantified literal some tokens ahead.

    A predicate may be called like it: what tells them apart is the colon behind the variables.
    """
    if not any(reader.sees(word, at) for word in words) or not reader.sees("(", at + 1):
        return False
    last = at + 2
    while reader.sees(",", last + 1):
        last += 2
    return reader.sees(":", last + 1)


def check_not_negated(reader: Reader, words: Collection[str], what: str) -> None:
    """Make sure that no ``not`` stands before a quantified literal.

    Raises:
        ClauseError: one does.
    """
    if reader.sees("not") and begins(reader, words, at=1):
        raise ClauseError(
            f"{what} can't be negated",
            name="not",
            suggestion="let a rule of its own conclude it, and negate the head of that rule",
            offset=reader.offset,
        )


def read_quantified(reader: Reader) -> tuple[str, ...]:
    """Read the variables, from the parenthesis to the colon.

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    reader.expect("(")
    found = [_variable(reader, [])]
    while reader.accept(","):
        found.append(_variable(reader, found))
    reader.expect(":")
    return tuple(found)


def read_literals(reader: Reader, what: str) -> tuple[Literal, ...]:
    """Read the literals, to the parenthesis that ends them.

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    literals = [_literal(reader)]
    while reader.accept(","):
        literals.append(_literal(reader))
    reader.expect(")", f"in {what} literals are joined by commas alone")
    return tuple(literals)


def _variable(reader: Reader, others: Collection[str]) -> str:
    offset = reader.offset
    name = reader.name("a variable")
    if not is_variable(name):
        raise ClauseError(
            f"'{name}' is no variable, so that it can't stand before the colon",
            name=name,
            suggestion="a variable begins with an upper-case letter: count(P: Pedestrian(P)) >= 2",
            offset=offset,
        )
    if name in others:
        raise ClauseError(
            f"the variable '{name}' stands twice before the colon",
            name=name,
            suggestion="name it once",
            offset=offset,
        )
    return name


def _literal(reader: Reader) -> Literal:
    if begins(reader, QUANTIFIERS):
        raise ClauseError(
            "a count, or a forall, stands inside of another one",
            suggestion="let a rule of its own conclude the inner one",
            offset=reader.offset,
        )
    tried = (kind.parse(reader) for kind in _INSIDE)
    return next(literal for literal in tried if literal is not None)
