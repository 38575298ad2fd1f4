"""One reward function in many places: copies, processes, threads; and flat memory."""

import copy
import gc
import multiprocessing
import pickle
import tracemalloc
from concurrent.futures import ThreadPoolExecutor

import pytest

from sfol import Facts, RewardFunction

SIGNALS = {"v": 6.0, "v_next": 5.5, "d": 9.0}


def scenes():
    for i in range(40):
        facts = Facts()
        for j in range(i % 7):
            facts.add("Pedestrian", f"p{j}", confidence=(i + j) % 10 / 10)
            facts.add(("OnRoad", "OnCrosswalk")[j % 2], f"p{j}")
            facts.add("CenterOf", f"p{j}", "ego")
        if i % 3 == 0:
            facts.add("Truck", "t1", confidence=0.5)
            facts.add("Crosswalk", "a1", confidence=0.9)
            facts.add("RightOf", "t1", "ego")
            facts.add("Occludes", "t1", "a1")
        yield facts


def rewards(reward):
    outcomes = [reward.evaluate(facts, **SIGNALS) for facts in scenes()]
    return [(o.reward, dict(o.derived)) for o in outcomes]


@pytest.fixture
def reward():
    reward = RewardFunction("aeb")
    reward.coefficients["safety"]["safe1"] = 0.25
    return reward


def test_copies_give_the_same(reward):
    expected = rewards(reward)
    assert rewards(copy.copy(reward)) == expected
    assert rewards(copy.deepcopy(reward)) == expected
    assert rewards(pickle.loads(pickle.dumps(reward))) == expected


@pytest.mark.parametrize("method", ["spawn", "fork"])
def test_other_processes_give_the_same(reward, method):
    with multiprocessing.get_context(method).Pool(2) as pool:
        assert pool.map(rewards, [reward, reward]) == [rewards(reward)] * 2


def test_eight_threads_share_one(reward):
    expected = rewards(reward)
    with ThreadPoolExecutor(8) as threads:
        assert list(threads.map(rewards, [reward] * 40)) == [expected] * 40


def test_outcomes_explanations_and_facts_can_be_pickled(reward):
    facts = Facts.parse("Pedestrian(p1). OnCrosswalk(p1): 0.4.")
    outcome = reward.evaluate(facts, **SIGNALS)
    explanation = reward.explain(facts, **SIGNALS)
    sent = pickle.loads(pickle.dumps(outcome))
    assert sent == outcome
    assert sent.fired == outcome.fired == {"safe2"}
    assert reward.evaluate(sent.conclusions, **SIGNALS) == outcome
    assert pickle.loads(pickle.dumps(explanation)).to_dict() == explanation.to_dict()
    assert pickle.loads(pickle.dumps(facts)) == facts


def test_calls_leave_nothing_behind(reward):
    def work(times):
        for _ in range(times):
            rewards(reward)
            reward.evaluate(reward.batch(list(scenes())), **SIGNALS)

    work(2)
    gc.collect()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    work(5)
    gc.collect()
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert after - before < 20_000  # bytes; one outcome that stays in each call would be 300,000


def test_a_batch_frees_its_arrays_without_the_garbage_collector(reward):
    batch = reward.batch(list(scenes()))
    reward.evaluate(batch, **SIGNALS)
    gc.collect()
    gc.disable()
    try:
        reward.evaluate(batch, **SIGNALS)
        assert gc.collect() == 0
    finally:
        gc.enable()
