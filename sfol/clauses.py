"""Rules and conditions as text ↔ clauses and bodies.

The grammar, with `?` optional and `*` repeated; atoms and terms are those of `sfol.syntax`::

    rule      =  atom ":-" body "."
    condition =  body
    body      =  literal ("," literal)*
    literal   =  pattern (">=" number)? | "not" pattern | term "!=" term
    pattern   =  atom, any of whose arguments may be "_"

Each kind of literal is a class of `sfol.literals`, and reads itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import count

from sfol.errors import ClauseError
from sfol.literals import KINDS, AtomLiteral, Literal
from sfol.syntax import ANONYMOUS, Atom, Reader, variables

MAXIMUM_LITERALS = 64


@dataclass(frozen=True)
class Body:
    """What must hold.

    Attributes:
        literals: those that stand for atoms first, then guards, each in the order of the text. An
            anonymous variable of a literal that binds is called ``_1``, ``_2`` and so on.
        offsets: where each name stands in the text, for error messages.
    """

    literals: tuple[Literal, ...]
    offsets: tuple[tuple[str, int], ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        ordered = sorted(self.literals, key=lambda literal: not isinstance(literal, AtomLiteral))
        taken = {term for literal in ordered for term in literal.terms}
        names = (name for n in count(1) if (name := f"{ANONYMOUS}{n}") not in taken)
        apart = tuple([literal.named_apart(names) for literal in ordered])
        object.__setattr__(self, "literals", apart)

    def __str__(self) -> str:
        return ", ".join(map(str, self.literals))

    @cached_property
    def atom_literals(self) -> tuple[AtomLiteral, ...]:
        """The literals that stand for atoms, whose bounds take part in the conjunction."""
        return tuple(lit for lit in self.literals if isinstance(lit, AtomLiteral))

    @property
    def predicates(self) -> frozenset[str]:
        """The predicates that it reads."""
        return frozenset(atom.predicate for lit in self.literals for atom in lit.atoms)

    @property
    def terms(self) -> tuple[str, ...]:
        """The variables and constants that it names, each once, in order."""
        return tuple(dict.fromkeys(term for lit in self.literals for term in lit.terms))

    @property
    def bound_variables(self) -> frozenset[str]:
        """The variables that get a value from it; every other one needs a value beforehand."""
        return frozenset(
            term for lit in self.literals if lit.binds for term in variables(*lit.terms)
        )


@dataclass(frozen=True)
class Clause:
    """A Horn clause: the head holds if the body does."""

    head: Atom
    body: Body

    def __str__(self) -> str:
        return f"{self.head} :- {self.body}."


def parse_clause(text: str) -> Clause:
    """Parse one rule.

    Args:
        text: such as ``safe2(X) :- Vehicle(X), Pedestrian(P), OnCrosswalk(P).``

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    reader = Reader(text)
    head = reader.atom()
    reader.expect(":-", "a rule is written 'head :- body.'")
    body = _body(reader)
    reader.expect(".", "a rule ends with a full stop")
    reader.end()
    return Clause(head, body)


def parse_condition(text: str) -> Body:
    """Parse the body of a rule alone, such as ``Pedestrian(X), OnRoad(X)``.

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    reader = Reader(text)
    body = _body(reader)
    reader.end()
    return body


def _body(reader: Reader) -> Body:
    return Body(tuple(_literals(reader)), tuple(reader.names))


def _literals(reader: Reader) -> Iterator[Literal]:
    yield _literal(reader)
    for _ in range(MAXIMUM_LITERALS):
        if not reader.accept(","):
            return
        yield _literal(reader)
    raise ClauseError(
        f"the body has more than {MAXIMUM_LITERALS} literals",
        suggestion="split it: let a rule conclude what some of them say together",
    )


def _literal(reader: Reader) -> Literal:
    tried = (kind.parse(reader) for kind in KINDS)
    return next(literal for literal in tried if literal is not None)
