"""The benchmark: what it repeats, and that it reports every figure. No time is asserted."""

import json
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from typer.testing import CliRunner

import sfol.cli.bench
import sfol.tools.bench
import sfol.tools.bench_hand_written
import sfol.tools.bench_observations
from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.cli.app import app
from sfol.errors import KnowledgeBaseError
from sfol.tools.bench import busiest, measure, median, repeated
from sfol.tools.bench_hand_written import in_turns, measure_hand_written
from sfol.tools.bench_observations import measure_observations
from sfol.tools.hand_written import HAND_WRITTEN


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(sfol.tools.bench, "_SECONDS", 0.0)
    monkeypatch.setattr(sfol.tools.bench, "SIZES", (1, 3))
    monkeypatch.setattr(sfol.tools.bench, "BATCHES", (1, 4))
    monkeypatch.setattr(sfol.tools.bench, "GRADIENT_SCENES", 4)
    monkeypatch.setattr(sfol.tools.bench_observations, "SCENES", (1, 4))
    monkeypatch.setattr(sfol.tools.bench_observations, "ENVIRONMENTS", 2)
    monkeypatch.setattr(sfol.tools.bench_hand_written, "SECONDS", 0.0)
    monkeypatch.setattr(sfol.tools.bench_hand_written, "SCENES", (1, 4))
    # PyReason takes minutes to start.
    there = {"torch": find_spec("torch")}
    monkeypatch.setattr(sfol.tools.bench, "find_spec", there.get)


def test_the_scene_is_the_richest_test_and_its_busiest_entity():
    kb = KnowledgeBase.load("aeb")
    case, entity = busiest(kb)
    assert (case.name, entity) == ("a busy street with much to see at once", "p1")


def test_an_entity_is_repeated_with_all_that_is_said_of_it():
    kb = KnowledgeBase.load("aeb")
    case, entity = busiest(kb)
    facts = Facts()
    for (predicate, arguments), bound in repeated(kb, case, entity, 4):
        facts.add(predicate, *arguments, bound=bound)
    for predicate in ("Pedestrian", "OnRoad", "CenterOf", "IsNear"):
        assert len(facts.relation(predicate)) == 4
    assert len(facts.relation("Vehicle")) == 2
    once = RewardFunction(kb).evaluate(Facts.parse(case.facts), **case.signals)
    assert RewardFunction(kb).evaluate(facts, **case.signals).confidences == pytest.approx(
        once.confidences, abs=0.05
    )


def test_every_figure_is_reported(quick):
    pytest.importorskip("torch")
    stages = []
    figures = measure(KnowledgeBase.load("aeb"), progress=stages.append)
    assert stages == ["import", "single", "batch", "gradient", "observations", "hand_written"]
    assert set(figures["single"]) == {"1", "3"}
    assert set(figures["batch"]) == {"1", "4"}
    assert all(value > 0 for row in figures["single"].values() for value in row.values())
    assert figures["gradient"]["ratio"] > 0
    assert figures["observations"] is None  # aeb reads none
    assert figures["hand_written"] is None  # nor is it written by hand


def test_without_torch_there_is_no_figure_of_a_gradient(quick, monkeypatch):
    monkeypatch.setattr(sfol.tools.bench, "find_spec", lambda name: None)
    figures = measure(KnowledgeBase.load("aeb"))
    assert figures["gradient"] is None
    assert figures["batch"]


def test_the_command_prints_json_and_tables(quick):
    pytest.importorskip("torch")
    done = CliRunner().invoke(app, ["bench", "aeb", "--json"])
    assert json.loads(done.stdout)["knowledge_base"] == "aeb"
    shown = CliRunner().invoke(app, ["bench", "cartpole"]).stdout
    assert "scenes a second" in shown
    assert "repeated: pole" in shown
    assert "observed steps, by how many at once" in shown
    assert "the same reward by hand" in shown
    assert "torch cpu 4" in shown


OBSERVING = ("cartpole", "doorkey", "fetch", "frozenlake", "highway", "lunarlander", "spread")


