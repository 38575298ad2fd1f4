"""Calls with arguments of every kind and shape: an error of ours that says what was expected."""

import itertools

import numpy as np
import pytest

from sfol import Bound, Facts, RewardFunction
from sfol.errors import FactError, SfolError

NUMBERS = [
    *(np.float32(0.5), np.float64(0.5), np.float16(0.5), np.int64(1), np.uint8(1), np.bool_(True)),
    *(0.5, 1, True, np.array(0.5)),
]
NO_NUMBERS = [
    *(
        "0.5",
        b"1",
        "x",
        [],
        [0.5],
        (0.5,),
        {},
        {"a": 1},
        ...,
        np.array([0.5]),
        np.zeros((2, 2)),
    ),
    *(float("nan"), float("inf"), -1, 2, 10**400, 1j, np.float32("nan"), range(3)),
]
NO_NAMES = [None, 3, 0.5, "", "X", "a b", "a,b", "é!", ["a"], {"a": 1}, {1}, b"a", ("a",), ...]


@pytest.mark.parametrize("number", NUMBERS, ids=lambda value: type(value).__name__)
def test_a_number_of_any_type_becomes_pythons_own(number):
    facts = Facts()
    facts.add("Hot", "pan", confidence=number)
    facts.add("Old", "pan", bound=(number, number))
    facts.add("New", "pan", bound=Bound(number, number))
    for predicate in ("Hot", "Old", "New"):
        assert [type(end) for end in facts.bound(predicate, "pan")] == [float, float]
    assert Facts.parse(str(facts)) == facts


@pytest.mark.parametrize("value", NO_NUMBERS, ids=lambda value: type(value).__name__)
def test_what_is_no_number_from_0_to_1_is_refused(value):
    facts = Facts()
    for given in (
        {"confidence": value},
        {"bound": (value, value)},
        {"bound": (0.1, value)},
        {"bound": Bound(value, value)},
        {"bound": value},
    ):
        with pytest.raises(FactError):
            facts.add("Hot", "pan", **given)
    assert not len(facts)


@pytest.mark.parametrize("name", NO_NAMES, ids=lambda value: type(value).__name__)
def test_what_is_no_name_is_refused(name):
    facts = Facts.parse("Hot(pan). Near(pan, pot).")
    for call in (("Hot", name), ("Near", "pan", name), ("Cold", name)):
        with pytest.raises(FactError):
            facts.add(*call)
    assert len(facts) == 2


@pytest.mark.parametrize(
    "name", [name for name in NO_NAMES if name != "X"], ids=lambda value: type(value).__name__
)
def test_what_is_no_predicate_is_refused(name):
    with pytest.raises(FactError):
        Facts().add(name, "pan")


def test_no_combination_of_arguments_is_a_traceback():
    reward = RewardFunction("aeb")
    values = [*NUMBERS, *NO_NUMBERS, None]
    calls = refused = 0
    for confidence, bound in itertools.product(values, values):
        facts = reward.facts()
        calls += 1
        try:
            facts.add("Pedestrian", "p1", confidence=confidence, bound=bound)
            reward(facts, v=1.0, v_next=1.0)
        except SfolError:
            refused += 1
    assert calls > 800
    assert refused > 600
