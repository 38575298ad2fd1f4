"""The demo, as a user calls it: one page, one table, every rule of the base seen at work."""

import json
import math
import re

import numpy as np
import pytest
from typer.testing import CliRunner

import sfol
from env.cli import app
from env.demo.recording import coverage, drive, most_dangerous
from env.driving.drivers import DRIVERS
from env.street.crossing import OccludedCrossing
from sfol.logs import read_log


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo") / "[bold] [/]"  # no markup of the terminal
    return CliRunner().invoke(app, ["demo", "--output", str(folder)]), folder


def test_the_demo_ends_well_and_writes_the_report(demo):
    result, folder = demo
    assert result.exit_code == 0, result.output
    assert {path.name for path in folder.iterdir()} == {"report.html", "episodes.parquet"}


def test_its_log_gives_the_same_rewards_again(demo):
    returns = re.findall(r"(-?\d+\.\d) *$", demo[0].output, re.MULTILINE)
    log = read_log(demo[1] / "episodes.parquet")
    reward = sfol.RewardFunction("crossing")
    totals = [
        sum(reward(step.facts, **step.signals) for step in episode.steps)
        for episode in log.episodes
    ]
    assert [f"{total:.1f}" for total in totals] == returns[: len(log.episodes)]


def test_it_prints_the_episodes_and_the_proof_of_the_most_dangerous_moment(demo):
    output = demo[0].output
    for driver in ("trained", "cautious", "full_throttle"):
        assert driver in output
    assert "contact at" in output
    assert re.search(r"^reward -\d", output, re.MULTILINE)
    assert "rule safe" in output


def test_every_rule_of_the_paper_was_above_zero_at_least_once(demo):
    rows = dict(re.findall(r"^ *((?:safe|efficiency)\d) +(\S+)", demo[0].output, re.MULTILINE))
    assert set(rows) == {f"{name}{i}" for name in ("safe", "efficiency") for i in (1, 2, 3)}
    assert all(int(count) > 0 for count in rows.values())


def test_the_report_holds_every_step(demo):
    text = (demo[1] / "report.html").read_text()
    data = json.loads(re.search(r'type="application/json"[^>]*>(.*?)</script>', text, re.DOTALL)[1])
    (steps,) = map(int, re.findall(r"^(\d+) steps in", demo[0].output, re.MULTILINE))
    assert sum(len(episode["frames"]) for episode in data["episodes"]) == steps


@pytest.fixture(scope="module")
def episode():
    street = OccludedCrossing(traffic="high", occlusion="full", max_seconds=4.0)
    yield drive(street, DRIVERS["full_throttle"](), 3, name="full_throttle")
    street.close()


def test_a_recorded_step_can_be_evaluated_again(episode):
    kb = sfol.KnowledgeBase.load("crossing")
    reward = sfol.RewardFunction(kb)
    for step in episode.steps:
        facts = sfol.Facts.parse(step.facts, margin=kb.grounding.margin)
        again = reward.evaluate(facts, v=step.speed, v_next=step.speed_next, d=step.distance)
        assert again.reward == step.reward
        assert again.terms == step.terms


def test_what_a_recorded_episode_holds(episode):
    assert (episode.traffic, episode.occlusion, episode.ending) == ("high", "full", "timeout")
    assert len(episode.steps) == 40
    for before, after in zip(episode.steps, episode.steps[1:], strict=False):
        assert before.speed_next == after.speed
        assert after.time == pytest.approx(before.time + episode.control_dt)
    last = episode.steps[-1]
    assert last.descriptor.shape == (2048,)
    assert np.isfinite(last.descriptor).all()
    weights = {entity.kind: set() for entity in last.entities}
    for entity in last.entities:
        weights[entity.kind].add(entity.weight)
        assert all(entity.name in fact for fact in entity.facts)
    assert weights["pedestrian"] <= {0.5, 1.0}
    assert weights["truck"] == {0.75}


def test_coverage_counts_steps(episode):
    counts = coverage([episode], ["efficiency1", "safe3", "nothing"])
    assert counts["efficiency1"] == sum(s.confidences["efficiency1"] > 0 for s in episode.steps)
    assert counts["nothing"] == 0


def test_the_most_dangerous_moment_is_the_smallest_time_to_collision(episode):
    which, index = most_dangerous([episode])
    assert which == 0
    times = [step.ttc for step in episode.steps]
    if math.isfinite(min(times)):
        assert times[index] == min(times)
    else:
        assert episode.steps[index].distance == min(step.distance for step in episode.steps)


def test_rules_of_ones_own_and_mistakes(tmp_path):
    result = CliRunner().invoke(
        app, ["demo", "--rules", "crosing", "--output", str(tmp_path / "x")]
    )
    assert isinstance(result.exception, sfol.errors.InvalidKnowledgeBase)
    assert "did you mean 'crossing'?" in str(result.exception)
    assert not (tmp_path / "x").exists()
