"""Heads that depend on themselves: all engines reach the least bounds that fit all rules."""

import random

import numpy as np
import pytest

from sfol import Facts, RewardFunction
from sfol.engines.compiled import CompiledEngine
from sfol.testing.laws import LAWS, assert_same
from sfol.testing.naive import naive_conclusions
from tests.differential.recursive import recursive_scene
from tests.differential.test_dense import assert_agree

TOLERANCE = 1e-9


def every_engine_agrees(numbers):
    """Compare all engines but PyReason; return how many atoms depend on themselves."""
    recursive = 0
    for number in numbers:
        kb, facts = recursive_scene(number)
        expected = naive_conclusions(kb, facts)
        engine = CompiledEngine(kb)
        assert_same(expected, engine.conclude(facts).derived)
        recursive += sum(atom.predicate in engine.program.recursive for atom in expected)
        assert_agree(kb, [facts, Facts()], sorts=1 + number % 3)
        batches_agree(kb, [facts, Facts(), facts])
    return recursive


def batches_agree(kb, scenes):
    reward = RewardFunction(kb)
    found = reward.evaluate(reward.batch(scenes)).bounds
    for i, scene in enumerate(scenes):
        for head, bound in reward.evaluate(scene).bounds.items():
            assert bool(found[head].known[i]) == (bound is not None), head
            ends = (float(found[head].lower[i]), float(found[head].upper[i]))
            assert bound is None or ends == pytest.approx(tuple(bound), abs=TOLERANCE), head


@pytest.mark.filterwarnings("ignore::sfol.errors.SilentZeroWarning")
def test_every_engine_agrees():
    assert every_engine_agrees(range(200)) > 800


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::sfol.errors.SilentZeroWarning")
def test_every_engine_agrees_on_many():
    assert every_engine_agrees(range(200, 5_200)) > 20_000


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
@pytest.mark.filterwarnings("ignore::sfol.errors.SilentZeroWarning")
def test_a_law_holds(law):
    for number in range(60):
        kb, facts = recursive_scene(number, plain=number % 2 == 0)
        law(RewardFunction(kb), facts, random.Random(number))


def test_pyreason_agrees(pyreason):
    concluded = 0
    for number in range(40):
        kb, facts = recursive_scene(number, plain=True)
        expected = naive_conclusions(kb, facts)
        concluded += len(expected)
        assert_same(expected, pyreason(kb).conclude(facts).derived)
    assert concluded > 100


def test_dense_of_tensors_agrees():
    torch = pytest.importorskip("torch")
    for number in range(30):
        kb, facts = recursive_scene(number)
        assert_agree(kb, [facts, Facts()], 2, torch.as_tensor)
        assert_agree(kb, [facts], 2, np.asarray)
