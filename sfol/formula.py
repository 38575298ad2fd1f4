"""Formulas: parsed, checked, evaluated; never executed as Python.

A formula has numbers, names, ``+ - * / **``, comparisons (which give 1 or 0), the functions of
`FUNCTIONS`, the comparisons of `SOFT_COMPARISONS`, and `QUANTIFIERS` over entities. The names are
those of signals and parameters, or of what is observed, as ``ego.speed``. Python's own parser reads
the text into a tree; every node of it must be one of those kinds, and becomes a small function of
the named values. Nothing of the text is ever run. What the operations give is said in
`sfol.arithmetic`, `sfol.soft_comparisons` and `sfol.quantifiers`.
"""

from __future__ import annotations

import ast
import keyword
import math
import operator
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from sfol import arrays
from sfol.arithmetic import COMPARISONS, FUNCTIONS, OPERATORS, SIGNS, Operation
from sfol.arrays import Array
from sfol.errors import FormulaError, did_you_mean, expect, torn_apart
from sfol.quantifiers import QUANTIFIERS, Quantifier
from sfol.soft_comparisons import DEFAULT_SHAPE, DEFAULT_VALUE, SHAPES, SOFT_COMPARISONS

MAXIMUM_LENGTH = 2_000
MAXIMUM_DEPTH = 40

# name → number or array; key of a range → mappings of numbers by name, or `Entities`.
Values = Mapping[str, Any]
_Evaluator = Callable[[Values], Array]


class _Kind(NamedTuple):
    """How a formula is evaluated.

    Attributes:
        function: which function of an operation is meant.
        name: how a name is read.
        over: how a quantifier goes through entities.
    """

    function: Callable[[Operation], Callable[..., Array]]
    name: Callable[[str], _Evaluator]
    over: Callable[[Quantifier, Range, _Evaluator], _Evaluator]


@dataclass(frozen=True)
class Range:
    """The entities that a quantifier goes through, as in ``min(P.x for P in person)``.

    Attributes:
        variable: what one of them is called, ``P``.
        sort: which they are: ``person``, or ``next.person``.
        names: what is read of each: ``P.x``.
    """

    variable: str
    sort: str
    names: frozenset[str]

    @property
    def key(self) -> str:
        """The name of the entities among the values of a formula."""
        return f"{self.variable} in {self.sort}"


class Entities(NamedTuple):
    """The entities of a range, for arrays.

    Attributes:
        numbers: name, such as ``P.x`` → an array (n, ...), with a number for each along an axis
            that no other value has.
        there: truth values (n, ...): which of them there are.
    """

    numbers: Mapping[str, Array]
    there: Array


class _Reads:
    """What a formula reads, found while it is built."""

    def __init__(self) -> None:
        self.names: set[str] = set()
        self.ranges: list[Range] = []


_BINARY: Mapping[type[ast.operator], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Pow: "**",
}
_UNARY: Mapping[type[ast.unaryop], str] = {ast.UAdd: "+", ast.USub: "-"}
_COMPARISONS: Mapping[type[ast.cmpop], str] = {
    ast.Eq: "==",
    ast.NotEq: "!=",
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
}
# What other languages write → what a formula says instead.
_OTHER_WORDS: Mapping[type[ast.AST], str] = {
    ast.BitXor: "a power is written v**2",
    ast.BoolOp: "write (a < b) * (b < c) for and, max(a, b) for or",
    ast.Not: "write 1 - x, or x == 0",
    ast.IfExp: "write where(condition, then, otherwise)",
}
_WORD = re.compile(r"[^\W\d]\w*")
_CALLED = (*FUNCTIONS, *SOFT_COMPARISONS, *(name for name in QUANTIFIERS if name not in FUNCTIONS))


