"""Operators over time: what a body says of steps that have passed.

Each operator is a class that says how it is written, what it remembers from step to step, and what
it makes of that. What it says of entities is an atom of its own, whose predicate is `Timed`; its
bounds are given to the engines like facts, so that these know nothing of time.

Memories are values: mappings of tuples that nobody changes, whose size depends on the longest
window and on how many atoms are known, but not on how many steps were taken.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Protocol

from sfol.comparisons import read_compared
from sfol.errors import ClauseError, did_you_mean
from sfol.facts import TRUE, Bound
from sfol.operators import TOLERANCE, least, negation
from sfol.soft_comparisons import SOFT_COMPARISONS
from sfol.syntax import (
    ANONYMOUS,
    OVER_TIME,
    Atom,
    Reader,
    Timed,
    is_variable,
    placeholder,
)

MAXIMUM_DEPTH = 4
_FOR_EVER = 2.0**53  # steps; no episode has so many
HOLDS = 0.5  # the least 1 − u of a negated literal, unless a rule says otherwise

Constants = tuple[str, ...]
Rows = Mapping[Constants, Bound]
# What an operator remembers of each of its atoms; what that is, only the operator knows.
Remembered = Mapping[Constants, Any]
# The steps of a window that can still be the greatest, with their numbers: the greatest first.
_Queue = tuple[tuple[int, float], ...]


class KnownAtoms(Protocol):
    """The known atoms of a step."""

    def bound(self, atom: Atom) -> Bound | None:
        """Return the bound of a ground atom, or None if it is unknown."""
        ...

    def rows(self, predicate: str) -> Rows:
        """Return all known atoms of a predicate: arguments → bound."""
        ...


@dataclass(frozen=True)
class Memory:
    """All that an episode remembers of its steps: a value, to be kept, copied and pickled.

    Attributes:
        step: how many steps were taken.
        atoms: what operators over time remember: text of the operator → its atoms.
        weights: the smoothed weights of the last step.
    """

    step: int = 0
    atoms: Mapping[str, Remembered] = field(default_factory=dict)
    weights: Mapping[str, float] = field(default_factory=dict)


class Moment(NamedTuple):
    """What an operator is told of a step.

    Attributes:
        step: the step's number, from 0.
        window: how many steps its duration is.
        rows: the known atoms of its last operand: arguments of the operator → bound.
        first: returns the bound of its first operand under such arguments.
    """

    step: int
    window: int
    rows: Rows
    first: Callable[[Constants], Bound | None]

    @classmethod
    def of(cls, predicate: Timed, known: KnownAtoms, step: int, window: int) -> Moment:
        """Return what a predicate's operator is told of the known atoms of a step."""
        first, last = predicate.operands[0], predicate.operands[-1]
        return cls(step, window, _rows(last, known), _lookup(first, known))


class TemporalOperator(ABC):
    """An operator over time; its subclasses are frozen dataclasses.

    Attributes:
        name: as it is written.
        operands: how many atoms it speaks of.
        strict: whether what it says depends on earlier steps alone.
    """

    name: ClassVar[str]
    operands: ClassVar[int] = 1
    strict: ClassVar[bool] = False

    @property
    def duration(self) -> float | None:
        """How far it looks back, in the unit of `time`; None if it has no window."""
        return None

    def text(self, operands: Sequence[object]) -> str:
        """Return the operator as it is written, applied to operands."""
        return f"{self.name}({', '.join(map(str, operands))})"

    @classmethod
    def parse(cls, reader: Reader, depth: int) -> Atom:
        """Read it with its operands."""
        reader.expect("(", f"it is written {cls.name}(P(X))")
        operands = cls._read_operands(reader, depth)
        made = cls()
        reader.expect(")", f"what '{cls.name}' speaks of ends there")
        return applied(made, operands)

    @classmethod
    def _read_operands(cls, reader: Reader, depth: int) -> list[Atom]:
        operands = [read_pattern(reader, depth + 1)]
        while len(operands) < cls.operands:
            reader.expect(",", f"'{cls.name}' speaks of {cls.operands} atoms")
            operands.append(read_pattern(reader, depth + 1))
        return operands

    @abstractmethod
    def advance(self, before: Remembered, moment: Moment) -> tuple[Remembered, Rows]:
        """Take one step.

        Args:
            before: what it remembered after the step before; nothing at first.
            moment: the step.

        Returns:
            What it remembers after the step, and the bounds of its own atoms at the step.
        """

    def when(self, remembered: Any, step: int, said: Callable[[int], str]) -> str:
        """Return since when, or until when, what it says of an atom was so.

        Args:
            remembered: what it remembers of the atom after a step; None if nothing.
            step: that step.
            said: returns a number of steps as a duration.
        """
        return "remembered"


