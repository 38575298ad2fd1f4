"""Rules and conditions as text ↔ clauses and bodies.

The grammar, with `?` optional and `*` repeated; atoms and terms are those of `sfol.syntax`::

    rule      =  atom ":-" body "."
    condition =  body
    body      =  unit ("," unit)* | unit ("or" unit)* | unit "implies" unit
    unit      =  literal | "(" body ")"
    literal   =  inner | count | forall
    inner     =  pattern (">=" number)? | "not" pattern | term "!=" term
    count     =  "count" counting ">=" integer | "exists" counting
    counting  =  "(" variable ("," variable)* ":" inner ("," inner)* ")"
    forall    =  "forall" counting "(" inner ("," inner)* ")"
    pattern   =  atom, any of whose arguments may be "_" | compared | timed
    timed     =  ("previously" | "rose" | "fell") "(" pattern ")"
              |  ("once" | "held") "[" number "]" "(" pattern ")"
              |  "since" "(" pattern "," pattern ")"
              |  "latched" "(" pattern "," "on" "=" number "," "off" "=" number ")"

What is compared is said in `sfol.comparisons`. Each kind of literal is a class of `sfol.literals`,
and reads itself. A rule whose body has ``or`` or ``implies`` stands for several clauses, one for
each way in which the body can hold.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, count

from sfol.connectives import AND, IMPLIES, OR, Joined, Tree, opposite, ways
from sfol.errors import ClauseError
from sfol.literals import KINDS, AtomLiteral, Literal, Quantified
from sfol.syntax import ANONYMOUS, Atom, Reader, Timed, variables

MAXIMUM_LITERALS = 64
MAXIMUM_DEPTH = 16


@dataclass(frozen=True)
class Body:
    """What must hold.

    Attributes:
        literals: those that stand for atoms first, then guards, counts and foralls, each in the
            order of the text. An anonymous variable of a literal that binds is called ``_1``,
            ``_2`` and so on.
        offsets: where each name stands in the text, for error messages.
    """

    literals: tuple[Literal, ...]
    offsets: tuple[tuple[str, int], ...] = field(default=(), compare=False, repr=False)

    def __post_init__(self) -> None:
        ordered = sorted(self.literals, key=lambda literal: not isinstance(literal, AtomLiteral))
        taken = {term for literal in ordered for term in literal.terms}
        names = (name for n in count(1) if (name := f"{ANONYMOUS}{n}") not in taken)
        apart = tuple([literal.named_apart(names) for literal in ordered])
        # Explanations make thousands of bodies, of few kinds of literals.
        if any(issubclass(kind, Quantified) for kind in set(map(type, apart))):
            apart = tuple(_beside_each_other(apart))
        object.__setattr__(self, "literals", apart)

    def __str__(self) -> str:
        return ", ".join(map(str, self.literals))

    @cached_property
    def atom_literals(self) -> tuple[AtomLiteral, ...]:
        """The literals that stand for atoms, whose bounds take part in the conjunction."""
        return tuple(lit for lit in self.literals if isinstance(lit, AtomLiteral))

    @property
    def quantified(self) -> tuple[Quantified, ...]:
        """The literals that have others inside: counts and foralls."""
        return tuple(lit for lit in self.literals if isinstance(lit, Quantified))

    @property
    def all_literals(self) -> tuple[Literal, ...]:
        """The literals, each count or forall followed by those inside of it."""
        inside = (
            (lit, *(lit.literals if isinstance(lit, Quantified) else ())) for lit in self.literals
        )
        return tuple(chain.from_iterable(inside))

    @property
    def _atom_literals(self) -> Iterator[AtomLiteral]:
        return (lit for lit in self.all_literals if isinstance(lit, AtomLiteral))

    @property
    def predicates(self) -> frozenset[str]:
        """The predicates that it reads."""
        return frozenset(atom.predicate for lit in self.literals for atom in lit.atoms)

    @property
    def asked(self) -> frozenset[str]:
        """The predicates of its literals, those of operators over time among them."""
        return frozenset(literal.atom.predicate for literal in self._atom_literals)

    @property
    def present(self) -> frozenset[str]:
        """Those whose atoms of the same step it depends on."""
        return frozenset(atom.predicate for lit in self._atom_literals for atom in lit.atom.present)

    @property
    def timed(self) -> tuple[Timed, ...]:
        """What it asks operators over time, each once, what stands in another one before it."""
        found = (name for lit in self._atom_literals for name in _timed(lit.atom.predicate))
        return tuple(dict.fromkeys(found))

    @property
    def comparisons(self) -> tuple[Atom, ...]:
        """What it says of values, also where an operator over time speaks of it."""
        return tuple(atom for lit in self._atom_literals for atom in lit.atom.comparisons)

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


def _beside_each_other(literals: Sequence[Literal]) -> Iterator[Literal]:
    """Yield literals that know which of their variables stand outside of any of them as well."""
    outside = {term for lit in literals if not isinstance(lit, Quantified) for term in lit.terms}
    return (lit.within(outside) if isinstance(lit, Quantified) else lit for lit in literals)


def _timed(predicate: str) -> Iterator[Timed]:
    if isinstance(predicate, Timed):
        for operand in predicate.operands:
            yield from _timed(operand.predicate)
        yield predicate


@dataclass(frozen=True)
class Clause:
    """A Horn clause: the head holds if the body does."""

    head: Atom
    body: Body

    def __str__(self) -> str:
        return f"{self.head} :- {self.body}."


@dataclass(frozen=True)
class WrittenRule:
    """A rule as it is written.

    Attributes:
        head: of every clause.
        body: with its connectives.
        clauses: what it stands for: one, or one for each way in which the body can hold.
    """

    head: Atom
    body: Tree
    clauses: tuple[Clause, ...]

    def __str__(self) -> str:
        return f"{self.head} :- {self.body}."


def parse_rule(text: str, attributes: Container[str] = ()) -> WrittenRule:
    """Parse one rule.

    Args:
        text: such as ``safe2(X) :- Vehicle(X), (OnRoad(P) or OnCrosswalk(P)).``
        attributes: what has values, so that `>=` compares these.

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    reader = Reader(text, attributes)
    head = reader.atom()
    reader.expect(":-", "a rule is written 'head :- body.'")
    body = _body(reader)
    reader.expect(".", "a rule ends with a full stop")
    reader.end()
    return WrittenRule(head, body, tuple(Clause(head, way) for way in _ways(body, reader)))