@dataclass(frozen=True)
class Formula:
    """A checked formula.

    Attributes:
        text: as written.
        names: what it reads: signals and parameters, or what is observed, dots and all.
        ranges: the entities that its quantifiers go through; what is read of them is not among
            `names`.

    Example:
        >>> Formula.parse("-(zeta * v**2 / (d + epsilon))")(dict(zeta=0.05, v=6, d=9, epsilon=1))
        -0.18
    """

    text: str
    names: frozenset[str]
    ranges: tuple[Range, ...]
    _tree: ast.expr
    _evaluate: _Evaluator

    @classmethod
    def parse(cls, text: str) -> Formula:
        """Read a formula.

        Raises:
            FormulaError: with the offset of whatever is not in the grammar.
        """
        expect(text, str, "a formula", "give a text, such as -xi * v**2")
        if len(text) > MAXIMUM_LENGTH:
            raise FormulaError(
                f"the formula has {len(text)} characters; {MAXIMUM_LENGTH} are the limit"
            )
        tree = _python_tree(text)
        reads = _Reads()
        evaluate = _built(tree, _NUMBERS, reads)
        return cls(text, frozenset(reads.names), tuple(reads.ranges), tree, evaluate)

    def check_names(self, known: Collection[str]) -> None:
        """Make sure that every name is a signal, a parameter or a head.

        Raises:
            FormulaError: for the first name that is not known, with the most similar one; or it
                goes through entities.
        """
        for entities in self.ranges:
            raise FormulaError(
                f"the formula goes through '{entities.sort}', and only facts and signals can",
                name=entities.sort,
                suggestion="read a signal of yours that does",
                offset=self.offset_of(entities.sort),
            )
        for name in sorted(self.names - set(known)):
            raise FormulaError(
                f"the formula reads '{name}', which is no signal, parameter or head of the subject",
                name=name,
                suggestion=f"read a signal of yours that is observed from: {name}"
                if "." in name
                else did_you_mean(name, known),
                offset=self.offset_of(name),
            )

    def offset_of(self, name: str) -> int:
        """Return where in the text a name that the formula reads stands first."""
        pattern = r"\s*\.\s*".join(map(re.escape, name.split(".")))
        found = re.search(rf"(?<![\w.]){pattern}(?!\w)", self.text)
        return found.start() if found else 0

    def __call__(self, values: Mapping[str, float]) -> float:
        """Return the formula's value.

        Args:
            values: a number for every name in `names`, in the units of its signal.

        Raises:
            FormulaError: there is no finite value (division by zero, overflow, the logarithm or
                root of a negative number), or a name's value is no number.
        """
        result: float = self._evaluate(values)
        if not math.isfinite(result):
            raise self._no_number(values)
        return result

    def maybe_infinite(self, values: Mapping[str, float]) -> float:
        """Return the formula's value as `__call__` does, but let it be infinite.

        Raises:
            FormulaError: the value is NaN, or a name's value is no number.
        """
        result: float = self._evaluate(values)
        if math.isnan(result):
            raise self._no_number(values)
        return result

    def elementwise(self, values: Values) -> Array:
        """Return the formula's value for every element of arrays or tensors.

        Args:
            values: a float, array or tensor of real numbers for every name in `names`, of shapes
                that broadcast and of one type.

        Raises:
            FormulaError: an element has no finite value, see `__call__`.
        """
        with np.errstate(all="ignore"):
            result = self._evaluate_arrays(values)
        if not arrays.is_finite(result):
            raise self._no_numbers(values, result)
        return result

    def unchecked(self, values: Values) -> Array:
        """Return the formula's value for arrays as `elementwise` does, whatever it is.

        Args:
            values: see `elementwise`; and `Entities` by the key of each range in `ranges`.
        """
        with np.errstate(all="ignore"):
            return self._evaluate_arrays(values)

    @cached_property  # few formulas are asked for many scenes at once
    def _evaluate_arrays(self) -> _Evaluator:
        return _built(self._tree, _ARRAYS, _Reads())

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"Formula({self.text!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        return Formula.parse, (self.text,)

    def _no_numbers(self, values: Values, result: Array) -> FormulaError:
        """Return the error for the first scene without a value."""
        if not arrays.is_array(result):
            return self._no_number({name: float(values[name]) for name in self.names})
        scene = [math.isfinite(value) for value in result.reshape(-1).tolist()].index(False)

        def there(value: Array) -> float:
            return float(value.reshape(-1)[scene] if getattr(value, "ndim", 0) else value)

        return self._no_number({name: there(values[name]) for name in self.names}, scene)

    def _no_number(self, values: Mapping[str, float], scene: int | None = None) -> FormulaError:
        where = "" if scene is None else f" in scene {scene}"
        part, value = next(self._parts_without_value(values), (self.text, "not finite"))
        given = ", ".join(f"{name} = {values[name]:.6g}" for name in sorted(self.names))
        return FormulaError(
            f"the formula '{self.text}' has no value{where}: {part} is {value}",
            suggestion=given or None,
        )

    def _parts_without_value(self, values: Mapping[str, float]) -> Iterator[tuple[str, str]]:
        """Yield the parts that are not finite, the innermost first, with what they are."""
        nodes = list(ast.walk(self._tree))
        within = {
            inner
            for node in nodes
            if isinstance(node, ast.GeneratorExp)
            for inner in ast.walk(node)
        }
        for node in reversed(nodes):
            if isinstance(node, ast.BinOp | ast.Call | ast.UnaryOp) and node not in within:
                value = _built(node, _NUMBERS, _Reads())(values)
                if not math.isfinite(value):
                    yield ast.unparse(node), "not a number" if math.isnan(value) else "infinite"


