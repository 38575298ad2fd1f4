"""Calls with arguments of every kind and shape: an error of ours that says what was expected."""

import itertools
import math
from contextlib import suppress
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from sfol import Bound, Facts, KnowledgeBase, RewardFunction
from sfol.clauses import parse_clause, parse_condition
from sfol.errors import FactError, SfolError, SignalError, UsageError
from sfol.formula import Formula
from sfol.syntax import parse_signature

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


@pytest.fixture(scope="module")
def reward():
    return RewardFunction("aeb")


def scene():
    return Facts.parse("Pedestrian(p1): 0.8. OnRoad(p1). CenterOf(p1, ego).")


# -- signals --------------------------------------------------------------------------------------

ROAD = {"v": 6.0, "v_next": 5.0, "d": 9.0}


@pytest.mark.parametrize(
    "number", [5, np.uint8(5), np.int8(5), np.float16(5), Decimal(5), Fraction(5)],
    ids=lambda value: type(value).__name__,
)  # fmt: skip
def test_a_signal_of_any_type_is_computed_as_pythons_float(reward, number):
    expected = reward.evaluate(scene(), v=5.0, v_next=6.0, d=9.0)
    outcome = reward.evaluate(scene(), v=number, v_next=type(number)(6), d=9.0)
    assert outcome.terms == expected.terms
    assert type(outcome.reward) is float
    assert reward(scene(), v=np.array(number), v_next=6.0, d=9.0) == expected.reward
    batch = reward.evaluate(reward.batch([scene()]), v=number, v_next=type(number)(6), d=9.0)
    assert batch.reward.tolist() == pytest.approx([expected.reward], rel=1e-15)


@pytest.mark.parametrize("dtype", ["bool", "uint8", "int64", "float16", "float32", "float64"])
def test_an_array_of_any_type_is_computed_in_float64(reward, dtype):
    batch = reward.batch([scene(), scene()])
    v, after = np.array([0, 1], dtype=dtype), np.array([1, 0], dtype=dtype)
    outcome = reward.evaluate(batch, v=v, v_next=after, d=9.0)
    assert outcome.reward.dtype == np.float64
    for number in (0, 1):
        alone = reward(scene(), v=float(v[number]), v_next=float(after[number]), d=9.0)
        assert outcome.reward[number] == pytest.approx(alone, rel=1e-15)


@pytest.mark.parametrize(
    ("v", "d", "expected"),
    [
        ("int64", "int64", "float64"),
        ("int32", "float32", "float32"),
        ("bfloat16", "float32", "float32"),
        ("float16", "float16", "float32"),
        ("float32", "float64", "float64"),
    ],
)
def test_tensors_are_promoted_over_all(reward, v, d, expected):
    torch = pytest.importorskip("torch")
    batch = reward.batch([scene(), scene()])
    given = {
        "v": torch.tensor([300, 200]).to(getattr(torch, v)),
        "v_next": 0.0,
        "d": torch.tensor([9, 8]).to(getattr(torch, d)),
    }
    outcome = reward.evaluate(batch, **given)
    assert outcome.reward.dtype == getattr(torch, expected)
    numbers = {name: torch.as_tensor(value).double().numpy() for name, value in given.items()}
    exact = reward.evaluate(batch, **numbers).reward
    assert outcome.reward.tolist() == pytest.approx(
        exact.tolist(), rel=1e-12 if expected == "float64" else 1e-5
    )


@pytest.mark.parametrize("text", ["where(v > 0, 200.1, 3.3)", "min(v, 200.1)", "max(v, -0.1)"])
def test_constants_keep_their_digits_among_tensors(kitchen, text):
    torch = pytest.importorskip("torch")
    formula = Formula.parse(text)
    for v in (1000.0, -1000.0):
        found = formula.elementwise({"v": torch.tensor([v], dtype=torch.float64)})
        assert found.tolist() == [formula({"v": v})]


@pytest.mark.parametrize(
    "value",
    [
        np.zeros((2, 1)), np.zeros((1, 2)), np.zeros(3), np.zeros(1), [0.0, 1.0], "v", b"1", 1j,
        np.array(["a", "b"]), np.array([1j, 2]), np.array([None, 1]), {"a": 1}, (0.0, 1.0),
        np.array([0.0, np.nan]), np.nan, 10**400,
    ],
    ids=repr,
)  # fmt: skip
def test_what_is_no_signal_of_the_batch_is_refused(reward, value):
    batch = reward.batch([scene(), scene()])
    with pytest.raises(SignalError, match="'v'"):
        reward.evaluate(batch, v=value, v_next=0.0)
    with pytest.raises(SignalError, match="'v'"):
        reward.evaluate(scene(), v=value, v_next=0.0)


