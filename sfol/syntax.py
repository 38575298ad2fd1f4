"""Horn-clause text ↔ rules, atoms and facts.

The grammar, with `?` optional and `*` repeated::

    rule      =  atom ":-" body "."
    condition =  body
    fact      =  atom (":" bound | ":" number)? "."
    body      =  element ("," element)*
    element   =  atom | "not" atom | term "!=" term
    atom      =  name "(" term ("," term)? ")"
    bound     =  "[" number "," number "]"

An argument that begins with an upper-case letter is a variable, any other a constant. ``%`` and
``#`` begin a comment that ends with the line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from sfol.errors import ClauseError

MAXIMUM_TEXT = 100_000

_TOKEN = re.compile(
    r"(?P<space>\s+|[%#][^\n]*)"
    r"|(?P<number>[+-]?\d+(\.\d+)?([eE][+-]?\d+)?)"
    r"|(?P<name>[^\W\d]\w*)"
    r"|(?P<punctuation>:-|!=|[(),.:\[\]])"
)
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")


class Atom(NamedTuple):
    """A predicate applied to arguments; ground if none of them is a variable."""

    predicate: str
    arguments: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.predicate}({', '.join(self.arguments)})"


class Literal(NamedTuple):
    """An atom in a body, negated or not."""

    atom: Atom
    negated: bool = False

    def __str__(self) -> str:
        return f"not {self.atom}" if self.negated else str(self.atom)


class Guard(NamedTuple):
    """The condition that two terms are different entities."""

    left: str
    right: str

    def __str__(self) -> str:
        return f"{self.left} != {self.right}"


@dataclass(frozen=True)
class Body:
    """What must hold: literals and guards.

    Attributes:
        literals: in the order of the text.
        guards: in the order of the text.
        offsets: where each name stands in the text, for error messages.
    """

    literals: tuple[Literal, ...]
    guards: tuple[Guard, ...] = ()
    offsets: tuple[tuple[str, int], ...] = field(default=(), compare=False, repr=False)

    @property
    def predicates(self) -> frozenset[str]:
        """The predicates that it reads."""
        return frozenset(literal.atom.predicate for literal in self.literals)

    def __str__(self) -> str:
        return ", ".join(str(part) for part in (*self.literals, *self.guards))


@dataclass(frozen=True)
class Clause:
    """A Horn clause: the head holds if the body does."""

    head: Atom
    body: Body

    def __str__(self) -> str:
        return f"{self.head} :- {self.body}."


class FactText(NamedTuple):
    """A ground atom as written: with a bound, a confidence, or neither."""

    atom: Atom
    bound: tuple[float, float] | None
    confidence: float | None


def is_variable(term: str) -> bool:
    """Tell whether an argument is a variable: its first letter is upper case."""
    return term[0].isupper()


def is_name(text: str) -> bool:
    """Tell whether a text can be a predicate or a term: a letter, then letters, digits, _."""
    return bool(_NAME.match(text))


def variables(*terms: str) -> tuple[str, ...]:
    """Return the variables among the terms, each once, in order."""
    return tuple(dict.fromkeys(term for term in terms if is_variable(term)))


def parse_clause(text: str) -> Clause:
    """Parse one rule.

    Args:
        text: such as ``safe2(X) :- Vehicle(X), Pedestrian(P), OnCrosswalk(P).``

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    reader = _Reader(text)
    head = reader.atom()
    reader.expect(":-", "a rule is written 'head :- body.'")
    body = reader.body()
    reader.expect(".", "a rule ends with a full stop")
    reader.end()
    return Clause(head, body)


def parse_condition(text: str) -> Body:
    """Parse the body of a rule alone, such as ``Pedestrian(X), OnRoad(X)``.

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    reader = _Reader(text)
    body = reader.body()
    reader.end()
    return body


def parse_signature(text: str) -> Atom:
    """Parse a predicate with its parameters, such as ``CenterOf(X, Y)``.

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    reader = _Reader(text)
    atom = reader.atom()
    reader.end()
    if len(variables(*atom.arguments)) != len(atom.arguments):
        raise ClauseError(
            f"the parameters of '{atom.predicate}' must be different variables",
            name=atom.predicate,
            suggestion="write it as CenterOf(X, Y)",
        )
    return atom


def parse_facts(text: str) -> Iterator[FactText]:
    """Parse facts.

    Args:
        text: such as ``Pedestrian(p1): [0.76, 0.84]. CenterOf(p1, ego).``

    Yields:
        Each fact in the order of the text.

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    reader = _Reader(text)
    while not reader.at_end():
        yield reader.fact()


def parse_ground_atom(text: str) -> Atom:
    """Parse one atom without variables, such as ``Vehicle(ego)``.

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    reader = _Reader(text)
    atom = reader.ground_atom()
    reader.accept(".")
    reader.end()
    return atom


