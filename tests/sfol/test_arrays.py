"""A further kind of array is one class and its place among the backends."""

import operator
from dataclasses import replace

import numpy as np
import pytest

from sfol import Facts, KnowledgeBase, RewardFunction, arrays
from sfol.knowledge_base import Semantics
from sfol.operators import CONJUNCTIONS

SCENES = [
    Facts.parse(text)
    for text in (
        "",
        "Pedestrian(p1): 0.8. OnRoad(p1). CenterOf(p1, ego). Pedestrian(p2): 0.4. OnRoad(p2).",
        "NoCrosswalk(ego). EmptyLane(ego).",
    )
]
SIGNALS = {"v": [6.0, 5.0, 4.0], "v_next": [5.5, 5.0, 4.5], "d": [9.0, 0.0, 20.0]}


def infix(function):
    return lambda self, other: Column(function(self.values, numbers(other)))


def reflected(function):
    return lambda self, other: Column(function(numbers(other), self.values))


def numbers(value):
    return value.values if isinstance(value, Column) else value


class Column:
    """An array that numpy and torch know nothing of, with operators and nothing else."""

    __array_ufunc__ = None

    def __init__(self, values):
        self.values = np.asarray(values)

    def __getitem__(self, rows):
        return Column(self.values[numbers(rows)])

    shape = property(lambda self: self.values.shape)
    ndim = property(lambda self: self.values.ndim)

    def __neg__(self):
        return Column(-self.values)

    for name in ("add", "sub", "mul", "truediv", "pow", "and", "or", "ge", "gt", "le", "lt"):
        function = getattr(operator, f"{name}_" if name in ("and", "or") else name)
        locals()[f"__{name}__"] = infix(function)
        locals()[f"__r{name}__"] = reflected(function)

    __eq__ = infix(operator.eq)
    __ne__ = infix(operator.ne)
    __hash__ = None


def on_numbers(function):
    return staticmethod(lambda *values: Column(function(*map(numbers, values))))


class ColumnBackend:
    differentiable = False
    tolerance = 1e-9

    owns = staticmethod(lambda value: isinstance(value, Column))
    is_real = staticmethod(lambda column: True)
    has_nan = staticmethod(lambda column: bool(np.isnan(column.values).any()))
    is_finite = staticmethod(lambda column: bool(np.isfinite(column.values).all()))
    minimum, maximum = on_numbers(np.minimum), on_numbers(np.maximum)
    exp, log, sqrt = on_numbers(np.exp), on_numbers(np.log), on_numbers(np.sqrt)
    where = on_numbers(lambda condition, *pair: np.where(condition != 0, *pair))
    of = classmethod(lambda cls, values: cls())

    def __init__(self):
        self._numpy = arrays.backend_of([])

    def array(self, values):
        return values if isinstance(values, Column) else Column(values)

    real = array

    def __getattr__(self, name):
        operation = getattr(self._numpy, name)
        return lambda *values: Column(operation(*map(numbers, values)))


@pytest.mark.parametrize("conjunction", CONJUNCTIONS)
def test_a_new_backend_gives_the_same_rewards(monkeypatch, conjunction):
    kb = replace(KnowledgeBase.load("aeb"), semantics=Semantics(conjunction=conjunction))
    reward = RewardFunction(kb)
    batch = reward.batch(SCENES)
    expected = reward.evaluate(batch, **{k: np.array(v) for k, v in SIGNALS.items()})
    monkeypatch.setattr(arrays, "BACKENDS", (ColumnBackend, *arrays.BACKENDS))
    outcome = reward.evaluate(batch, **{k: Column(v) for k, v in SIGNALS.items()})
    assert outcome.reward.values.tolist() == expected.reward.tolist()
    for name, confidence in expected.confidences.items():
        assert outcome.confidences[name].values.tolist() == confidence.tolist()


def test_torch_gets_what_numpy_and_numbers_bring():
    torch = pytest.importorskip("torch")
    tensor = torch.tensor([1.0, 4.0])
    assert arrays.maximum(tensor, np.array([2.0, 2.0], dtype=np.float32)).tolist() == [2.0, 4.0]
    assert arrays.where(np.array([0.0, 1.0]), tensor, 7.0).tolist() == [7.0, 4.0]


def test_numbers_stay_numbers():
    assert arrays.minimum(2.0, 1.0) == 1.0
    assert isinstance(arrays.sqrt(4.0), float)
    assert arrays.has_nan(float("nan"))
    assert not arrays.has_nan(3)
