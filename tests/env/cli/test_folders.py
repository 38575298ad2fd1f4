"""Commands that write have their folder for themselves, and find out at once if they can't."""

import re

import pytest
import yaml
from typer.testing import CliRunner

from env.cli import app
from env.demo import demo
from env.evaluation import evaluate, sweep
from env.learning import training
from env.study import study
from env.tools import frames
from sfol.errors import SfolError, UsageError
from sfol.locking import locked_folder

SETUP = {
    "version": 2,
    "name": "small",
    "observation": "state",
    "perception": "truth",
    "stages": [{"steps": 16, "traffic": ["low"]}],
    "streets": 1,
    "learning": {"rollout_steps": 16, "batch_size": 16},
}
COMMANDS = {
    "evaluate": ["--cell", "low/full", "--perception", "truth"],
    "sweep": ["--perception", "truth"],
    "train": [],
    "study": [],
    "demo": [],
    "frames": ["train"],
}
# What each writes last.
PRODUCTS = {
    "evaluate": "cautious/low-full.json",
    "sweep": "sweep.json",
    "study": "figures/collision_test.md",
    "demo": "episodes.parquet",
}


@pytest.fixture(autouse=True)
def nothing_is_done(monkeypatch):
    def fail(*_, **__):
        raise AssertionError("the work has begun")

    monkeypatch.setattr(evaluate, "in_order", fail)
    monkeypatch.setattr(sweep, "in_order", fail)
    monkeypatch.setattr(training, "make_streets", fail)
    monkeypatch.setattr(study, "_study_one", fail)
    monkeypatch.setattr(demo, "_drive_all", fail)
    monkeypatch.setattr(frames, "frames_of_street", fail)


def run(name, output, tmp_path, *more):
    setup = tmp_path / "small.yaml"
    setup.write_text(yaml.safe_dump(SETUP))
    words = [name, *COMMANDS[name], "--output", str(output), *more]
    words += ["--setup", str(setup)] if name in {"train", "study"} else []
    return CliRunner().invoke(app, words)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_folder_in_use_is_refused_and_left_alone(name, tmp_path):
    with locked_folder(tmp_path / "run"):
        done = run(name, tmp_path / "run", tmp_path)
        assert isinstance(done.exception, SfolError), done.exception
        assert re.search(r"in use by process \d+ since 20.* \(.+\)", str(done.exception))
        assert [path.name for path in (tmp_path / "run").iterdir()] == [".lock"]


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("output", ["file", "file/run"])
def test_an_output_that_can_t_be_written_shows_before_the_work(name, output, tmp_path):
    (tmp_path / "file").write_text("kept")
    done = run(name, tmp_path / output, tmp_path)
    assert isinstance(done.exception, UsageError), done.exception
    assert "can't be written" in str(done.exception)
    assert (tmp_path / "file").read_text() == "kept"


@pytest.mark.parametrize(("name", "product"), PRODUCTS.items())
def test_a_folder_in_place_of_a_product_shows_before_the_work(name, product, tmp_path):
    (tmp_path / "run" / product).mkdir(parents=True)
    done = run(name, tmp_path / "run", tmp_path)
    assert isinstance(done.exception, UsageError), done.exception
    assert "can't be written" in str(done.exception)
    assert not (tmp_path / "run" / ".lock").exists()


@pytest.mark.parametrize("name", ["evaluate", "sweep", "demo", "train", "study"])
def test_a_seed_is_no_negative_number(name, tmp_path):
    done = run(name, tmp_path / "run", tmp_path, "--seed", "-1")
    assert done.exit_code == 2 or isinstance(done.exception, UsageError)
    assert not (tmp_path / "run" / "setup.json").exists()


@pytest.mark.parametrize("name", ["train", "study"])
def test_a_seed_that_numpy_does_not_take_is_refused_at_once(name, tmp_path):
    done = run(name, tmp_path / "run", tmp_path, "--seed", str(2**32))
    assert isinstance(done.exception, UsageError)
    assert "less than 4294967296" in str(done.exception)


def test_setups_of_one_name_are_refused(tmp_path):
    twin = tmp_path / "twin.yaml"
    twin.write_text(yaml.safe_dump(SETUP | {"streets": 2}))
    done = run("study", tmp_path / "run", tmp_path, "--setup", str(twin))
    assert isinstance(done.exception, UsageError)
    assert "2 setups are called 'small'" in str(done.exception)