def test_the_error_says_which_shape_is_expected(reward):
    batch = reward.batch([scene(), scene()])
    with pytest.raises(SignalError, match=r"ndarray of shape \(2, 1\).*of shape \(2,\)"):
        reward.evaluate(batch, v=np.zeros((2, 1)), v_next=0.0)


def test_series_are_refused_with_what_to_do(reward):
    pandas = pytest.importorskip("pandas")
    batch = reward.batch([scene(), scene()])
    with pytest.raises(SignalError, match="Series"):
        reward.evaluate(batch, v=pandas.Series([1.0, 2.0]), v_next=0.0)


# Names that functions use for their own arguments.
OWN_NAMES = ["self", "facts", "time", "signals", "outcome", "name", "kb", "batch", "_"]


@pytest.mark.parametrize("name", OWN_NAMES)
def test_a_signal_may_have_any_name(kitchen, name):
    kb = kitchen({"speed": name, "k * ": "k * "})
    reward = RewardFunction(kb)
    facts, signals = Facts.parse("Hot(pan)."), {name: 2.0}
    value = reward(facts, **signals)
    assert reward.evaluate(reward.batch([facts]), **signals).reward.tolist() == [value]
    assert str(reward.explain(facts, **signals))


# -- batches --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lower", "upper", "says"),
    [
        (lambda low, up: up * 0 + 0.9, lambda low, up: up * 0 + 0.1, "Pedestrian"),
        (lambda low, up: low - 1, lambda low, up: up, r"in scene \d"),
        (lambda low, up: low, lambda low, up: up + 1, "bound"),
        (lambda low, up: low * np.nan, lambda low, up: up, "bound"),
        (lambda low, up: low[:-1], lambda low, up: up[:-1], "of shape"),
        (lambda low, up: low[:, None], lambda low, up: up, "of shape"),
        (lambda low, up: low.tolist(), lambda low, up: up, "array or tensor"),
        (lambda low, up: low.astype(str), lambda low, up: up, "real numbers"),
        (lambda low, up: None, lambda low, up: up, "NoneType"),
    ],
)
def test_bounds_that_are_none_are_refused(reward, lower, upper, says):
    batch = reward.batch([scene(), scene()])
    with pytest.raises(FactError, match=says):
        batch.with_bounds(lower(batch.lower, batch.upper), upper(batch.lower, batch.upper))


# -- coefficients and parameters ------------------------------------------------------------------

CHANGES = [
    lambda numbers: numbers.update(safe1=math.nan),
    lambda numbers: numbers.update({"saef1": 1.0}),
    lambda numbers: numbers.__ior__({"safe1": math.inf}),
    lambda numbers: numbers.setdefault("other", 1.0),
    lambda numbers: numbers.pop("safe1"),
    lambda numbers: numbers.popitem(),
    lambda numbers: numbers.clear(),
    lambda numbers: numbers.__delitem__("safe1"),
    lambda numbers: numbers.__setitem__("safe1", "1"),
    lambda numbers: numbers.__setitem__("safe1", np.zeros(2)),
    lambda numbers: numbers.__setitem__(["safe1"], 1.0),
]


@pytest.mark.parametrize("change", CHANGES)
def test_no_way_leads_past_the_checks_of_coefficients(change):
    reward = RewardFunction("aeb")
    before = dict(reward.coefficients["safety"])
    with pytest.raises(UsageError):
        change(reward.coefficients["safety"])
    assert dict(reward.coefficients["safety"]) == before


def test_coefficients_are_set_by_update_and_by_or():
    reward = RewardFunction("aeb")
    reward.coefficients["safety"].update(safe1=np.float32(0.5))
    assert type(reward.coefficients["safety"]["safe1"]) is float
    reward.coefficients["safety"] |= {"safe2": 0.25}
    assert reward.coefficients["safety"]["safe1"] == 0.5
    assert reward.coefficients["safety"]["safe2"] == 0.25
    reward.coefficients["safety"] = dict.fromkeys(reward.coefficients["safety"], 0.75)
    assert set(reward.coefficients["safety"].values()) == {0.75}
    for wrong in ({}, {"safe1": 1.0}, 3):
        with pytest.raises(UsageError):
            reward.coefficients["safety"] = wrong