@pytest.mark.parametrize("name", ["aeb_state", *OBSERVING])
def test_steps_that_are_observed_are_measured_too(quick, name):
    pytest.importorskip("gymnasium")
    pytest.importorskip("torch")
    figures = measure_observations(KnowledgeBase.load(name), median)
    paces = {f"{kind}_scenes_a_second" for kind in ("list_of_facts", "numpy", "torch")}
    assert {scenes: set(row) for scenes, row in figures["batch"].items()} == {
        "1": paces,
        "4": paces,
    }
    wrappers = figures["wrappers"]
    assert wrappers.pop("environments") == 2
    for row in (*figures["batch"].values(), figures["single"], wrappers):
        assert all(value > 0 for value in row.values())


def test_the_step_is_the_test_that_observes_most(quick):
    figures = measure_observations(KnowledgeBase.load("aeb_state"), lambda call: 1.0)
    assert figures["step"].startswith("ten people on the crosswalk")


def test_a_file_without_a_scene_is_an_error(kitchen):
    with pytest.raises(KnowledgeBaseError, match="has no test with an entity besides 'cook'"):
        measure(kitchen())


@pytest.mark.parametrize("left_out", [False, True])
def test_the_start_without_a_cache_can_be_left_out(quick, monkeypatch, left_out):
    monkeypatch.setattr(sfol.tools.bench, "find_spec", lambda name: name == "pyreason")
    monkeypatch.setattr(sfol.tools.bench, "_single", lambda *_: {})
    monkeypatch.setattr(sfol.tools.bench, "_gradient", lambda *_: None)
    monkeypatch.setattr(sfol.tools.bench, "ready", lambda: {"ready_in_a_new_process_s": 7.0})
    monkeypatch.setattr(sfol.tools.bench, "ready_compared", lambda: {"cold_s": 590.0})
    figures = measure(KnowledgeBase.load("aeb"), quick=left_out)
    assert figures["pyreason_start"] == {"ready_in_a_new_process_s": 7.0}
    assert ("pyreason_start_compared" in figures) == (not left_out)


@pytest.mark.parametrize("name", HAND_WRITTEN)
def test_rules_are_measured_beside_the_same_reward_by_hand(quick, name):
    pytest.importorskip("torch")
    figures = measure_hand_written(KnowledgeBase.load(name))
    assert {"numpy 1", "numpy 4", "torch cpu 1", "torch cpu 4"} <= set(figures)
    for row in figures.values():
        assert row["difference"] <= 1e-9
        assert row["ratio"] > 0
        assert row["rules_scenes_a_second"] > 0


@pytest.mark.parametrize("name", HAND_WRITTEN)
def test_rewards_by_hand_are_those_of_the_rules_on_steps_of_every_kind(name):
    by_hand, reward = HAND_WRITTEN[name], RewardFunction(name)
    before, after = by_hand.steps(np.random.default_rng(1), 3000)
    outcome = reward.transitions(before, None, after)
    assert by_hand.reward(np, before, after) == pytest.approx(outcome.reward, abs=1e-9)
    for head in set(reward.kb.heads) - {"Vehicle"}:  # which is asserted of ego
        assert 0 < np.count_nonzero(outcome.confidences[head]) < 3000, head
    assert all(np.any(term) for term in outcome.terms.values())


def test_unequal_rewards_have_no_ratio(quick, monkeypatch):
    kb = KnowledgeBase.load("cartpole")
    weight = kb.weights["balance"].model_copy(update={"coefficients": {"balanced": 1.0 + 1e-6}})
    other = replace(kb, weights={**kb.weights, "balance": weight})
    for row in measure_hand_written(other).values():
        assert set(row) == {"difference"}
        assert 1e-9 < row["difference"] < 1e-5
    monkeypatch.setattr(sfol.cli.bench.KnowledgeBase, "load", lambda _: other)
    assert "no ratio where the rewards" in CliRunner().invoke(app, ["bench", "cartpole"]).stdout


def test_a_reward_that_nobody_wrote_by_hand_is_not_compared():
    assert measure_hand_written(KnowledgeBase.load("doorkey")) is None


def test_both_sides_are_called_in_turns(quick):
    calls = []
    in_turns(lambda: calls.append(1), lambda: calls.append(2))
    assert calls == [1, 2] * (len(calls) // 2)