class _Token(NamedTuple):
    kind: str
    text: str
    offset: int


class _Reader:
    """A recursive-descent parser over the tokens of one text."""

    def __init__(self, text: str) -> None:
        if len(text) > MAXIMUM_TEXT:
            raise ClauseError(
                f"this text has {len(text)} characters; {MAXIMUM_TEXT} are the limit",
                suggestion="split it",
            )
        self._text = text
        self._tokens = list(_tokenise(text))
        self._position = 0
        self._names: list[tuple[str, int]] = []

    def at_end(self) -> bool:
        return self._peek().kind == "end"

    def accept(self, punctuation: str) -> bool:
        if self._peek().text != punctuation:
            return False
        self._position += 1
        return True

    def expect(self, punctuation: str, suggestion: str | None = None) -> None:
        if not self.accept(punctuation):
            raise self._unexpected(f"'{punctuation}'", suggestion)

    def end(self) -> None:
        if not self.at_end():
            raise self._unexpected("the end")

    def body(self) -> Body:
        literals: list[Literal] = []
        guards: list[Guard] = []
        while True:
            element = self._element()
            if isinstance(element, Guard):
                guards.append(element)
            else:
                literals.append(element)
            if not self.accept(","):
                return Body(tuple(literals), tuple(guards), tuple(self._names))

    def atom(self) -> Atom:
        predicate = self._name("a predicate")
        self.expect("(", f"a predicate has one or two arguments: {predicate}(X)")
        arguments = [self._name("an argument")]
        if self.accept(","):
            arguments.append(self._name("an argument"))
        self.expect(")", "a predicate has one or two arguments")
        return Atom(predicate, tuple(arguments))

    def ground_atom(self) -> Atom:
        start = self._peek().offset
        atom = self.atom()
        found = variables(*atom.arguments)
        if found:
            raise ClauseError(
                f"the fact {atom} has a variable, '{found[0]}'",
                name=found[0],
                suggestion="constants begin with a lower-case letter",
                offset=start,
            )
        return atom

    def fact(self) -> FactText:
        atom = self.ground_atom()
        bound = confidence = None
        if self.accept(":"):
            if self.accept("["):
                lower = self._number()
                self.expect(",", "a bound is written [lower, upper]")
                bound = (lower, self._number())
                self.expect("]", "a bound is written [lower, upper]")
            else:
                confidence = self._number()
        self.expect(".", "a fact ends with a full stop")
        return FactText(atom, bound, confidence)

    def _element(self) -> Literal | Guard:
        if self._peek().text == "not" and self._peek(1).text != "(":
            self._position += 1
            return Literal(self.atom(), negated=True)
        if self._peek(1).text == "!=":
            left = self._name("a term")
            self.expect("!=")
            return Guard(left, self._name("a term"))
        return Literal(self.atom())

    def _name(self, what: str) -> str:
        token = self._peek()
        if token.kind != "name":
            raise self._unexpected(what)
        if not is_name(token.text):
            raise ClauseError(
                f"'{token.text}' is not a name",
                name=token.text,
                suggestion="names have letters a to z, digits and underscores",
                offset=token.offset,
            )
        self._position += 1
        self._names.append((token.text, token.offset))
        return token.text

    def _number(self) -> float:
        token = self._peek()
        if token.kind != "number":
            raise self._unexpected("a number")
        self._position += 1
        return float(token.text)

    def _peek(self, ahead: int = 0) -> _Token:
        return self._tokens[min(self._position + ahead, len(self._tokens) - 1)]

    def _unexpected(self, expected: str, suggestion: str | None = None) -> ClauseError:
        if self._text.count("(") != self._text.count(")") and len(self._text) < 80:
            suggestion = (
                "in a YAML list [a, b] a comma tears text apart: "
                'put the whole clause in quotes, "CenterOf(p1, ego)"'
            )
        token = self._peek()
        found = "the text ends" if token.kind == "end" else f"'{token.text}' stands"
        return ClauseError(
            f"{expected} is expected where {found}",
            name=token.text or None,
            suggestion=suggestion,
            offset=token.offset,
        )


def _tokenise(text: str) -> Iterator[_Token]:
    position = 0
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            raise ClauseError(
                f"the character {text[position]!r} has no place in a clause",
                name=text[position],
                offset=position,
            )
        if match.lastgroup and match.lastgroup != "space":
            yield _Token(match.lastgroup, match.group(), position)
        position = match.end()
    yield _Token("end", "", len(text))
