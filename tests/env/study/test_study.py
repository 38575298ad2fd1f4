"""The study: from setups to results, each made once, with episodes of two seconds."""

from dataclasses import replace
from functools import partial

import pytest
import yaml
from typer.testing import CliRunner

from env.cli import app
from env.driving.setup import load_setup, setup_names, training_name
from env.evaluation import evaluate
from env.learning import curriculum
from env.street.crossing import OccludedCrossing
from env.study import study
from env.study.study import StudyPlan, quick, run_study
from env.study.study_results import StudyFolder
from env.world.cells import Cell

SMALL = {
    "version": 2,
    "name": "small",
    "decision_steps": 1,
    "stages": [{"steps": 48, "traffic": ["low"], "occlusion": ["partial"]}],
    "streets": 1,
    "evaluation_episodes": 1,
    "learning": {"rollout_steps": 16, "batch_size": 16, "n_epochs": 1, "layers": [8]},
}
FAST = {"observation": "state", "perception": "truth"}
HERE = (Cell("low", "partial"), Cell("high", "full"))


@pytest.fixture(autouse=True)
def short_episodes(monkeypatch):
    short = partial(OccludedCrossing, max_seconds=2.0)
    monkeypatch.setattr(curriculum, "OccludedCrossing", short)
    monkeypatch.setattr(evaluate, "OccludedCrossing", short)


@pytest.fixture
def plan(tmp_path):
    return StudyPlan(
        setups={"my/small.yaml": load_setup(write(tmp_path, **FAST))},
        seeds=(3,),
        cells=HERE,
        episodes=2,
        in_short=False,
        workers=1,
        trainings=tmp_path / "trainings",
        results=StudyFolder(tmp_path / "results"),
    )


def write(folder, **settings):
    path = folder / "small.yaml"
    path.write_text(yaml.safe_dump(SMALL | settings))
    return path


def run(plan):
    """Run a study and return what it has worked on."""
    seen = {}
    run_study(plan, lambda what, done, total: seen.update({what: (done, total)}))
    return seen


def test_every_setup_and_seed_is_trained_and_drives_in_every_cell(plan):
    seen = run(plan)
    assert seen == {
        "small-seed3: training": (48, 48),
        "small-seed3: low/partial": (2, 2),
        "small-seed3: high/full": (2, 2),
    }
    (training,) = plan.results.trainings()
    assert (training.setup, training.seed, training.steps) == ("small", 3, 48)
    assert sum(point.episodes for point in training.curve) == 2  # of 20 steps each
    assert training.evaluations[-1]["steps"] == 48
    drives = plan.results.drive_results()
    assert {(d.settings.traffic, d.settings.occlusion) for d in drives} == set(HERE)
    for drive in drives:
        assert drive.settings.driver == "small-seed3"
        assert drive.settings.policy == training.policy
        assert drive.settings.perception == "truth"
        assert drive.summary.measured["timeout"].count == 2
        assert "aeb study --setup my/small.yaml --seed 3" in drive.command
    (trajectory,) = plan.results.trajectories()
    assert (trajectory.traffic, trajectory.occlusion) == HERE[-1]
    columns = [*trajectory.confidences.values(), *trajectory.weights.values()]
    assert {len(column) for column in columns} == {len(trajectory.speed)} == {20}


def test_what_has_a_result_is_not_done_again_even_if_the_policy_is_gone(plan, monkeypatch):
    run(plan)
    plan.trainings.rename(plan.trainings.with_name("gone"))
    assert run(plan) == {}


def test_only_what_is_missing_is_done(plan, tmp_path):
    run(plan)
    file = tmp_path / "results/drives/small-seed3/high-full.json"
    before = file.read_text()
    file.unlink()
    assert run(plan) == {"small-seed3: high/full": (2, 2)}
    assert file.read_text() == before


def test_a_stretch_without_an_episode_is_no_point_of_the_curve():
    ending = {"is_success": 1.0, "collision": 0.0, "timeout": 0.0}
    returns = {8: 1.0, 10: 3.0, 11: 5.0, 99: 7.0}
    rows = [{"steps": steps, "return": value, **ending} for steps, value in returns.items()]
    points = list(study._curve(rows, 600))
    assert [point.steps for point in points] == [10, 20, 100]
    assert [point.episodes for point in points] == [2, 1, 1]
    assert [point.total for point in points] == [2.0, 5.0, 7.0]
    assert {point.success for point in points} == {1.0}


@pytest.mark.parametrize("name", setup_names())
def test_in_short_a_setup_keeps_all_but_its_length(name):
    setup = load_setup(name)
    short = quick(setup)
    assert short.steps == 3 * short.learning.rollout_steps
    assert short.learning.layers == setup.learning.layers
    kept = {"name", "rules", "observation", "perception", "fusion", "speed", "frames", "streets"}
    assert short.model_dump(include=kept) == setup.model_dump(include=kept)


def test_from_the_camera_to_the_figures(tmp_path):
    """The whole chain with the paper's observation: three updates, one cell, one episode."""
    words = ["study", "--setup", str(write(tmp_path, observation="vsr")), "--cell", "low/partial"]
    folder = tmp_path / "[bold] [/] study"  # no markup of the terminal
    options = ["--episodes", "1", "--workers", "1", "--trainings", str(tmp_path / "trainings")]
    done = CliRunner().invoke(app, [*words, *options, "--output", str(folder)])
    assert done.exit_code == 0, done.output
    assert StudyFolder(folder).training(training_name("small", 0)).steps == 48
    assert (folder / "figures" / "trajectory-small-seed0.png").stat().st_size > 10_000
    assert (folder / "figures" / "collision_test.md").is_file()


def test_what_a_ray_cluster_has_done_is_done(plan):
    pytest.importorskip("ray", reason="a Ray cluster needs the extra ray")
    assert run(replace(plan, ray="local")) == {"trainings": (1, 1)}
    (training,) = plan.results.trainings()
    assert training.steps == 48
    assert len(plan.results.drive_results()) == len(HERE)
    assert run(plan) == {}
