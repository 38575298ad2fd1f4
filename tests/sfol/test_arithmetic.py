"""One table of what every operation does with 0, infinity and NaN, in every evaluator."""

import itertools
import math
import warnings

import numpy as np
import pytest

from sfol.arithmetic import COMPARISONS, FUNCTIONS, OPERATORS, SIGNS
from sfol.errors import FormulaError
from sfol.formula import Formula

INF, NAN = math.inf, math.nan
VALUES = [0.0, -0.0, 1.0, -1.0, 0.5, 2.0, -3.0, 1e200, -1e200, 5e-324, INF, -INF, NAN]
OPERATIONS = {
    **{f"x {sign} y": operation for sign, operation in (OPERATORS | COMPARISONS).items()},
    **{f"{sign}x": operation for sign, operation in SIGNS.items()},
    **{f"{name}(…)": operation for name, operation in FUNCTIONS.items()},
}
# Where Python's own operators raise, or what it says of NaN depends on the order.
BY_HAND = [
    ("1 / x", 0.0, INF),
    ("1 / x", -0.0, -INF),
    ("x / x", 0.0, NAN),
    ("1 / x", INF, 0.0),
    ("log(x)", 0.0, -INF),
    ("log(x)", -1.0, NAN),
    ("sqrt(x)", -1.0, NAN),
    ("exp(x)", 1e6, INF),
    ("exp(-x)", 1e6, 0.0),
    ("x ** 0.5", -1.0, NAN),
    ("x ** -1", 0.0, INF),
    ("x ** 2", 1e200, INF),
    ("x ** 0", NAN, 1.0),
    ("x - x", INF, NAN),
    ("0 * x", INF, NAN),
    ("min(x, 1)", NAN, NAN),
    ("min(1, x)", NAN, NAN),
    ("max(x, 1)", NAN, NAN),
    ("max(1, x)", NAN, NAN),
    ("clip(x, 0, 1)", NAN, NAN),
    ("clip(x, 0, 1)", INF, 1.0),
    ("x == x", NAN, 0.0),
    ("x != x", NAN, 1.0),
    ("where(x > 0, 1 / x, 5)", 0.0, 5.0),
    ("where(x, 1, 2)", NAN, 1.0),
    ("min(1 / x, 5)", 0.0, 5.0),
]


def arguments(operation):
    return list(itertools.product(VALUES, repeat=operation.least))


def same(left, right):
    return (math.isnan(left) and math.isnan(right)) or math.isclose(left, right, rel_tol=1e-15)


def columns(name, rows):
    """Return every argument of an operation as an array of the kind."""
    values = np.array(rows).T
    if name == "numpy":
        return list(values)
    torch = pytest.importorskip("torch")
    return [torch.tensor(column) for column in values]


@pytest.mark.parametrize("kind", ["numpy", "torch"])
@pytest.mark.parametrize("text", OPERATIONS)
def test_arrays_give_what_numbers_give(text, kind):
    operation = OPERATIONS[text]
    rows = [row for row in arguments(operation) if (text, row) != ("x ** y", (-INF, 0.5))]
    with np.errstate(all="ignore"):
        found = operation.of_arrays(*columns(kind, rows)).tolist()
    for row, value in zip(rows, found, strict=True):
        assert same(operation.of_numbers(*row), value), (text, row)


@pytest.mark.parametrize("text", OPERATIONS)
def test_of_arrays_numbers_among_arrays_and_numbers_alone_are_the_same(text):
    operation = OPERATIONS[text]
    for row in arguments(operation)[:: operation.least]:
        expected = operation.of_numbers(*row)
        assert same(operation.of_arrays(*row), expected), row
        if operation.least > 1 and (text, row) != ("x ** y", (-INF, 0.5)):
            with np.errstate(all="ignore"):
                mixed = operation.of_arrays(np.array([row[0]]), *row[1:])
            assert same(float(mixed[0]), expected), row


@pytest.mark.parametrize(("text", "x", "expected"), BY_HAND)
def test_by_hand(text, x, expected):
    formula = Formula.parse(text)
    if math.isfinite(expected):
        assert formula({"x": x}) == formula.elementwise({"x": np.array([x])})[0] == expected
        return
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for call in (
            lambda: formula({"x": x}),
            lambda: formula.elementwise({"x": np.array([1.0, x])}),
            lambda: formula.elementwise({"x": x}),
        ):
            with pytest.raises(FormulaError, match="has no value"):
                call()


def test_the_error_names_the_part_and_the_scene():
    formula = Formula.parse("1 + v / (d - 2) * 3")
    with pytest.raises(FormulaError, match=r"v / \(d - 2\) is infinite \(d = 2, v = 6\)"):
        formula({"v": 6.0, "d": 2.0})
    with pytest.raises(FormulaError, match=r"in scene 1: .*\(d = 2, v = 6\)"):
        formula.elementwise({"v": 6.0, "d": np.array([3.0, 2.0])})
    with pytest.raises(FormulaError, match="sqrt\\(-v\\) is not a number"):
        Formula.parse("min(sqrt(-v), 2)")({"v": 4.0})
