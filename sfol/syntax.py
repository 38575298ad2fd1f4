"""Atoms and facts as text, and the tokens and names that clauses are made of.

The grammar, with `?` optional and `*` repeated::

    fact      =  atom (":" bound | ":" number | "=" number)? "."
    atom      =  name ("(" term ("," term)* ")")?
    bound     =  "[" number "," number "]"
    term      =  name | integer | quoted text

An argument that begins with an upper-case letter is a variable, any other a constant: also an
integer, and what stands in quotes, ``"Mary"`` or ``'Mary'``. In a body ``_`` is a variable of its
own wherever it stands. An atom has four arguments at most. ``%`` and ``#`` begin a comment that
ends with the line. Rules are read by `sfol.clauses`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple, Protocol, Self

from sfol.errors import ClauseError, expect, torn_apart

MAXIMUM_TEXT = 100_000
MAXIMUM_ARITY = 4
ANONYMOUS = "_"
OPERATORS = (
    ":-",
    "!=",
    ">=",
    "<=",
    "<",
    ">",
)  # marks that stand between blanks; longer ones before their beginnings

_TOKEN = re.compile(
    r"(?P<space>\s+|[%#][^\n]*)"
    r"|(?P<number>[+-]?\d+(\.\d+)?([eE][+-]?\d+)?)"
    r"|(?P<name>[^\W\d]\w*)"
    rf"|(?P<punctuation>{'|'.join(map(re.escape, OPERATORS))}|[(),.:=\[\]])"
    r"|(?P<quoted>\"[^\"\n]*\"|'[^'\n]*')"
)
_OR = "write or, in parentheses beside a comma: P(X), (Q(X) or R(X))"
_QUOTES = 'close the quotes on the same line: "Mary"'
_WORDS = ("not", "or", "implies")  # where they stand alone in a body
# Operators over time, which `sfol.temporal` reads: no predicate of a text is called so.
OVER_TIME = ("previously", "once", "held", "since", "latched", "rose", "fell")
# What other languages write → what a clause says instead.
_INSTEAD = {
    "!": "write not P(X)",
    "~": "write not P(X)",
    "¬": "write not P(X)",
    "\\": "write not P(X), and X != Y for different entities",
    "&": "write a comma for and",
    "∧": "write a comma for and",
    "and": "write a comma for and",
    "|": _OR,
    ";": _OR,
    "∨": _OR,
    "or": _OR,
    "→": "write P(X) implies Q(X)",
    '"': _QUOTES,
    "'": _QUOTES,
    "<": "a rule is written head(X) :- body(X).",
    "←": "a rule is written head(X) :- body(X).",
    "-": "a rule is written head(X) :- body(X).",
    "=": "bodies compare as X != Y, P(X) >= 0.5, and values of attributes as Speed(X) < 10 or "
    "near(Speed(X), 10)",
    ">=": "a bound is asked of a positive literal: P(X) >= 0.5",
    ">": "a bound is asked of a positive literal: P(X) >= 0.5",
}
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
_INTEGER = re.compile(r"(0|-?[1-9][0-9]{0,17})\Z")


class Atom(NamedTuple):
    """A predicate applied to arguments; ground if none of them is a variable."""

    predicate: str
    arguments: tuple[str, ...]

    def __str__(self) -> str:
        shown = [ANONYMOUS if term[0] == ANONYMOUS else term for term in self.arguments]
        if isinstance(self.predicate, Derived):
            return self.predicate.applied(shown)
        return f"{self.predicate}({', '.join(shown)})" if shown else self.predicate

    @property
    def plain(self) -> tuple[Atom, ...]:
        """The atoms that it speaks of: itself, or those below an operator over time.

        A comparison speaks of a value, and of no atom.
        """
        if not isinstance(self.predicate, Derived):
            return (self,)
        return tuple(atom for operand in self._below for atom in operand.plain)

    @property
    def comparisons(self) -> tuple[Atom, ...]:
        """The comparisons that it speaks of: itself, or those below an operator over time."""
        if isinstance(self.predicate, Compared):
            return (self,)
        return tuple(atom for operand in self._below for atom in operand.comparisons)

    @property
    def _below(self) -> tuple[Atom, ...]:
        return self.predicate.atoms(self.arguments) if isinstance(self.predicate, Timed) else ()

    @property
    def present(self) -> tuple[Atom, ...]:
        """Those of them whose bounds at the same step it depends on."""
        if not isinstance(self.predicate, Derived):
            return (self,)
        if not isinstance(self.predicate, Timed) or self.predicate.operator.strict:
            return ()
        return tuple(atom for operand in self._below for atom in operand.present)

    @property
    def is_pattern(self) -> bool:
        """Whether it stands for all atoms that have anything where it has ``_``."""
        return ANONYMOUS in self.arguments

    def substituted(self, values: Mapping[str, str]) -> Atom:
        """Return the atom with the terms that have a value replaced by it."""
        return Atom(self.predicate, tuple([values.get(term, term) for term in self.arguments]))

    def key(self, slots: Mapping[str, int]) -> Callable[[list[str]], tuple[str, ...]]:
        """Return the function that reads the ground arguments off a list of values.

        Args:
            slots: where in the list the value of each term stands.
        """
        places = [slots[term] for term in self.arguments]
        if len(places) == 1:  # nearly all have one or two, and are asked for often
            only = places[0]
            return lambda values: (values[only],)
        if len(places) == 2:
            left, right = places
            return lambda values: (values[left], values[right])
        return lambda values: tuple([values[place] for place in places])

    def matched(self, target: Atom, values: Mapping[str, str]) -> dict[str, str] | None:
        """Return the substitution, extended so that it turns this atom into the target.

        Args:
            target: another atom; its variables are taken as they stand.
            values: what variables of this atom stand for already.

        Returns:
            None if no substitution does.
        """
        if self.predicate != target.predicate or len(self.arguments) != len(target.arguments):
            return None
        extended = dict(values)
        for term, wanted in zip(self.arguments, target.arguments, strict=True):
            if (extended.setdefault(term, wanted) if is_variable(term) else term) != wanted:
                return None
        return extended


class Operation(Protocol):
    """What makes atoms of others, told to those who only read and print it."""

    def text(self, operands: Sequence[object]) -> str:
        """Return the operation as it is written, applied to operands."""
        ...


class OverTime(Operation, Protocol):
    """What an operator over time tells those who only read and print it."""

    @property
    def name(self) -> str:
        """What it is called where it is written."""
        ...

    @property
    def strict(self) -> bool:
        """Whether what it says depends on earlier steps alone."""
        ...

    @property
    def duration(self) -> float | None:
        """How far it looks back, in the unit of `time`; None if it has no window."""
        ...

    def advance(self, before: Any, moment: Any) -> tuple[Any, Any]:
        """Take one step; `sfol.temporal` says how."""
        ...

    def when(self, remembered: Any, step: int, said: Callable[[int], str]) -> str:
        """Return when what it says was so."""
        ...


class Derived(str):
    """The predicate of what an operation says of atoms, such as ``once[1.5](Near({0}, ego))``.

    The name is the text, with a number in braces for each argument, so that no predicate that a
    file can declare is called like it.

    Args:
        operator: the operation.
        operands: the atoms that it speaks of, with such numbers for variables.
    """

    operator: Operation
    operands: tuple[Atom, ...]

    def __new__(cls, operator: Operation, operands: tuple[Atom, ...]) -> Self:
        """Make the name of the text."""
        made = super().__new__(cls, operator.text(operands))
        made.operator, made.operands = operator, operands
        return made

    def __getnewargs__(self) -> tuple[Operation, tuple[Atom, ...]]:  # type: ignore[override]
        return self.operator, self.operands

    @property
    def arity(self) -> int:
        """The number of arguments."""
        return len({term for atom in self.operands for term in atom.arguments if term[0] == "{"})

    def atoms(self, arguments: Sequence[str]) -> tuple[Atom, ...]:
        """Return the operands with arguments in place of their numbers."""
        values = {placeholder(number): term for number, term in enumerate(arguments)}
        return tuple(atom.substituted(values) for atom in self.operands)

    def applied(self, arguments: Sequence[str]) -> str:
        """Return the text with arguments in place of their numbers."""
        return self.operator.text(self.atoms(arguments))


class Timed(Derived):
    """The predicate of what an operator over time says."""

    operator: OverTime


class Comparing(Operation, Protocol):
    """What a comparison of a value tells those who only use it."""

    @property
    def name(self) -> str:
        """A sign, or what a soft comparison is called."""
        ...

    def truth(self, value: float) -> float:
        """Return how true it is of a value, from 0 to 1."""
        ...

    def truths(self, values: Any) -> Any:
        """Return how true it is of each of an array of values."""
        ...


class Compared(Derived):
    """The predicate of a comparison of an attribute's value, such as ``Distance({0}, {1}) < 10``.

    Its only operand is the attribute's atom, with a number for each of its arguments.
    """

    operator: Comparing

    @property
    def attribute(self) -> str:
        """The attribute that has the value."""
        return self.operands[0].predicate

    def of(self, arguments: Sequence[str]) -> Atom:
        """Return the attribute with arguments: what has the value."""
        return Atom(self.attribute, tuple(arguments))


def placeholder(number: int) -> str:
    """Return what stands for an argument in the operands of `Timed`."""
    return f"{{{number}}}"


class FactText(NamedTuple):
    """A ground atom as written: with a bound, a confidence or a value, or none of them."""

    atom: Atom
    bound: tuple[float, float] | None
    confidence: float | None
    value: float | None


def is_variable(term: str) -> bool:
    """Tell whether an argument is a variable: it begins with an upper-case letter.

    So is ``_1``, the name that a body gives to an anonymous variable; ``_`` itself is no name.
    """
    return term[0].isupper() or is_anonymous(term)


def is_anonymous(term: str) -> bool:
    """Tell whether an argument is an anonymous variable of a body, such as ``_1``."""
    return term[0] == ANONYMOUS and term != ANONYMOUS


def is_name(text: str) -> bool:
    """Tell whether a text can be a predicate or a term: a letter, then letters, digits, _."""
    return bool(_NAME.match(text))


def constant(text: str) -> str:
    """Return the constant that a text names, as clauses and facts have it.

    Args:
        text: any, such as the name of a person.

    Returns:
        The text itself if it is an integer, or a name that begins with a lower-case letter;
        otherwise the text in quotes.

    Raises:
        ClauseError: it is empty, or has characters that can't be printed, or both kinds of quotes.

    Example:
        >>> constant("p1"), constant("7"), constant("Mary")
        ('p1', '7', '"Mary"')
    """
    expect(text, str, "a constant", "give the text that it names")
    if _INTEGER.match(text) or (is_name(text) and not is_variable(text)):
        return text
    quote = "'" if '"' in text else '"'
    if not text or not text.isprintable() or quote in text:
        raise ClauseError(
            f"{text!r:.80} can't name a constant",
            name=text,
            suggestion="it has characters that can be printed, and one kind of quotes at most",
        )
    return f"{quote}{text}{quote}"


def is_constant(text: str) -> bool:
    """Tell whether a text is a constant as clauses and facts have it."""
    if _INTEGER.match(text) or (is_name(text) and not is_variable(text)):
        return True
    quoted = len(text) > 2 and text[0] in "\"'"
    with suppress(ClauseError):
        return quoted and constant(text[1:-1]) == text
    return False


def variables(*terms: str) -> tuple[str, ...]:
    """Return the variables among the terms, each once, in order."""
    return tuple(dict.fromkeys(term for term in terms if is_variable(term)))


def parse_signature(text: str) -> Atom:
    """Parse a predicate with its parameters, such as ``CenterOf(X, Y)``.

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    reader = Reader(text)
    atom = reader.atom()
    reader.end()
    if len(variables(*atom.arguments)) != len(atom.arguments):
        raise ClauseError(
            f"the parameters of '{atom.predicate}' must be different variables",
            name=atom.predicate,
            suggestion="write it as CenterOf(X, Y)",
        )
    return atom


