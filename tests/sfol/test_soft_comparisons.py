"""Soft comparisons: 1 where they hold, the value at the margin at the margin, falling between."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfol.errors import FormulaError
from sfol.formula import Formula
from sfol.soft_comparisons import SHAPES, SOFT_COMPARISONS

CALLS = {  # comparison → (its text, the nearest place where it holds, one farther out)
    "below": ("below(x, 2", 2.0, 1.0),
    "above": ("above(x, 2", 2.0, -1.0),
    "between": ("between(x, -1, 2", 2.0, 1.0),
    "near": ("near(x, 2", 2.0, -1.0),
}
numbers = st.floats(-1e6, 1e6)
margins = st.floats(1e-3, 1e3)
values = st.floats(0.001, 0.999)
shapes = st.sampled_from([*SHAPES])
names = st.sampled_from([*SOFT_COMPARISONS])


def formula(name, margin, value=0.1, shape="linear"):
    options = f"margin={margin!r}, value_at_margin={value!r}, shape={shape}"
    return Formula.parse(f"{CALLS[name][0]}, {options})")


def test_every_comparison_is_tried_here():
    assert CALLS.keys() == SOFT_COMPARISONS.keys()


@pytest.mark.parametrize(
    ("text", "x", "expected"),
    [
        ("below(x, 3)", 3.0, 1.0),
        ("below(x, 3)", 3.1, 0.0),
        ("above(x, 3)", 3.0, 1.0),
        ("above(x, 3)", 2.9, 0.0),
        ("between(x, -1, 2)", -1.0, 1.0),
        ("between(x, -1, 2)", 2.5, 0.0),
        ("near(x, 2)", 2.0, 1.0),
        ("near(x, 2)", 2.1, 0.0),
        ("below(x, 3, margin=2)", 4.0, 0.55),  # half way from 1 to 0.1
        ("below(x, 3, margin=2)", 5.0, 0.1),
        ("below(x, 3, margin=2)", 6.0, 0.0),
        ("near(x, 0, margin=4, value_at_margin=0)", -1.0, 0.75),
        ("above(x, 0, margin=1, shape=gaussian)", -0.5, 0.1**0.25),
        ("above(x, 0, margin=1, shape=long_tail)", -2.0, 1 / 37),
        ("above(x, 0, margin=1, value_at_margin=0, shape=cosine)", -0.5, 0.5),
        ("above(x, 0, margin=1, shape=hard)", -0.5, 0.1),
        ("above(x, 0, margin=1, shape=hard)", -1.5, 0.0),
        ("below(x, 3, margin=0)", 3.1, 0.0),
        ("below(x, 0, margin=x)", 0.0, 1.0),  # a margin that comes out as 0
        ("below(x, 3, margin=2)", math.inf, 0.0),
        ("between(x, 0, 1, margin=2, shape=cosine)", -math.inf, 0.0),
    ],
)
def test_by_hand(text, x, expected):
    parsed = Formula.parse(text)
    assert parsed({"x": x}) == pytest.approx(expected, abs=1e-15)
    assert parsed.elementwise({"x": np.array([x])})[0] == pytest.approx(expected, abs=1e-15)


@given(names, numbers, margins, values, shapes)
def test_between_0_and_1_and_the_same_for_numbers_and_arrays(name, x, margin, value, shape):
    torch = pytest.importorskip("torch")
    parsed = formula(name, margin, value, shape)
    found = parsed({"x": x})
    assert 0.0 <= found <= 1.0
    assert parsed.elementwise({"x": np.array([x])})[0] == pytest.approx(found, abs=1e-12)
    tensor = parsed.elementwise({"x": torch.tensor([x], dtype=torch.float64)})
    assert float(tensor[0]) == pytest.approx(found, abs=1e-12)


@given(names, margins, values, shapes)
def test_1_at_the_limit_and_the_value_at_the_margin(name, margin, value, shape):
    _, limit, direction = CALLS[name]
    parsed = formula(name, margin, value, shape)
    assert parsed({"x": limit}) == 1.0
    if shape != "hard":  # which jumps there
        at_margin = parsed({"x": limit + direction * margin})
        assert at_margin == pytest.approx(value, rel=1e-6, abs=1e-6)


@given(names, margins, values, shapes, st.lists(st.floats(0, 1e4), min_size=2, max_size=5))
def test_farther_from_holding_is_never_more(name, margin, value, shape, distances):
    _, limit, direction = CALLS[name]
    parsed = formula(name, margin, value, shape)
    found = [parsed({"x": limit + direction * distance}) for distance in sorted(distances)]
    assert all(near >= far - 1e-12 for near, far in pairwise(found))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", SOFT_COMPARISONS)
def test_gradients_are_finite_and_point_to_where_it_holds(name, shape):
    torch = pytest.importorskip("torch")
    _, limit, direction = CALLS[name]
    outside = [limit, limit + 0.5 * direction, limit + 50 * direction]
    x = torch.tensor(outside, dtype=torch.float64, requires_grad=True)
    formula(name, 1.0, shape=shape).elementwise({"x": x}).sum().backward()
    assert x.grad.isfinite().all()
    if shape != "hard":
        assert float(x.grad[1]) * direction < 0


def test_a_margin_may_be_learned():
    torch = pytest.importorskip("torch")
    parsed = Formula.parse("below(x, 0, margin=m)")
    margin = torch.tensor(2.0, dtype=torch.float64, requires_grad=True)
    parsed.elementwise(
        {"x": torch.tensor([1.0], dtype=torch.float64), "m": margin}
    ).sum().backward()
    assert float(margin.grad) == pytest.approx(0.9 * 1.0 / 4.0)


def test_two_points_at_one_place_have_a_distance_with_a_gradient():
    torch = pytest.importorskip("torch")
    x = torch.tensor([0.0, 3.0], dtype=torch.float64, requires_grad=True)
    distance = Formula.parse("hypot(x, y)").elementwise(
        {"x": x, "y": torch.tensor([0.0, 4.0], dtype=torch.float64)}
    )
    assert distance.tolist() == [0.0, 5.0]
    distance.sum().backward()
    assert x.grad.tolist() == [0.0, 0.6]


@pytest.mark.parametrize("values", [{"x": 1.0, "m": -1.0}, {"x": math.nan, "m": 1.0}])
def test_what_means_nothing_has_no_value(values):
    parsed = Formula.parse("below(x, 0, margin=m)")
    with pytest.raises(FormulaError, match="has no value"):
        parsed(values)
    with pytest.raises(FormulaError, match="has no value"):
        parsed.elementwise({name: np.array([value]) for name, value in values.items()})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("below(x, 1, 2)", "write margin="),
        ("below(x)", "it takes 2"),
        ("between(x, 2, 1)", "a low limit above the high one"),
        ("below(x, 1, margin=-1)", "a margin below 0"),
        ("below(x, 1, margn=1)", "did you mean 'margin'"),
        ("below(x, 1, **x)", "known: margin"),
        ("below(x, 1, margin=1, shape=gausian)", "did you mean 'gaussian'"),
        ("below(x, 1, margin=1, shape=x + 1)", "known: cosine"),
        ("below(x, 1, margin=1, value_at_margin=1)", "from 0 to 1"),
        ("below(x, 1, margin=1, value_at_margin=x)", "from 0 to 1"),
        ("below(x, 1, margin=1, shape=gaussian, value_at_margin=0)", "never gets there"),
        ("belw(x, 1)", "did you mean 'below'"),
        ("min(x, 1, margin=1)", "'min' with margin="),
    ],
)
def test_what_is_wrong_is_said(text, message):
    with pytest.raises(FormulaError) as caught:
        Formula.parse(text)
    assert message in str(caught.value)


def test_calls_within_calls_are_read_once():
    text = "x"
    for _ in range(30):
        text = f"below(x, {text}, margin=1)"
    assert Formula.parse(text)({"x": 1.0}) == pytest.approx(1.0)