@dataclass(frozen=True)
class Previously(TemporalOperator):
    """``previously(A)``: the bound of A one step before.

    Source: Y of past-time linear temporal logic; O. Lichtenstein, A. Pnueli, L. Zuck, "The glory of
    the past", 1985.
    """

    name: ClassVar[str] = "previously"
    strict: ClassVar[bool] = True

    def advance(self, before: Remembered, moment: Moment) -> tuple[Remembered, Rows]:
        return dict(moment.rows), before

    def when(self, remembered: Any, step: int, said: Callable[[int], str]) -> str:
        return f"{said(1)} ago"


@dataclass(frozen=True)
class _Window(TemporalOperator):
    """An operator that looks back so far, in the unit of `time`."""

    back: float

    @property
    def duration(self) -> float:
        return self.back

    def text(self, operands: Sequence[object]) -> str:
        return f"{self.name}[{_number(self.back)}]({', '.join(map(str, operands))})"

    @classmethod
    def parse(cls, reader: Reader, depth: int) -> Atom:
        offset = reader.offset
        reader.expect("[", f"say how far back: {cls.name}[1.5](P(X))")
        back = reader.number()
        if not 0.0 < back < math.inf:
            raise ClauseError(
                f"'{cls.name}' can't look back {_number(back)}",
                name=cls.name,
                suggestion=f"give a finite duration above 0: {cls.name}[1.5](P(X))",
                offset=offset,
            )
        reader.expect("]", f"the duration of '{cls.name}' ends there")
        reader.expect("(", f"it is written {cls.name}[{_number(back)}](P(X))")
        operands = cls._read_operands(reader, depth)
        reader.expect(")", f"what '{cls.name}' speaks of ends there")
        return applied(cls(back), operands)


@dataclass(frozen=True)
class Once(_Window):
    """``once[d](A)``: the greatest bound of A over the last d, lower and upper.

    Source: the bounded past operator O of signal temporal logic; O. Maler, D. Nickovic, "Monitoring
    temporal properties of continuous signals", 2004. The greatest of a window is kept as in
    D. Lemire, "Streaming maximum-minimum filter", 2006.
    """

    name: ClassVar[str] = "once"

    def advance(self, before: Remembered, moment: Moment) -> tuple[Remembered, Rows]:
        queues: dict[Constants, tuple[_Queue, _Queue]] = {}
        for constants in (*before, *(key for key in moment.rows if key not in before)):
            lowers, uppers = before.get(constants, ((), ()))
            lower, upper = moment.rows.get(constants, (None, None))
            lowers, uppers = _grown(lowers, lower, moment), _grown(uppers, upper, moment)
            if lowers:
                queues[constants] = lowers, uppers
        rows = {key: Bound(low[0][1], up[0][1]) for key, (low, up) in queues.items()}
        return queues, rows

    def when(self, remembered: Any, step: int, said: Callable[[int], str]) -> str:
        _, uppers = remembered
        true = [at for at, upper in uppers if upper > 0.0]
        if not true:
            return "false all the time"
        return "true now" if true[-1] == step else f"last true {said(step - true[-1])} ago"


@dataclass(frozen=True)
class Held(_Window):
    """``held[d](A)``: the least bound of A over the last d, if A was known all the time.

    Source: the bounded past operator H of signal temporal logic; see `Once`.
    """

    name: ClassVar[str] = "held"

    def advance(self, before: Remembered, moment: Moment) -> tuple[Remembered, Rows]:
        # The least are kept as the greatest of the numbers below zero.
        queues: dict[Constants, tuple[int, _Queue, _Queue]] = {}
        for constants, (lower, upper) in moment.rows.items():
            start, lowers, uppers = before.get(constants, (moment.step, (), ()))
            lowers, uppers = _grown(lowers, -lower, moment), _grown(uppers, -upper, moment)
            queues[constants] = start, lowers, uppers
        rows = {
            key: Bound(-low[0][1], -up[0][1])
            for key, (start, low, up) in queues.items()
            if moment.step - start >= moment.window
        }
        return queues, rows

    def when(self, remembered: Any, step: int, said: Callable[[int], str]) -> str:
        return f"known for {said(step - remembered[0])}"