def parse_sorted_signature(text: str) -> tuple[Atom, dict[str, str]]:
    """Parse an atom whose variables have sorts, such as ``CenterOf(P in pedestrian, ego)``.

    Returns:
        The atom, and variable → sort.

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    reader = Reader(text)
    atom, sorts = reader.sorted_atom()
    reader.end()
    return atom, sorts


def parse_facts(text: str) -> Iterator[FactText]:
    """Parse facts.

    Args:
        text: such as ``Pedestrian(p1): [0.76, 0.84]. CenterOf(p1, ego).``

    Yields:
        Each fact in the order of the text.

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    reader = Reader(text)
    while not reader.at_end():
        yield reader.fact()


def parse_ground_atom(text: str) -> Atom:
    """Parse one atom without variables, such as ``Vehicle(ego)``.

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    reader = Reader(text)
    atom = reader.ground_atom()
    reader.accept(".")
    reader.end()
    return atom


class _Token(NamedTuple):
    kind: str
    text: str
    offset: int


class Reader:
    """A recursive-descent parser over the tokens of one text.

    Every method that reads moves past what it read.

    Args:
        text: to be read.
        attributes: what has values, so that `>=` compares these.

    Attributes:
        attributes: as given.
        names: every name that was read, with its offset in the text.

    Raises:
        ClauseError: with the offset of what is wrong; so does every method that reads.
    """

    def __init__(self, text: str, attributes: Container[str] = ()) -> None:
        expect(text, str, "a clause", "give a text, such as Vehicle(ego).")
        if len(text) > MAXIMUM_TEXT:
            raise ClauseError(
                f"this text has {len(text)} characters; {MAXIMUM_TEXT} are the limit",
                suggestion="split it",
            )
        self._text = text
        self._tokens = list(_tokenise(text))
        self._position = 0
        self.attributes = attributes
        self.names: list[tuple[str, int]] = []

    @property
    def offset(self) -> int:
        """Where the next token stands."""
        return self._peek().offset

    def at_end(self) -> bool:
        """Tell whether all was read."""
        return self._peek().kind == "end"

    def sees(self, text: str, ahead: int = 0) -> bool:
        """Tell whether a text is the next token, or the one so many tokens ahead."""
        return self._peek(ahead).text == text

    def sees_any(self, texts: Container[str], ahead: int = 0) -> bool:
        """Tell whether one of some texts is the next token, or the one so many tokens ahead."""
        return self._peek(ahead).text in texts

    def sees_number(self) -> bool:
        """Tell whether a number is the next token."""
        return self._peek().kind == "number"

    def accept(self, text: str) -> bool:
        """Read a token if it is the next one, and tell whether it was."""
        if not self.sees(text):
            return False
        self._position += 1
        return True

    def expect(self, text: str, suggestion: str | None = None) -> None:
        """Read a token that must be the next one."""
        if not self.accept(text):
            raise self.unexpected(f"'{text}'", suggestion)

    def end(self) -> None:
        """Make sure that all was read."""
        if not self.at_end():
            raise self.unexpected("the end")

    def atom(self) -> Atom:
        """Read an atom without anonymous variables."""
        return self._atom(self.term)

    def pattern(self) -> Atom:
        """Read an atom of a body, which may have anonymous variables."""
        return self._atom(lambda: ANONYMOUS if self.accept(ANONYMOUS) else self.term())

    def _atom(self, argument: Callable[[], str]) -> Atom:
        predicate = self.name("a predicate")
        if predicate in OVER_TIME:
            raise self._over_time(predicate)
        if not self.accept("("):
            return self._proposition(predicate)
        arguments = [] if self.sees(")") else [argument()]
        while arguments and self.accept(","):
            arguments.append(argument())
        if not 0 < len(arguments) <= MAXIMUM_ARITY:
            raise self._of_no_arity(predicate, len(arguments))
        self.expect(")", f"the arguments of '{predicate}' end there")
        return Atom(predicate, tuple(arguments))

    def _proposition(self, predicate: str) -> Atom:
        if predicate not in _WORDS:
            return Atom(predicate, ())
        raise ClauseError(
            f"'{predicate}' is no predicate without arguments",
            name=predicate,
            suggestion="it is a word of bodies: call the predicate differently",
            offset=self.names[-1][1],
        )

    def _over_time(self, name: str) -> ClauseError:
        return ClauseError(
            f"'{name}' is an operator over time and no predicate",
            name=name,
            suggestion=f"it speaks of atoms of a body, as {name}(P(X)); call a predicate "
            "otherwise, as `sfol migrate` does in a file of version 1",
            offset=self.names[-1][1],
        )

    def _of_no_arity(self, predicate: str, count: int) -> ClauseError:
        if not count:
            return self.unexpected("an argument", f"without any it is written '{predicate}'")
        return ClauseError(
            f"'{predicate}' has more than {MAXIMUM_ARITY} arguments",
            name=predicate,
            suggestion="say it with several predicates that share one of them",
            offset=self.offset,
        )

    def sorted_atom(self) -> tuple[Atom, dict[str, str]]:
        """Read an atom whose variables have sorts, and return these, too."""
        sorts: dict[str, str] = {}
        return self._atom(lambda: self._sorted_argument(sorts)), sorts

    def _sorted_argument(self, sorts: dict[str, str]) -> str:
        offset = self._peek().offset
        argument = self.term()
        if not is_variable(argument):
            return argument
        if argument in sorts:
            raise ClauseError(
                f"the variable '{argument}' stands twice",
                name=argument,
                suggestion="take another one; both may be the same entity",
                offset=offset,
            )
        self.expect("in", f"a variable ranges over a sort: {argument} in pedestrian")
        sorts[argument] = self.name("a sort")
        return argument

    def ground_atom(self) -> Atom:
        """Read an atom that must have no variable."""
        start = self._peek().offset
        atom = self.atom()
        found = variables(*atom.arguments)
        if found:
            raise ClauseError(
                f"the fact {atom} has a variable, '{found[0]}'",
                name=found[0],
                suggestion="constants begin with a lower-case letter, or stand in quotes: "
                f'"{found[0]}"',
                offset=start,
            )
        return atom

    def fact(self) -> FactText:
        """Read a fact with its full stop."""
        atom = self.ground_atom()
        bound = confidence = value = None
        if self.accept("="):
            value = self.finite()
        elif self.accept(":"):
            if self.accept("["):
                lower = self.number()
                self.expect(",", "a bound is written [lower, upper]")
                bound = (lower, self.number())
                self.expect("]", "a bound is written [lower, upper]")
            else:
                confidence = self.number()
        self.expect(".", "a fact ends with a full stop")
        return FactText(atom, bound, confidence, value)

    def name(self, what: str) -> str:
        """Read a predicate or a variable; `what` names it in an error."""
        token = self._tokens[self._position]
        if token.kind != "name":
            raise self.unexpected(what)
        if token.text == ANONYMOUS:
            raise ClauseError(
                f"'{ANONYMOUS}' is {what} only of the literals P(X, _) and not P(X, _) of a body",
                name=token.text,
                suggestion="name the variable: it begins with an upper-case letter",
                offset=token.offset,
            )
        if not is_name(token.text):
            raise ClauseError(
                f"'{token.text}' is not a name",
                name=token.text,
                suggestion="names have letters a to z, digits and underscores",
                offset=token.offset,
            )
        self._position += 1
        self.names.append((token.text, token.offset))
        return token.text

    def term(self, what: str = "an argument") -> str:
        """Read a variable or a constant; `what` names it in an error."""
        token = self._tokens[self._position]
        if token.kind not in ("number", "quoted"):
            return self.name(what)
        try:
            return self._constant(token)
        except ClauseError as error:
            raise ClauseError(
                error.message, name=error.name, suggestion=error.suggestion, offset=token.offset
            ) from None

    def _constant(self, token: _Token) -> str:
        if token.kind == "quoted":
            self._position += 1
            return constant(token.text[1:-1])
        if not _INTEGER.match(token.text):
            raise ClauseError(
                f"'{token.text}' can't be a constant",
                name=token.text,
                suggestion=f"integers can, as 7 and -7, and what stands in quotes: '{token.text}'",
            )
        self._position += 1
        return token.text

    def number(self) -> float:
        """Read a number."""
        token = self._peek()
        if token.kind != "number":
            raise self.unexpected("a number")
        self._position += 1
        return float(token.text)

    def finite(self) -> float:
        """Read a number that is finite."""
        token = self._peek()
        value = self.number()
        if not math.isfinite(value):
            raise ClauseError(
                f"the number {token.text} is too great",
                name=token.text,
                suggestion="values are finite",
                offset=token.offset,
            )
        return value

    def share(self) -> float:
        """Read a number from 0 to 1."""
        token = self._peek()
        value = self.number()
        if not 0.0 <= value <= 1.0:
            raise ClauseError(
                f"a bound can't be {token.text}",
                name=token.text,
                suggestion="bounds are numbers from 0 to 1; what has others is an attribute",
                offset=token.offset,
            )
        return value

    def _peek(self, ahead: int = 0) -> _Token:
        return self._tokens[min(self._position + ahead, len(self._tokens) - 1)]

    def unexpected(self, expected: str, suggestion: str | None = None) -> ClauseError:
        """Return the error that something else is expected where the next token stands."""
        suggestion = torn_apart(self._text) or suggestion
        token = self._peek()
        suggestion = _INSTEAD.get(token.text.lower(), suggestion)
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
                suggestion=_INSTEAD.get(text[position]),
                offset=position,
            )
        if match.lastgroup and match.lastgroup != "space":
            yield _Token(match.lastgroup, match.group(), position)
        position = match.end()
    yield _Token("end", "", len(text))
