"""Formulas of reward terms: parsed, checked, evaluated; never executed as Python.

A formula has numbers, the names of signals and parameters, ``+ - * / **``, comparisons (which
give 1 or 0) and the functions of `FUNCTIONS`. Python's own parser reads the text into a syntax
tree; every node of it must be one of those kinds, and becomes a small function of the named
values. Nothing of the text is ever run.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from sfol import arrays
from sfol.arrays import Array
from sfol.errors import FormulaError, did_you_mean

MAXIMUM_LENGTH = 2_000
MAXIMUM_DEPTH = 40

Values = Mapping[str, Array]
_Evaluator = Callable[[Values], Array]

_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_UNARY: dict[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
}
_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}


def _clip(value: Array, low: Array, high: Array) -> Array:
    return arrays.minimum(arrays.maximum(value, low), high)


# name → (function of numbers, arrays or tensors, least and most arguments)
FUNCTIONS: Mapping[str, tuple[Callable[..., Array], int, int]] = {
    "abs": (abs, 1, 1),
    "exp": (arrays.exp, 1, 1),
    "log": (arrays.log, 1, 1),
    "sqrt": (arrays.sqrt, 1, 1),
    "min": (lambda *values: reduce(arrays.minimum, values), 2, 8),
    "max": (lambda *values: reduce(arrays.maximum, values), 2, 8),
    "clip": (_clip, 3, 3),
    "where": (arrays.where, 3, 3),
}


@dataclass(frozen=True)
class Formula:
    """A checked formula.

    Attributes:
        text: as written.
        names: the signals and parameters that it reads.

    Example:
        >>> Formula.parse("-(zeta * v**2 / (d + epsilon))")(dict(zeta=0.05, v=6, d=9, epsilon=1))
        -0.18
    """

    text: str
    names: frozenset[str]
    _evaluate: _Evaluator

    @classmethod
    def parse(cls, text: str) -> Formula:
        """Read a formula.

        Raises:
            FormulaError: with the offset of whatever is not in the grammar.
        """
        if len(text) > MAXIMUM_LENGTH:
            raise FormulaError(
                f"the formula has {len(text)} characters; {MAXIMUM_LENGTH} are the limit"
            )
        builder = _Builder()
        evaluate = builder.build(_python_tree(text), 0)
        return cls(text, frozenset(builder.names), evaluate)

    def check_names(self, known: Collection[str]) -> None:
        """Make sure that every name is a signal or a parameter.

        Raises:
            FormulaError: for the first name that is not known, with the most similar one.
        """
        for name in sorted(self.names - set(known)):
            raise FormulaError(
                f"the formula reads '{name}', which is no signal and no parameter",
                name=name,
                suggestion=did_you_mean(name, known),
                offset=self.text.find(name),
            )

    def __call__(self, values: Values) -> float:
        """Return the formula's value.

        Args:
            values: a number for every name in `names`, in the units of its signal.

        Raises:
            FormulaError: the result is NaN, or there is none (division by zero, overflow, the
                logarithm or root of a negative number).
        """
        try:
            result = float(self._evaluate(values))
        except (ArithmeticError, ValueError, TypeError) as error:
            raise self._no_number(str(error), values) from error
        if math.isnan(result):
            raise self._no_number("the result is NaN", values)
        return result

    def elementwise(self, values: Values) -> Array:
        """Return the formula's value for every element of arrays or tensors.

        Args:
            values: a number, array or tensor for every name in `names`, of shapes that broadcast.

        Raises:
            FormulaError: an element is NaN, or has no value (see `__call__`; torch gives infinity
                where numpy and plain numbers have an error).
        """
        try:
            with np.errstate(divide="raise", over="raise", invalid="raise"):
                result = self._evaluate(values)
        except (ArithmeticError, ValueError, TypeError) as error:
            raise self._no_number(str(error), {}) from error
        if arrays.has_nan(result):
            raise self._no_number("the result is NaN", {})
        return result

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"Formula({self.text!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        return Formula.parse, (self.text,)

    def _no_number(self, why: str, values: Values) -> FormulaError:
        given = ", ".join(f"{name} = {values[name]:.6g}" for name in sorted(self.names & {*values}))
        return FormulaError(
            f"the formula '{self.text}' has no value: {why}", suggestion=given or None
        )


def _python_tree(text: str) -> ast.expr:
    try:
        # A leading space or line break means something to Python and nothing to us.
        return ast.parse(f"({text}\n)", mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        column = getattr(error, "offset", None) or 1
        raise FormulaError(
            f"'{text}' is not a formula",
            name=text,
            suggestion="written like -(zeta * v**2 / (d + epsilon) + eta * (d == 0))",
            offset=max(column - 2, 0),
        ) from None


class _Builder:
    """Turns a Python syntax tree into nested functions, refusing what is not in the grammar."""

    def __init__(self) -> None:
        self.names: set[str] = set()

    def build(self, node: ast.expr, depth: int) -> _Evaluator:
        if depth > MAXIMUM_DEPTH:
            raise FormulaError(f"the formula is nested deeper than {MAXIMUM_DEPTH} levels")
        match node:
            case ast.Constant(value=bool() | str() | bytes() | None | complex()):
                raise _refused(node, f"{node.value!r} is not a number")
            case ast.Constant(value=int() | float() as number):
                return _constant(_finite(node, number))
            case ast.Name(id=name):
                self.names.add(name)
                return operator.itemgetter(name)
            case ast.UnaryOp() if type(node.op) in _UNARY:
                return _apply(_UNARY[type(node.op)], self.build(node.operand, depth + 1))
            case ast.BinOp() if type(node.op) in _BINARY:
                parts = [self.build(part, depth + 1) for part in (node.left, node.right)]
                return _apply(_BINARY[type(node.op)], *parts)
            case ast.Compare(ops=[op]) if type(op) in _COMPARISONS:
                parts = [self.build(part, depth + 1) for part in (node.left, node.comparators[0])]
                return _apply(_as_number(_COMPARISONS[type(op)]), *parts)
            case ast.Compare():
                raise _refused(node, "a chain of comparisons", "write (a < b) * (b < c)")
            case ast.Call():
                return self._call(node, depth)
        raise _refused(node, f"{type(node).__name__} in it")

    def _call(self, node: ast.Call, depth: int) -> _Evaluator:
        if not isinstance(node.func, ast.Name) or node.keywords:
            raise _refused(node, "this kind of call")
        name = node.func.id
        if name not in FUNCTIONS:
            raise _refused(node, f"the function '{name}'", did_you_mean(name, FUNCTIONS), name=name)
        function, least, most = FUNCTIONS[name]
        if not least <= len(node.args) <= most:
            count = str(least) if least == most else f"{least} to {most}"
            raise _refused(node, f"'{name}' with {len(node.args)} arguments", f"it takes {count}")
        return _apply(function, *(self.build(argument, depth + 1) for argument in node.args))


def _constant(value: float) -> _Evaluator:
    return lambda _: value


def _apply(function: Callable[..., Array], *arguments: _Evaluator) -> _Evaluator:
    if len(arguments) == 1:
        (only,) = arguments
        return lambda values: function(only(values))
    if len(arguments) == 2:
        left, right = arguments
        return lambda values: function(left(values), right(values))
    return lambda values: function(*(argument(values) for argument in arguments))


def _as_number(compare: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    return lambda left, right: 1.0 * compare(left, right)


def _finite(node: ast.expr, number: float) -> float:
    try:
        value = float(number)
    except OverflowError:
        value = math.inf
    if math.isinf(value):
        raise _refused(node, "an infinite number")
    return value


def _refused(
    node: ast.expr, what: str, suggestion: str | None = None, name: str | None = None
) -> FormulaError:
    return FormulaError(
        f"a formula has no room for {what}",
        name=name,
        suggestion=suggestion or f"numbers, names, + - * / **, comparisons, {', '.join(FUNCTIONS)}",
        offset=max(node.col_offset - 1, 0),
    )