def parse_clause(text: str, attributes: Container[str] = ()) -> Clause:
    """Parse a rule that is a single clause: its body has neither ``or`` nor ``implies``.

    Args:
        text: see `parse_rule`.
        attributes: likewise.

    Raises:
        ClauseError: see `parse_rule`; or it stands for several clauses.
    """
    clause, *others = parse_rule(text, attributes).clauses
    if others:
        raise _several(len(others) + 1)
    return clause


def parse_conditions(text: str, attributes: Container[str] = ()) -> tuple[Body, ...]:
    """Parse the body of a rule alone, such as ``Pedestrian(X), OnRoad(X)``.

    Args:
        text: the body.
        attributes: what has values, so that `>=` compares these.

    Returns:
        One body for each way in which it can hold.

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    reader = Reader(text, attributes)
    body = _body(reader)
    reader.end()
    return _ways(body, reader)


def parse_condition(text: str, attributes: Container[str] = ()) -> Body:
    """Parse a body that has neither ``or`` nor ``implies``.

    Args:
        text: see `parse_conditions`.
        attributes: likewise.

    Raises:
        ClauseError: see `parse_conditions`; or it can hold in several ways.
    """
    body, *others = parse_conditions(text, attributes)
    if others:
        raise _several(len(others) + 1)
    return body


def _several(count: int) -> ClauseError:
    return ClauseError(f"this stands for {count} clauses", suggestion="give each of them alone")


def _ways(body: Tree, reader: Reader) -> tuple[Body, ...]:
    found = ways(body)
    if any(len(way) > MAXIMUM_LITERALS or any(_is_long(lit) for lit in way) for way in found):
        raise _too_long()
    return tuple(Body(way, tuple(reader.names)) for way in found)


def _is_long(literal: Literal) -> bool:
    return len(literal.atoms) > MAXIMUM_LITERALS


def _too_long() -> ClauseError:
    return ClauseError(
        f"the body has more than {MAXIMUM_LITERALS} literals",
        suggestion="split it: let a rule conclude what some of them say together",
    )


def _body(reader: Reader, depth: int = 0) -> Tree:
    start = reader.offset
    parts = [_unit(reader, depth)]
    connective = next((word for word in (AND, OR, IMPLIES) if reader.sees(word)), "")
    while connective and reader.accept(connective):
        if connective == IMPLIES:
            _check_condition(parts[0], start)
        parts.append(_unit(reader, depth))
        if len(parts) > MAXIMUM_LITERALS:
            raise _too_long()
        if connective == IMPLIES:
            break
    _check_connective(reader, connective)
    return parts[0] if len(parts) == 1 else Joined(connective, tuple(parts))


def _unit(reader: Reader, depth: int) -> Tree:
    offset = reader.offset
    for word in (OR, IMPLIES):
        if reader.sees(word) and not reader.sees("(", ahead=1):
            raise ClauseError(
                f"'{word}' has nothing to its left",
                name=word,
                suggestion=f"it joins two parts of a body: P(X) {word} Q(X)",
                offset=offset,
            )
    if not reader.accept("("):
        return _literal(reader)
    if depth == MAXIMUM_DEPTH:
        raise ClauseError(
            f"parentheses stand in each other more than {MAXIMUM_DEPTH} deep",
            suggestion="let a rule of its own conclude what stands in some of them",
            offset=offset,
        )
    body = _body(reader, depth + 1)
    reader.expect(")", "a parenthesis is open")
    return body


def _check_condition(condition: Tree, offset: int) -> None:
    """Make sure that what stands to the left of ``implies`` has an opposite."""
    try:
        opposite(condition)
    except ClauseError as error:
        raise ClauseError(
            error.message, name=error.name, suggestion=error.suggestion, offset=offset
        ) from None


def _check_connective(reader: Reader, before: str) -> None:
    """Make sure that no connective stands beside another one."""
    for word in (AND, OR, IMPLIES):
        if before and reader.sees(word):
            raise ClauseError(
                f"'{word}' stands beside '{before}': which of them joins first?",
                name=word,
                suggestion="put one of them in parentheses: P(X), (Q(X) or R(X))",
                offset=reader.offset,
            )


def _literal(reader: Reader) -> Literal:
    tried = (kind.parse(reader) for kind in KINDS)
    return next(literal for literal in tried if literal is not None)
