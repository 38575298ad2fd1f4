"""Elimination of variables: in a tree no array outgrows the largest factor."""

import itertools
import operator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfol.engines.elimination import eliminated, elimination_order

NAMES = "XYZW"


def sets(*texts):
    return [frozenset(text) for text in texts]


@pytest.mark.parametrize(
    ("factors", "keep", "largest"),
    [
        (("XY", "YZ", "ZW"), "X", 100),  # a chain
        (("XY", "XZ", "XW", "W"), "X", 100),  # a star
        (("X", "Y", "Z"), "", 10),  # three that have nothing to do with each other
        (("XY", "YZ", "ZW"), "XW", 1_000),  # both ends of a chain, together
        (("XY", "YZ", "ZX"), "", 1_000),  # a circle
        ((), "", 1),
    ],
)
def test_how_large_arrays_get(factors, keep, largest):
    order, size = elimination_order(sets(*factors), frozenset(keep), dict.fromkeys(NAMES, 10))
    assert size == largest
    assert sorted([*order, *keep]) == sorted({*"".join(factors), *keep})


@given(
    st.lists(st.sets(st.sampled_from(NAMES), min_size=1, max_size=2), min_size=1, max_size=5),
    st.sets(st.sampled_from(NAMES), max_size=2),
    st.integers(0, 2**32 - 1),
)
def test_it_is_the_sum_over_all_values(names, keep, seed):
    factors = [frozenset(factor) for factor in names]
    keep = frozenset(keep) & frozenset().union(*factors)
    sizes = {"X": 2, "Y": 3, "Z": 2, "W": 4}
    chance = np.random.default_rng(seed)
    arrays = [
        (factor, chance.random([sizes[n] if n in factor else 1 for n in NAMES]))
        for factor in factors
    ]
    order, _ = elimination_order(factors, keep, sizes)
    found = eliminated(
        arrays, order, operator.mul, lambda name, a: a.sum(axis=NAMES.index(name), keepdims=True)
    )
    there = frozenset().union(*factors)
    expected = np.zeros([sizes[n] if n in keep else 1 for n in NAMES])
    for at in itertools.product(*(range(sizes[n] if n in there else 1) for n in NAMES)):
        product = 1.0
        for factor, array in arrays:
            product *= array[tuple(i if n in factor else 0 for i, n in zip(at, NAMES, strict=True))]
        expected[tuple(i if n in keep else 0 for i, n in zip(at, NAMES, strict=True))] += product
    assert np.allclose(found, expected)