def _number(name: str) -> _Evaluator:
    """Return what reads a name's number, of whichever type, as Python's own."""

    def read(values: Values) -> float:
        value = values[name]
        if type(value) is float:
            return value
        number = arrays.as_float(value)
        if number is None:
            raise FormulaError(f"'{name}' is {value!r:.80}", name=name, suggestion="give a number")
        return number

    return read


def _over_numbers(quantifier: Quantifier, entities: Range, inner: _Evaluator) -> _Evaluator:
    key = entities.key
    return lambda values: quantifier.of_numbers(
        [inner({**values, **numbers}) for numbers in values[key]]
    )


def _over_arrays(quantifier: Quantifier, entities: Range, inner: _Evaluator) -> _Evaluator:
    def evaluate(values: Values) -> Array:
        found: Entities = values[entities.key]
        return quantifier.of_arrays(inner({**values, **found.numbers}), found.there)

    return evaluate


_NUMBERS = _Kind(operator.attrgetter("of_numbers"), _number, _over_numbers)
_ARRAYS = _Kind(operator.attrgetter("of_arrays"), operator.itemgetter, _over_arrays)


def _python_tree(text: str) -> ast.expr:
    try:
        # A leading space or line break means something to Python and nothing to us.
        return ast.parse(f"({text}\n)", mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        column = getattr(error, "offset", None) or 1
        raise _unreadable(text, max(column - 2, 0)) from None


def can_be_read(name: str) -> bool:
    """Tell whether a formula can have a name for a signal or parameter."""
    return name.isidentifier() and not keyword.iskeyword(name)


def check_formula_name(name: str) -> None:
    """Make sure that a formula can read a signal or parameter of this name.

    Raises:
        FormulaError: it can't, since the name is a reserved word, or none at all.
    """
    if keyword.iskeyword(name):
        raise _reserved(name, 0)
    if not can_be_read(name):
        raise FormulaError(
            f"'{name}' is not a name that a formula can read",
            name=name,
            suggestion="names have letters, digits and underscores",
        )


def _reserved(word: str, offset: int) -> FormulaError:
    return FormulaError(
        f"'{word}' is a reserved word, which no name in a formula can be",
        name=word,
        suggestion=f"call it {word}_",
        offset=offset,
    )


def _unreadable(text: str, offset: int) -> FormulaError:
    reserved = next((word for word in _WORD.finditer(text) if keyword.iskeyword(word[0])), None)
    if reserved:
        return _reserved(reserved[0], reserved.start())
    return FormulaError(
        f"'{text}' is not a formula",
        name=text,
        suggestion=torn_apart(text)
        or "written like -(zeta * v**2 / (d + epsilon) + eta * (d == 0))",
        offset=offset,
    )


def _built(node: ast.expr, kind: _Kind, reads: _Reads, depth: int = 0) -> _Evaluator:
    """Return a tree as nested functions, refusing what is not in the grammar.

    Args:
        node: the tree.
        kind: how it will be evaluated.
        reads: what it reads is added here.
        depth: of the node within the formula.
    """
    if depth > MAXIMUM_DEPTH:
        raise FormulaError(f"the formula is nested deeper than {MAXIMUM_DEPTH} levels")

    match node:
        case ast.Constant(value=bool() | str() | bytes() | None | complex()):
            raise _refused(node, f"{node.value!r} is not a number")
        case ast.Constant(value=int() | float() as number):
            return _constant(_finite(node, number))
        case ast.Name() | ast.Attribute() if (name := _dotted(node)) is not None:
            reads.names.add(name)
            return kind.name(name)
        case ast.Call(args=[ast.GeneratorExp() as each]):
            return _over_entities(node, each, kind, reads, depth + 1)
    operation, parts = _operation(node)
    evaluators = [_built(part, kind, reads, depth + 1) for part in parts]
    return _apply(kind.function(operation), *evaluators)


def _operation(node: ast.expr) -> tuple[Operation, list[ast.expr]]:
    """Return what a node does, and what it does it to."""
    match node:
        case ast.UnaryOp() if type(node.op) in _UNARY:
            return SIGNS[_UNARY[type(node.op)]], [node.operand]
        case ast.BinOp() if type(node.op) in _BINARY:
            return OPERATORS[_BINARY[type(node.op)]], [node.left, node.right]
        case ast.Compare(ops=[op]) if type(op) in _COMPARISONS:
            return COMPARISONS[_COMPARISONS[type(op)]], [node.left, *node.comparators]
        case ast.Compare():
            raise _refused(node, "a chain of comparisons", "write (a < b) * (b < c)")
        case ast.Call():
            return _called(node)
    raise _refused(node, f"'{ast.unparse(node):.40}'", _instead(node))


def _over_entities(
    node: ast.Call, each: ast.GeneratorExp, kind: _Kind, reads: _Reads, depth: int
) -> _Evaluator:
    quantifier, variable, sort = _quantified(node, each)
    inner = _Reads()
    evaluator = _built(each.elt, kind, inner, depth)
    if inner.ranges:
        raise _refused(each, "a quantifier within another one")
    own = frozenset(name for name in inner.names if name.partition(".")[0] == variable)
    entities = Range(variable, sort, own)
    reads.names |= inner.names - own
    reads.ranges.append(entities)
    return kind.over(quantifier, entities, evaluator)


def _dotted(node: ast.expr) -> str | None:
    """Return a name with dots, as ``ego.speed``, or None if it is something else."""
    match node:
        case ast.Name(id=name):
            return name
        case ast.Attribute(value=inner, attr=field) if not field.startswith("_"):
            return None if (whole := _dotted(inner)) is None else f"{whole}.{field}"
    return None


def _quantified(node: ast.Call, each: ast.GeneratorExp) -> tuple[Quantifier, str, str]:
    """Return a quantifier, its variable, and the sort that this goes through."""
    name = node.func.id if isinstance(node.func, ast.Name) else ast.unparse(node.func)
    if name not in QUANTIFIERS or node.keywords:
        raise _refused(node, f"'{name}' of entities", did_you_mean(name, QUANTIFIERS), name=name)
    match each.generators:
        case [ast.comprehension(target=ast.Name(id=variable), iter=sorts, ifs=[], is_async=0)]:
            sort = _dotted(sorts)
            if sort is not None and variable[:1].isupper():
                return QUANTIFIERS[name], variable, sort
    raise _refused(each, f"'{ast.unparse(each):.40}'", "written like min(P.x for P in pedestrian)")


def _called(node: ast.Call) -> tuple[Operation, list[ast.expr]]:
    """Return the operation that a call stands for, and what it is applied to."""
    if not isinstance(node.func, ast.Name):
        raise _refused(node, "this kind of call")
    name = node.func.id
    if name in SOFT_COMPARISONS:
        return _compared(node, name)
    if name not in FUNCTIONS:
        raise _refused(node, f"the function '{name}'", did_you_mean(name, _CALLED), name=name)
    if node.keywords:
        raise _refused(node, f"'{name}' with {node.keywords[0].arg or '**'}=")
    _check_count(node, name, FUNCTIONS[name])
    return FUNCTIONS[name], node.args


def _check_count(node: ast.Call, name: str, function: Operation) -> None:
    least, most = function.least, function.most
    if not least <= len(node.args) <= most:
        count = str(least) if least == most else f"{least} to {most}"
        raise _refused(node, f"'{name}' with {len(node.args)} arguments", f"it takes {count}")


def _compared(node: ast.Call, name: str) -> tuple[Operation, list[ast.expr]]:
    """Return a soft comparison, which is a crisp one without a margin."""
    comparison = SOFT_COMPARISONS[name]
    given = {keyword.arg or "**": keyword.value for keyword in node.keywords}
    for key in given:
        if key not in _OPTIONS:
            hint = did_you_mean(key, _OPTIONS)
            raise _refused(node, f"'{name}' with {key}=", hint, name=key)
    if len(node.args) == comparison.crisp.least + 1 and "margin" not in given:
        raise _refused(node, f"a margin without its name in '{name}'", "write margin=…")
    _check_count(node, name, comparison.crisp)
    limits = [n for limit in node.args[1:] if (n := _constant_of(limit)) is not None]
    if limits != sorted(limits):
        raise _refused(node, f"'{name}' with a low limit above the high one")
    margin = _constant_of(given["margin"]) if "margin" in given else 0.0
    if margin is not None and margin < 0:
        raise _refused(given["margin"], "a margin below 0")
    value, shape = _value_at_margin(given), _shape(given)
    if value == 0 and not SHAPES[shape].takes_zero:
        raise _refused(node, f"value_at_margin=0, as {shape} never gets there", "such as 0.01")
    if not margin and margin is not None:
        return comparison.crisp, node.args
    return comparison.soft(shape, value), [*node.args, given["margin"]]


_OPTIONS = ("margin", "value_at_margin", "shape")


def _value_at_margin(given: Mapping[str, ast.expr]) -> float:
    if "value_at_margin" not in given:
        return DEFAULT_VALUE
    value = _constant_of(given["value_at_margin"])
    if value is None or not 0 <= value < 1:
        raise _refused(
            given["value_at_margin"],
            f"value_at_margin={ast.unparse(given['value_at_margin']):.40}",
            "it is a number from 0 to 1, without 1 itself",
        )
    return value


def _shape(given: Mapping[str, ast.expr]) -> str:
    match given.get("shape"):
        case None:
            return DEFAULT_SHAPE
        case ast.Name(id=name) if name in SHAPES:
            return name
        case node:
            written = ast.unparse(node)
            raise _refused(
                node, f"shape={written:.40}", did_you_mean(written, SHAPES), name=written[:40]
            )


def _constant_of(node: ast.expr) -> float | None:
    """Return the number that a part is as it stands, perhaps with a sign, else None."""
    match node:
        case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int() | float() as number)):
            return -float(number)
        case ast.Constant(value=int() | float() as number):
            return float(number)
    return None


def _instead(node: ast.expr) -> str | None:
    """Return what a formula writes in place of what other languages have."""
    kinds: tuple[type[Any], ...] = (type(node), type(getattr(node, "op", None)))
    return next((_OTHER_WORDS[kind] for kind in kinds if kind in _OTHER_WORDS), None)


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
        suggestion=suggestion or f"numbers, names, + - * / **, comparisons, {', '.join(_CALLED)}",
        offset=max(node.col_offset - 1, 0),
    )
