"""Comparisons of values: what a body says of the numbers that entities have.

The grammar, with `?` optional and `*` repeated; `[`, `(` and words in quotes are as they stand::

    compared  =  pattern ("<" | "<=" | ">" | ">=") number
              |  soft "(" pattern ("," number)* ("," option)* ")"
    soft      =  "below" | "above" | "between" | "near"
    option    =  ("margin" | "value_at_margin") "=" number | "shape" "=" name

A comparison is an atom of its own, whose predicate is `Compared`: its bounds are made of values
where facts enter, so that engines know of atoms alone. It means what the same words mean in a
formula, and a formula evaluates it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from sfol.arrays import Array
from sfol.errors import ClauseError, FormulaError, did_you_mean
from sfol.facts import Bound, Values
from sfol.formula import Formula
from sfol.soft_comparisons import SOFT_COMPARISONS
from sfol.syntax import Atom, Compared, Reader, placeholder

SIGNS = ("<=", "<", ">", ">=")
_VALUE = "value"
_NUMBERS, _TEXTS = ("margin", "value_at_margin"), ("shape",)


@dataclass(frozen=True)
class Comparison:
    """What is said of a value: ``… < 10``, or ``below(…, 10, margin=5)``.

    Attributes:
        name: a sign, or the name of a soft comparison.
        limits: what the value is compared with.
        options: those of a soft comparison, as they are written.
    """

    name: str
    limits: tuple[float, ...]
    options: tuple[tuple[str, float | str], ...] = ()

    def text(self, operands: Sequence[object]) -> str:
        """Return the comparison as it is written, of its only operand."""
        (compared,) = operands
        if self.name in SIGNS:
            return f"{compared} {self.name} {_written(self.limits[0])}"
        options = (f"{name}={_written(given)}" for name, given in self.options)
        inside = ", ".join([str(compared), *map(_written, self.limits), *options])
        return f"{self.name}({inside})"

    @cached_property
    def _formula(self) -> Formula:
        return Formula.parse(self.text((_VALUE,)))

    def check(self) -> None:
        """Make sure that it means something.

        Raises:
            FormulaError: it has too few or too many limits, or an option that means nothing.
        """
        assert self._formula

    def truth(self, value: float) -> float:
        """Return how true it is of a value, from 0 to 1."""
        return float(self._formula({_VALUE: value}))

    def truths(self, values: Array) -> Array:
        """Return how true it is of each of an array of values."""
        return self._formula.unchecked({_VALUE: values})

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.name, self.limits, self.options)


def compared_rows(predicate: Compared, values: Values) -> dict[tuple[str, ...], Bound]:
    """Return what a comparison comes to: a bound [c, c] for everything that has the value.

    Args:
        predicate: of the comparison.
        values: attribute → constants → value.
    """
    truth, rows = predicate.operator.truth, {}
    for constants, value in values.get(predicate.attribute, {}).items():
        true = truth(value)
        rows[constants] = Bound(true, true)
    return rows


def read_compared(reader: Reader) -> Atom:
    """Read an atom of a body, or a comparison of a value.

    Raises:
        ClauseError: with the offset of what is wrong.
    """
    if _sees_soft(reader):
        return _read_soft(reader)
    offset = reader.offset
    atom = reader.pattern()
    of_value = reader.sees(">=") and atom.predicate in reader.attributes
    if of_value or reader.sees_any(("<", "<=", ">")):
        sign = next(sign for sign in SIGNS if reader.accept(sign))
        return compared(Comparison(sign, (_limit(reader),)), atom)
    if atom.predicate in reader.attributes:
        raise ClauseError(
            f"'{atom.predicate}' is an attribute: it has a value, and is neither true nor false",
            name=atom.predicate,
            suggestion=f"compare it: {atom} < 10, or below({atom}, 10, margin=5)",
            offset=offset,
        )
    return atom


def _sees_soft(reader: Reader) -> bool:
    """Tell whether a soft comparison comes next: a predicate may be called like one."""
    is_called = reader.sees_any(SOFT_COMPARISONS) and reader.sees("(", ahead=1)
    return is_called and (reader.sees("(", ahead=3) or reader.sees_any(reader.attributes, ahead=2))


def _read_soft(reader: Reader) -> Atom:
    offset = reader.offset
    name = reader.name("a comparison")
    reader.expect("(")
    atom = reader.pattern()
    limits: list[float] = []
    options: list[tuple[str, float | str]] = []
    while reader.accept(","):
        if reader.sees("=", ahead=1):
            options.append(_read_option(reader))
        else:
            limits.append(_limit(reader))
    reader.expect(")", f"what '{name}' compares ends there")
    comparison = Comparison(name, tuple(limits), tuple(options))
    try:
        comparison.check()
    except FormulaError as error:
        raise ClauseError(
            error.message.replace("a formula", "a comparison", 1),
            name=error.name,
            suggestion=error.suggestion,
            offset=offset,
        ) from None
    return compared(comparison, atom)


def _read_option(reader: Reader) -> tuple[str, float | str]:
    offset = reader.offset
    option = reader.name("an option")
    if option not in (*_NUMBERS, *_TEXTS):
        raise ClauseError(
            f"a comparison has no '{option}'",
            name=option,
            suggestion=did_you_mean(option, (*_NUMBERS, *_TEXTS)),
            offset=offset,
        )
    reader.expect("=")
    return option, reader.name("a shape") if option in _TEXTS else reader.finite()


def _limit(reader: Reader) -> float:
    if not reader.sees_number():
        raise reader.unexpected("a number", "a value is compared with a number: Speed(X) < 10")
    return reader.finite()


def compared(comparison: Comparison, atom: Atom) -> Atom:
    """Return what a comparison says of an attribute: an atom with the same arguments."""
    numbered = tuple(placeholder(number) for number in range(len(atom.arguments)))
    return Atom(Compared(comparison, (Atom(atom.predicate, numbered),)), atom.arguments)


def _written(given: float | str) -> str:
    return given if isinstance(given, str) else repr(given).removesuffix(".0")