# -- everything -----------------------------------------------------------------------------------

ODD = [
    *NUMBERS, *NO_NUMBERS, *NO_NAMES, 1j, math.inf, -math.inf, "\x00", "\ud800", "9", "a" * 200_000,
    ["a", "b"], [[1]], object(), len, int, Decimal("NaN"), np.float16(300), np.array(["a"]),
    np.array([1j]), np.array([None]), np.datetime64("2020-01-01"), np.timedelta64(5, "s"),
    Path("x"), Bound(0.1, 0.2), Bound(2.0, 1.0), Facts(), iter([]),
]  # fmt: skip


def calls(reward):
    """Return functions of the public interface with arguments that they take."""
    batch = reward.batch([scene(), scene()])

    def coefficient(name, number):
        RewardFunction(reward.kb).coefficients["safety"][name] = number

    return [
        (lambda margin: Facts(margin=margin), [0.05]),
        (lambda text, margin: Facts.parse(text, margin=margin), ["Hot(pan).", 0.05]),
        (
            lambda p, c, confidence, bound, merge: scene().add(
                p, c, confidence=confidence, bound=bound, merge=merge
            ),
            ["Pedestrian", "p2", 0.5, None, None],
        ),
        (lambda p, c, d, b: scene().add(p, c, d, bound=b), ["CenterOf", "p2", "ego", (0.1, 0.2)]),
        (lambda p, c, d: scene().add(p, c, d), ["CenterOf", "p2", "ego"]),
        (lambda p, c: scene().bound(p, c), ["Pedestrian", "p1"]),
        (lambda p: scene().relation(p), ["Pedestrian"]),
        (lambda entity: scene().about(entity), ["p1"]),
        (lambda atom: atom in scene(), [("Pedestrian", "p1")]),
        (Bound.checked, [0.1, 0.2, "x"]),
        (Bound.around, [0.1, 0.2, "x"]),
        (lambda f, v, w, d: reward(f, v=v, v_next=w, d=d), [scene(), 1.0, 1.0, 3.0]),
        (lambda f, v, w, d: reward.evaluate(f, v=v, v_next=w, d=d), [batch, 1.0, 1.0, 3.0]),
        (lambda f, v, w, d: reward.explain(f, v=v, v_next=w, d=d), [scene(), 1.0, 1.0, 3.0]),
        (lambda depth: reward.explain(scene(), v=1, v_next=1).cut(depth), [2]),
        (reward.batch, [[scene()]]),
        (lambda facts: reward.batch([facts]), [scene()]),
        (reward.conclude, [scene()]),
        (reward.entity_weights, [scene(), ["p1"]]),
        (lambda facts, entity: reward.entity_weights(facts, [entity]), [scene(), "p1"]),
        (batch.with_bounds, [batch.lower, batch.upper]),
        (coefficient, ["safe1", 0.5]),
        (lambda kb, engine: RewardFunction(kb, engine=engine), [reward.kb, "compiled"]),
        (KnowledgeBase.load, ["aeb"]),
        (KnowledgeBase.load, ["aeb", "crossing"]),
        (Formula.parse, ["v"]),
        (lambda v: Formula.parse("exp(v)**2 / v")({"v": v}), [1.0]),
        (parse_clause, ["h(X) :- P(X)."]),
        (parse_condition, ["P(X)"]),
        (parse_signature, ["P(X)"]),
    ]


@pytest.mark.filterwarnings("ignore")  # numpy warns of NaN that becomes an integer, and the like
def test_odd_arguments_get_an_error_of_ours_or_a_value(reward):
    tried = refused = 0
    for function, arguments in calls(reward):
        function(*arguments)
        for position, odd in itertools.product(range(len(arguments)), ODD):
            given = [odd if at == position else value for at, value in enumerate(arguments)]
            tried += 1
            try:
                function(*given)
            except SfolError:
                refused += 1
            except Exception as error:
                raise AssertionError(f"{arguments} with {odd!r:.80} at {position}") from error
    assert tried > 3_000
    assert refused > 2_000


def test_pairs_of_odd_arguments_get_an_error_of_ours_or_a_value(reward):
    values = [*NUMBERS, *NO_NUMBERS, None]
    for confidence, bound in itertools.product(values, values):
        facts = reward.facts()
        with suppress(SfolError):
            facts.add("Pedestrian", "p1", confidence=confidence, bound=bound)
            assert Facts.parse(str(facts)) == facts
            reward(facts, v=1.0, v_next=1.0)
