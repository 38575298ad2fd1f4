"""Quantifiers over entities: the same for numbers and arrays, and over nobody."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfol.errors import FormulaError
from sfol.formula import Entities, Formula
from sfol.quantifiers import QUANTIFIERS


def people(*distances):
    return {"P in person": [{"P.d": d} for d in distances], "c": 2.0}


def value_of(formula, values):
    """The mean over nobody, which is refused as a value, is the only NaN here."""
    try:
        return formula.maybe_infinite(values)
    except FormulaError:
        assert formula.text.startswith("mean")
        return math.nan


@pytest.mark.parametrize(
    ("text", "distances", "expected"),
    [
        ("min(P.d * c for P in person)", (3.0, 1.0, 2.0), 2.0),
        ("max(P.d - c for P in person)", (3.0, 1.0), 1.0),
        ("sum(1 for P in person)", (3.0, 1.0), 2.0),
        ("mean(P.d * c for P in person)", (3.0, 1.0), 4.0),
        ("where(sum(1 for P in person) > 0, mean(P.d for P in person), c)", (), 2.0),
        ("any(below(P.d, c) for P in person)", (3.0, 1.0), 1.0),
        ("any(below(P.d, c) for P in person)", (), 0.0),
        ("all(below(P.d, c) for P in person)", (3.0, 1.0), 0.0),
        ("all(below(P.d, c) for P in person)", (), 1.0),
        ("sum(P.d for P in person)", (), 0.0),
        ("min(min(P.d for P in person), 5)", (), 5.0),
        ("1 - any(near(P.d, 1, margin=4) for P in person)", (3.0,), 0.45),
    ],
)
def test_by_hand(text, distances, expected):
    assert Formula.parse(text)(people(*distances)) == pytest.approx(expected)


def test_what_is_read():
    formula = Formula.parse("min(hypot(P.x - ego.x, P.y) for P in next.person) + ego.v")
    (entities,) = formula.ranges
    assert formula.names == {"ego.x", "ego.v"}
    assert (entities.key, entities.names) == ("P in next.person", {"P.x", "P.y"})


rows = st.lists(st.lists(st.floats(-9, 9), min_size=3, max_size=3), min_size=1, max_size=4)
masks = st.lists(st.booleans(), min_size=3, max_size=3)


@pytest.mark.parametrize("kind", ["numpy", "torch"])
@given(rows, masks, st.sampled_from([*QUANTIFIERS]), st.floats(-9, 9))
def test_arrays_give_what_numbers_give(kind, values, mask, name, c):
    formula = Formula.parse(f"{name}(P.d * s - c for P in person) + s")
    there, array = np.array([mask] * len(values)).T, np.array(values).T
    s = array[0]
    if kind == "torch":
        there, array, s = map(pytest.importorskip("torch").tensor, (there, array, s))
    entities = Entities({"P.d": array}, there)
    found = formula.unchecked({"P in person": entities, "s": s, "c": c}).tolist()
    for row, value in zip(values, found, strict=True):
        numbers = [{"P.d": d} for d, present in zip(row, mask, strict=True) if present]
        expected = value_of(formula, {"P in person": numbers, "s": row[0], "c": c})
        assert value == pytest.approx(expected, abs=1e-9, nan_ok=True)


@pytest.mark.parametrize("name", QUANTIFIERS)
def test_over_no_rows_at_all(name):
    formula = Formula.parse(f"{name}(P.d for P in person)")
    entities = Entities({"P.d": np.zeros((0, 2))}, np.zeros((0, 2), bool))
    found = formula.unchecked({"P in person": entities}).tolist()
    assert found == pytest.approx([value_of(formula, people())] * 2, nan_ok=True)


def test_no_value_is_an_error_of_the_whole():
    formula = Formula.parse("1 / (2 - sum(1 / P.d for P in person))")
    with pytest.raises(FormulaError, match=r"sum\(.*\) is infinite"):
        formula(people(1.0, 1.0))
    with pytest.raises(FormulaError, match=r"mean.*person.* is not a number"):
        Formula.parse("mean(P.d for P in person)")(people())
    with pytest.raises(FormulaError, match=r"person.* is infinite"):
        Formula.parse("min(P.d for P in person)")(people())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("exp(P.x for P in person)", "known: all, any"),
        ("mim(P.x for P in person)", "did you mean 'min'"),
        ("min(P.x for p in person)", "min(P.x for P in pedestrian)"),
        ("min(P.x for P in person if P.x > 0)", "min(P.x for P in pedestrian)"),
        ("min(P.x for P in person for Q in person)", "min(P.x for P in pedestrian)"),
        ("min(P.x for P in (1, 2))", "min(P.x for P in pedestrian)"),
        ("min(P.x for P, Q in person)", "min(P.x for P in pedestrian)"),
        ("min(min(P.x for P in a) for Q in b)", "within another"),
        ("min([P.x for P in person])", "min(v"),
        ("any(x)", "any"),
    ],
)
def test_what_is_wrong_is_said(text, message):
    with pytest.raises(FormulaError) as caught:
        Formula.parse(text)
    assert message in str(caught.value) or message == "min(v"


def test_a_term_goes_through_nobody():
    with pytest.raises(FormulaError, match="only facts and signals can"):
        Formula.parse("min(P.x for P in person)").check_names({"person"})
