"""The child from behind parked vehicles, and the street where nobody crosses."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import sfol
from env.cli import app
from env.driving.drivers import FullThrottle, Oracle, TTCBrake
from env.driving.rollout import rollout
from env.evaluation import sweep
from env.evaluation.evaluate import drive_episode
from env.evaluation.sweep import APPROACHES, IMPACTS, SPEEDS, Sweep, run_sweeps
from env.street.variants import CHILD_PACE, LEAD, Approach, ChildCrossing, QuietStreet
from env.world.actors import Ego
from vsr.classes import SemanticClass

KB = sfol.KnowledgeBase.load("crossing")


@pytest.fixture(scope="module")
def stage():
    street = ChildCrossing(perception="truth", rules=KB)
    yield street
    street.close()


@pytest.fixture(scope="module")
def quiet():
    street = QuietStreet(traffic="high", occlusion="full", perception="truth", observation="state")
    yield street
    street.close()


def test_speeds_and_points_of_impact_are_those_of_the_sweep():
    assert SPEEDS == (10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60)
    assert IMPACTS == (0.25, 0.5, 0.75)
    assert len(APPROACHES) == 33


@pytest.mark.parametrize("speed", [10.0, 40.0, 60.0])
@pytest.mark.parametrize("impact", IMPACTS)
def test_without_braking_ego_hits_the_child_where_and_when_it_should(stage, speed, impact):
    stage.approach = Approach(speed, impact)
    transitions = list(rollout(stage, FullThrottle(), seed=0))
    assert transitions[-1].ending == "collision"
    speeds = {round(3.6 * t.info["speed"], 6) for t in transitions}
    assert speeds == {speed}
    # the child walks on for the rest of the step in which it is hit
    assert len(transitions) == pytest.approx(LEAD / 0.1, abs=1)
    near_side = stage.corridor.centre - stage.corridor.width / 2
    share = (stage.people.positions[0, 1] - near_side) / stage.corridor.width
    assert share == pytest.approx(impact, abs=0.1 * CHILD_PACE / stage.corridor.width)


def test_the_child_is_a_child_and_walks_on_whatever_comes(stage):
    stage.approach = Approach(30.0, 0.5)
    stage.reset(seed=0)
    assert stage.world.heights[0] < 1.3 < stage.world.heights[1:].min()
    start = stage.people.positions[0].copy()
    for _ in range(30):
        stage.step(np.array([-1.0], np.float32))
    assert stage.people.positions[0] == pytest.approx([start[0], start[1] + 3.0 * CHILD_PACE])


def test_a_car_is_parked_nearest_to_the_child_and_a_truck_behind_it(stage):
    stage.reset(seed=0)
    car, truck = stage.world.parked
    assert (car.kind, truck.kind) == (SemanticClass.VEHICLE, SemanticClass.TRUCK)
    assert stage.child_line - (car.place[0] + car.size.length / 2) == pytest.approx(1.0)
    gap = (car.place[0] - car.size.length / 2) - (truck.place[0] + truck.size.length / 2)
    assert 0.5 < gap < 2.0


def test_the_child_is_hidden_before_it_crosses(stage):
    stage.approach = Approach(40.0, 0.25)
    stage.reset(seed=0)
    hidden = []
    for _ in range(20):
        stage.step(np.array([1.0], np.float32))
        hidden.append(all(e.kind != SemanticClass.PEDESTRIAN for e in stage.scene.entities))
    assert any(hidden)


def test_the_oracle_never_hits_the_child(stage):
    for approach in (Approach(10.0, 0.75), Approach(60.0, 0.25)):
        stage.approach = approach
        *_, last = rollout(stage, Oracle(), seed=0)
        assert last.ending == "success"


def test_a_sweep_gives_a_result_for_each_approach_however_it_is_shared_out(monkeypatch):
    monkeypatch.setattr(sweep, "in_order", lambda work, jobs, workers: map(work, jobs))
    approaches = tuple(Approach(speed, 0.5) for speed in (20.0, 40.0, 60.0))
    sweeps = [Sweep("full_throttle", KB, approaches, perception="truth")]
    results = list(run_sweeps(sweeps, workers=2))
    assert [result.impact_speed for result in results] == pytest.approx([20.0, 40.0, 60.0])
    assert not any(result.stopped for result in results)


def test_the_command_prints_a_table_and_writes_json(tmp_path):
    command = ["sweep", "--driver", "full_throttle", "--perception", "truth", "--workers", "1"]
    folder = tmp_path / "[bold] [/]"  # no markup of the terminal
    done = CliRunner().invoke(app, [*command, "--output", str(folder)])
    assert done.exit_code == 0, done.output
    assert "hit at 60 km/h" in done.output
    content = json.loads((folder / "sweep.json").read_text())
    assert len(content["approaches"]) == len(APPROACHES)
    assert content["knowledge_base_hash"] == KB.hash


# ── The street where nobody crosses ──────────────────────────────────────────────────────────


def test_on_the_quiet_street_everybody_stays_on_the_sidewalks(quiet):
    for transition in rollout(quiet, FullThrottle(), seed=1):
        assert quiet.world.geometry.on_sidewalk(quiet.people.positions[:, 1]).all()
        assert transition.crosswalk_free
    assert transition.ending == "success"


class Nervous:
    """Brakes hard for a second whenever it is fast."""

    def reset(self):
        self.left = 0

    def __call__(self, street):
        self.left = 10 if street.ego.speed > 8.0 else self.left - 1
        return -1.0 if self.left > 0 else 1.0


def test_who_brakes_on_the_quiet_street_brakes_for_nothing(quiet):
    assert drive_episode(quiet, FullThrottle(), 1).result.measured["false_braking"] == 0
    assert drive_episode(quiet, Nervous(), 1).result.measured["false_braking"] > 10


def test_the_ttc_brake_is_not_startled_by_people_on_the_sidewalks(quiet):
    result = drive_episode(quiet, TTCBrake(), 2).result
    assert (result.ending, result.measured["false_braking"]) == ("success", 0)


def test_nobody_is_in_the_way_of_a_car_that_stands(quiet):
    quiet.reset(seed=3)
    quiet.ego = Ego(quiet.ego.parameters, 62.0)
    for _ in range(20):
        *_, info = quiet.step(np.array([-1.0], np.float32))
    assert info["distance"] == np.inf
