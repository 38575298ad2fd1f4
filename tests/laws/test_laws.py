"""Laws of the logic, on random scenes under the paper's rules and under other operators."""

import math
from dataclasses import replace
from functools import reduce
from operator import add

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.knowledge_base import Semantics

PAPER = KnowledgeBase.load("aeb")
UNARY = ["Vehicle", "Truck", "Pedestrian", "Crosswalk", "OnRoad", "OnCrosswalk", "IsClear",
         "NoCrosswalk", "EmptyLane"]  # fmt: skip
BINARY = ["LeftOf", "RightOf", "CenterOf", "Approaching", "IsAt", "Occludes"]
ENTITIES = ["ego", "e1", "e2", "e3"]

bounds = st.tuples(st.floats(0, 1), st.floats(0, 1)).map(lambda p: (min(p), max(p)))
entities = st.sampled_from(ENTITIES)
atoms = st.one_of(
    st.tuples(st.sampled_from(UNARY), entities),
    st.tuples(st.sampled_from(BINARY), entities, entities),
)
atoms = atoms.filter(lambda atom: atom != ("Vehicle", "ego"))  # it stands in the background
scenes = st.dictionaries(atoms, bounds, max_size=25)
speeds = st.floats(0, 20)


def with_semantics(**changes):
    return RewardFunction(replace(PAPER, semantics=Semantics(**changes)))


REWARDS = {
    "paper": RewardFunction(PAPER),
    "best": with_semantics(groundings="best"),
    "minimum": with_semantics(conjunction="minimum"),
    "product": with_semantics(conjunction="product", disjunction="probabilistic_sum"),
    "lukasiewicz": with_semantics(conjunction="lukasiewicz"),
}
everywhere = pytest.mark.parametrize("reward", REWARDS.values(), ids=REWARDS)
MONOTONE = [name for name in REWARDS if name != "paper"]


def facts_of(scene):
    facts = Facts()
    for atom, bound in scene.items():
        facts.add(*atom, bound=bound)
    return facts


def outcome_of(reward, scene, v=5.0, v_next=5.0, d=math.inf):
    return reward.evaluate(facts_of(scene), v=v, v_next=v_next, d=d)


@everywhere
@given(scene=scenes)
def test_bounds_stay_in_the_unit_interval_and_ordered(reward, scene):
    for lower, upper in outcome_of(reward, scene).derived.values():
        assert 0 <= lower <= upper <= 1


@everywhere
@given(scene=scenes, order=st.randoms())
def test_the_order_of_facts_changes_nothing(reward, scene, order):
    shuffled = list(scene.items())
    order.shuffle(shuffled)
    outcome, other = outcome_of(reward, scene), outcome_of(reward, dict(shuffled))
    assert other.derived.keys() == outcome.derived.keys()
    for atom, bound in outcome.derived.items():
        assert other.derived[atom] == pytest.approx(bound, abs=1e-12)


@everywhere
@given(scene=scenes, names=st.permutations(["a1", "b2", "c3"]))
def test_renaming_entities_changes_nothing(reward, scene, names):
    new = {"ego": "ego", **dict(zip(ENTITIES[1:], names, strict=True))}
    renamed = {(atom[0], *(new[e] for e in atom[1:])): bound for atom, bound in scene.items()}
    first, second = outcome_of(reward, scene), outcome_of(reward, renamed)
    assert second.confidences == pytest.approx(first.confidences, abs=1e-12)


@everywhere
@given(scene=scenes)
def test_irrelevant_facts_change_nothing(reward, scene):
    more = {**scene, ("IsNear", "e1", "ego"): (0.3, 0.4), ("Crosswalk", "stranger"): (1, 1)}
    assert outcome_of(reward, more).confidences == outcome_of(reward, scene).confidences


@everywhere
@given(scene=scenes)
def test_a_head_that_did_not_fire_is_zero(reward, scene):
    outcome = outcome_of(reward, scene)
    for head, bound in outcome.bounds.items():
        assert (bound is None) <= (outcome.confidences[head] == 0)


@everywhere
@given(scene=scenes, v=speeds, v_next=speeds, d=st.floats(0, 50) | st.just(math.inf))
def test_the_reward_is_the_sum_of_its_terms(reward, scene, v, v_next, d):
    outcome = outcome_of(reward, scene, v, v_next, d)
    # One after the other: since Python 3.12, sum() makes up for what is rounded.
    assert outcome.reward == reduce(add, outcome.terms.values())
    assert outcome.terms["safety"] <= 0 <= outcome.terms["efficiency"]


@pytest.mark.parametrize("name", MONOTONE)
@given(scene=scenes, atom=atoms, bound=bounds)
def test_best_is_monotone_without_negation(name, scene, atom, bound):
    assume(atom not in scene)
    before = outcome_of(REWARDS[name], scene).derived
    after = outcome_of(REWARDS[name], {**scene, atom: bound}).derived
    for known, (lower, upper) in before.items():
        assert after[known].lower >= lower - 1e-12
        assert after[known].upper >= upper - 1e-12


def test_pooled_is_not_monotone():
    """A second, less certain pedestrian lowers safe1: the paper's average, pinned on purpose."""
    one = {
        ("Pedestrian", "e1"): (0.9, 0.9),
        ("OnRoad", "e1"): (1, 1),
        ("CenterOf", "e1", "ego"): (1, 1),
    }
    two = {**one, ("Pedestrian", "e2"): (0.1, 0.1), ("OnRoad", "e2"): (1, 1),
           ("CenterOf", "e2", "ego"): (1, 1)}  # fmt: skip
    lowered = outcome_of(REWARDS["paper"], two).confidences["safe1"]
    assert lowered < outcome_of(REWARDS["paper"], one).confidences["safe1"]
    kept = outcome_of(REWARDS["best"], two).confidences["safe1"]
    assert kept == outcome_of(REWARDS["best"], one).confidences["safe1"]


@given(scene=scenes)
def test_of_several_rules_the_maximum_counts(scene):
    bound = outcome_of(REWARDS["paper"], scene).bounds["safe3"]
    alone = []
    for side in ("RightOf", "CenterOf", "LeftOf"):
        others = {"RightOf", "CenterOf", "LeftOf"} - {side}
        part = {atom: b for atom, b in scene.items() if atom[0] not in others}
        alone.append(outcome_of(REWARDS["paper"], part).bounds["safe3"])
    known = [b for b in alone if b is not None]
    expected = tuple(max(values) for values in zip(*known, strict=True)) if known else None
    assert bound == expected