@dataclass(frozen=True)
class Since(TemporalOperator):
    """``since(A, B)``: B held at some step, and A at every later one.

    Its bound is the greatest, over such steps, of the least of B's bound there and A's bounds
    after it.

    Source: S of past-time temporal logic, with minimum and maximum as in signal temporal logic; see
    `Once`.
    """

    name: ClassVar[str] = "since"
    operands: ClassVar[int] = 2

    @classmethod
    def _read_operands(cls, reader: Reader, depth: int) -> list[Atom]:
        offset = reader.offset
        kept, begun = super()._read_operands(reader, depth)
        for term in kept.arguments:
            if term == ANONYMOUS or (is_variable(term) and term not in begun.arguments):
                raise ClauseError(
                    f"'{term}' stands in {kept}, but not in {begun}, with which 'since' begins",
                    name=term,
                    suggestion=f"let a rule conclude {kept.predicate} of what {begun} names",
                    offset=offset,
                )
        return [kept, begun]

    def advance(self, before: Remembered, moment: Moment) -> tuple[Remembered, Rows]:
        bounds: dict[Constants, Bound] = {}
        for constants, bound in before.items():
            kept = moment.first(constants)
            if kept is not None:
                bounds[constants] = Bound(min(kept[0], bound[0]), min(kept[1], bound[1]))
        for constants, begun in moment.rows.items():
            old = bounds.get(constants, begun)
            bounds[constants] = Bound(max(begun[0], old[0]), max(begun[1], old[1]))
        return bounds, bounds


@dataclass(frozen=True)
class Latched(TemporalOperator):
    """``latched(A, on=0.7, off=0.3)``: from where A's confidence reaches on until it is below off.

    Its atom is [1, 1] while it is so and otherwise unknown. The confidence is the midpoint of A's
    bound, and 0 where A is unknown.

    Source: O. H. Schmitt, "A thermionic trigger", 1938.
    """

    name: ClassVar[str] = "latched"

    on: float
    off: float

    def text(self, operands: Sequence[object]) -> str:
        shown = ", ".join(map(str, operands))
        return f"{self.name}({shown}, on={_number(self.on)}, off={_number(self.off)})"

    @classmethod
    def parse(cls, reader: Reader, depth: int) -> Atom:
        offset = reader.offset
        form = "it is written latched(P(X), on=0.7, off=0.3)"
        reader.expect("(", form)
        operands = cls._read_operands(reader, depth)
        on, off = (cls._setting(reader, name, form) for name in ("on", "off"))
        if not 0.0 < off <= on:
            raise ClauseError(
                f"'latched' goes on at {_number(on)} and off below {_number(off)}",
                name=cls.name,
                suggestion="0 < off ≤ on ≤ 1",
                offset=offset,
            )
        reader.expect(")", form)
        return applied(cls(on, off), operands)

    @staticmethod
    def _setting(reader: Reader, name: str, form: str) -> float:
        for text in (",", name, "="):
            reader.expect(text, form)
        return reader.share()

    def advance(self, before: Remembered, moment: Moment) -> tuple[Remembered, Rows]:
        on, off = least(self.on), least(self.off)
        begun = {
            constants: before.get(constants, moment.step)
            for constants, (lower, upper) in moment.rows.items()
            if (lower + upper) / 2 >= (off if constants in before else on)
        }
        return begun, dict.fromkeys(begun, TRUE)

    def when(self, remembered: Any, step: int, said: Callable[[int], str]) -> str:
        return f"on for {said(step - remembered)}"


@dataclass(frozen=True)
class Rose(TemporalOperator):
    """``rose(A)``: A, and not previously A; the least of both bounds where both hold."""

    name: ClassVar[str] = "rose"

    def advance(self, before: Remembered, moment: Moment) -> tuple[Remembered, Rows]:
        return dict(moment.rows), _changed(moment.rows, before)


@dataclass(frozen=True)
class Fell(TemporalOperator):
    """``fell(A)``: previously A, and not A; the least of both bounds where both hold."""

    name: ClassVar[str] = "fell"

    def advance(self, before: Remembered, moment: Moment) -> tuple[Remembered, Rows]:
        return dict(moment.rows), _changed(before, moment.rows)


OPERATORS: Mapping[str, type[TemporalOperator]] = MappingProxyType(
    {kind.name: kind for kind in (Previously, Once, Held, Since, Latched, Rose, Fell)}
)
assert tuple(OPERATORS) == OVER_TIME


