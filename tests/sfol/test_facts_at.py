"""Which state's facts reward a step: that before the action, or the one after it."""

import numpy as np
import pytest

import sfol
from sfol.knowledge_base.printing import to_yaml
from sfol.testing.cases import run_tests
from sfol.tools.diff import compare

LAKE = """\
version: 1
name: lake
subject: walker
background: [Walker(walker)]
predicates:
  Walker(X): X walks on the ice.
  At(X, Y): X is at the place Y.
rules:
  arrived: arrived(X) :- Walker(X), At(X, goal).
observation:
  cell: {}
facts_at: FACTS_AT
facts:
  At(walker, goal): {formula: cell == 15, bounds: exact}
weights:
  arrival: {normalizer: 1, coefficients: {arrived: 1.0}}
terms:
  arrival: {weight: arrival, formula: 1}
tests:
  - {name: onto the goal, observation: 14, next: 15, expect: {reward: EXPECTED}}
"""
TO_THE_GOAL = (2, 2, 1, 1, 1, 2)  # right, right, down, down, down, right


@pytest.fixture
def lake(tmp_path):
    def load(facts_at, expected=1):
        path = tmp_path / "lake.yaml"
        path.write_text(LAKE.replace("FACTS_AT", facts_at).replace("EXPECTED", str(expected)))
        return sfol.RewardFunction(path)

    return load


@pytest.mark.parametrize(("facts_at", "last"), [("state", 0.0), ("next", 1.0)])
def test_a_terminal_state_is_rewarded_by_the_facts_of_the_next_state(lake, facts_at, last):
    gymnasium = pytest.importorskip("gymnasium")
    from sfol.wrappers import RuleReward  # noqa: PLC0415 (it needs gymnasium)

    env = RuleReward(gymnasium.make("FrozenLake-v1", is_slippery=False), lake(facts_at))
    env.reset(seed=0)
    rewards = []
    for action in TO_THE_GOAL:
        *_, reward, terminated, _, info = env.step(action)
        rewards.append(reward)
    assert terminated
    assert info["original_reward"] == 1.0
    assert rewards == [0.0] * 5 + [last]


@pytest.mark.parametrize("given", [None, "facts"])
def test_facts_of_a_function_are_those_of_the_same_state(lake, given):
    gymnasium = pytest.importorskip("gymnasium")
    from sfol.wrappers import RuleReward  # noqa: PLC0415

    reward = lake("next")
    facts = None if given is None else lambda cell, info, env: reward.observe(cell)
    env = RuleReward(gymnasium.make("FrozenLake-v1", is_slippery=False), reward, facts=facts)
    env.reset(seed=0)
    assert [env.step(action)[1] for action in TO_THE_GOAL] == [0, 0, 0, 0, 0, 1]


def test_one_transition_and_many_are_the_same(lake):
    before, after = np.array([14, 15, 3]), np.array([15, 15, 4])
    for facts_at, expected in (("state", [0, 1, 0]), ("next", [1, 1, 0])):
        reward = lake(facts_at)
        single = [reward.transition(s, None, t).reward for s, t in zip(before, after, strict=True)]
        assert single == reward.transition(before, None, after).reward.tolist() == expected


@pytest.mark.parametrize("before", [14, np.array([14, 14])])
def test_the_next_observation_is_asked_for(lake, before):
    with pytest.raises(sfol.errors.FactError, match="observation after the action is not given"):
        lake("next").transition(before)


@pytest.mark.parametrize(("facts_at", "right"), [("state", 0), ("next", 1)])
def test_tests_of_a_file_know_it(lake, facts_at, right):
    assert run_tests(lake(facts_at, right).kb).passed
    assert not run_tests(lake(facts_at, 1 - right).kb).passed


def test_it_is_part_of_the_meaning(lake):
    state, following = lake("state").kb, lake("next").kb
    assert state.hash != following.hash
    assert [(c.section, c.before[""], c.after[""]) for c in compare(state, following)] == [
        ("facts_at", "state", "next")
    ]


def test_it_is_written_and_read_again(lake, tmp_path):
    path = tmp_path / "again.yaml"
    path.write_text(to_yaml(lake("next").kb))
    assert sfol.KnowledgeBase.load(path).facts_at == "next"


def test_another_word_is_an_error(lake):
    with pytest.raises(sfol.errors.InvalidKnowledgeBase, match="facts_at: input should be 'state'"):
        lake("both")