def read_pattern(reader: Reader, depth: int = 0) -> Atom:
    """Read an atom of a body, a comparison of a value, or what an operator says of some of them.

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    offset = reader.offset
    kind = next((found for name, found in OPERATORS.items() if reader.sees(name)), None)
    if kind is None:
        if depth:
            _check_is_not_negated(reader)
        _check_is_predicate(reader)
        return read_compared(reader)
    if depth == MAXIMUM_DEPTH:
        raise ClauseError(
            f"operators over time stand in each other more than {MAXIMUM_DEPTH} deep",
            name=kind.name,
            suggestion="let a rule of its own conclude what stands in some of them",
            offset=offset,
        )
    reader.name("an operator")
    return kind.parse(reader, depth)


def _check_is_not_negated(reader: Reader) -> None:
    if reader.sees("not") and not reader.sees("(", ahead=1):
        raise ClauseError(
            "an operator over time speaks of atoms, and 'not' makes none",
            name="not",
            suggestion="write not before the operator, or let a rule conclude what is not so",
            offset=reader.offset,
        )


def _check_is_predicate(reader: Reader) -> None:
    """Make sure that what comes next is no misspelt operator."""
    if reader.sees_any(SOFT_COMPARISONS):
        return
    speaks_of_atom = reader.sees("(", ahead=1) and reader.sees("(", ahead=3)
    if not speaks_of_atom and not reader.sees("[", ahead=1):
        return
    offset = reader.offset
    name = reader.name("a predicate")
    raise ClauseError(
        f"there is no operator over time '{name}', nor a comparison",
        name=name,
        suggestion=did_you_mean(name, (*OPERATORS, *SOFT_COMPARISONS)),
        offset=offset,
    )


def applied(operator: TemporalOperator, operands: Sequence[Atom]) -> Atom:
    """Return what an operator says of some atoms: an atom whose arguments are their variables."""
    arguments: list[str] = []

    def numbered(term: str) -> str:
        if term != ANONYMOUS and not is_variable(term):
            return term
        if term == ANONYMOUS or term not in arguments:  # each _ is a variable of its own
            arguments.append(term)
            return placeholder(len(arguments) - 1)
        return placeholder(arguments.index(term))

    numbered_operands = tuple(
        Atom(atom.predicate, tuple(map(numbered, atom.arguments))) for atom in operands
    )
    return Atom(Timed(operator, numbered_operands), tuple(arguments))


def steps_of(duration: float, step: float) -> int:
    """Return how many whole steps a duration is, up to rounding."""
    return int(min(duration / step * (1.0 + TOLERANCE), _FOR_EVER))


def smoothed(old: float, new: float, constant: float, step: float) -> float:
    """Return a number that follows another one, one step later.

    Args:
        old: what it was.
        new: what it follows, the same during the step.
        constant: after how long a difference is left of 1/e; 0 follows at once.
        step: the length of the step, in the same unit.

    Source: the exact solution of the first-order lag, ds/dt = (w − s)/τ, over the step.
    """
    return new if not constant else new + (old - new) * math.exp(-step / constant)


def _grown(queue: _Queue, number: float | None, moment: Moment) -> _Queue:
    """Return the queue of a window without what is too old or can't be the greatest any more."""
    oldest = moment.step - moment.window
    if number is None:
        return tuple([entry for entry in queue if entry[0] >= oldest])
    kept = [entry for entry in queue if entry[0] >= oldest and entry[1] > number]
    return (*kept, (moment.step, number))


def _changed(true: Rows, false: Rows) -> dict[Constants, Bound]:
    """Return the least of A's bounds where it holds, and of not A's elsewhere, where both hold."""
    changed = {}
    for constants, bound in true.items():
        other = false.get(constants)
        opposite = TRUE if other is None else negation(other)
        if bound[1] > 0.0 and opposite[0] >= least(HOLDS):
            changed[constants] = Bound(min(bound[0], opposite[0]), min(bound[1], opposite[1]))
    return changed


def _rows(operand: Atom, known: KnownAtoms) -> Rows:
    """Return the known atoms of an operand that has all arguments of its operator."""
    rows = known.rows(operand.predicate)
    if operand.arguments == tuple(placeholder(n) for n in range(len(operand.arguments))):
        return rows
    found = {}
    for constants, bound in rows.items():
        values: dict[str, str] = {}
        fits = all(
            (values.setdefault(term, constant) if term[0] == "{" else term) == constant
            for term, constant in zip(operand.arguments, constants, strict=True)
        )
        if fits:
            found[tuple(values[placeholder(n)] for n in range(len(values)))] = bound
    return found


def _lookup(operand: Atom, known: KnownAtoms) -> Callable[[Constants], Bound | None]:
    def bound(constants: Constants) -> Bound | None:
        values = {placeholder(n): constant for n, constant in enumerate(constants)}
        return known.bound(operand.substituted(values))

    return bound


def _number(value: float) -> str:
    return repr(value).removesuffix(".0")
