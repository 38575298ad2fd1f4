"""The collision test: what it measures, writes and skips, and that processes change nothing."""

import csv
import json
import pickle
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import sfol
from env.cli import app
from env.driving.drivers import DRIVERS
from env.driving.policies import file_hash
from env.driving.rollout import Ending, rollout
from env.evaluation import evaluate as evaluation
from env.evaluation.evaluate import Drive, drive_episode, evaluate, summarize
from env.evaluation.results import DriveResult, ResultFolder, read_json
from env.evaluation.returns import REFERENCE_BEHAVIOURS, BehaviourReturn, faults
from env.evaluation.statistics import Mean
from env.world.cells import CELLS, Cell
from sfol.errors import SfolError
from sfol.logs import read_log

KB = sfol.KnowledgeBase.load("crossing")
CELL = Cell("low", "full")
QUICK = ["--cell", "low/full", "--perception", "truth", "--workers", "1"]


def drive(driver="full_throttle", **options):
    options = {"episodes": 2, "perception": "truth"} | options
    return Drive(driver, CELL, KB, **options)


@pytest.fixture(scope="module")
def street():
    street = drive().street()
    yield street
    street.close()


@pytest.fixture(scope="module")
def measured(street):
    """Episodes of two drivers, with their transitions as numbers."""
    episodes = []
    for driver, seed in (("full_throttle", 0), ("full_throttle", 1), ("cautious", 0)):
        result = drive_episode(street, DRIVERS[driver](), seed).result
        steps = [
            (t.speed, dict(t.info), t.outcome.reward)
            for t in rollout(street, DRIVERS[driver](), seed)
        ]
        episodes.append((result, steps))
    return episodes


def test_an_episode_s_measures_are_those_of_its_steps(measured):
    for result, steps in measured:
        infos = [info for _, info, _ in steps]
        speeds = [steps[0][0], *(info["speed"] for info in infos)]
        accelerations = np.diff(speeds) / 0.1
        assert result.steps == len(steps)
        assert result.seconds == pytest.approx(0.1 * len(steps))
        assert result.measured["rms_speed"] == pytest.approx(np.sqrt(np.mean(np.square(speeds))))
        assert result.measured["rms_acceleration"] == pytest.approx(
            np.sqrt(np.mean(accelerations**2))
        )
        assert result.measured["rms_jerk"] == pytest.approx(
            np.sqrt(np.mean((np.diff(accelerations) / 0.1) ** 2))
        )
        assert result.measured["min_ttc"] == min(info["ttc"] for info in infos)
        assert result.total == pytest.approx(sum(reward for *_, reward in steps))
        assert result.discounted == pytest.approx(
            sum(0.997**k * reward for k, (*_, reward) in enumerate(steps))
        )
        for head, count in result.heads.items():
            assert count == sum(info[f"confidence_{head}"] > 0 for info in infos)
        safety = [info["weight_safety"] for info in infos]
        assert result.fluctuation["safety"] == pytest.approx(
            np.abs(np.diff(safety)).sum() / result.seconds
        )


def test_collisions_have_an_impact_speed_and_no_near_miss(measured):
    endings = set()
    for result, steps in measured:
        endings.add(result.ending)
        assert result.measured["impact_speed"] == (
            steps[-1][1]["speed"] if steps[-1][1]["collision"] else None
        )
        near = result.measured["min_ttc"] is not None and result.measured["min_ttc"] <= 2.0
        assert result.measured["near_miss"] == (near and result.ending == "success")
    assert endings == {"collision", "success"}


def test_the_rules_of_a_head_are_counted_apart(measured):
    for result, _ in measured:
        assert set(result.rules) == set(KB.rules)
        safe3 = [result.rules[f"safe3_{side}"] for side in ("right", "center", "left")]
        assert max(safe3) <= result.heads["safe3"] <= sum(safe3)
        assert result.rules["safe1"] == result.heads["safe1"]


def test_a_summary_counts_endings_and_leaves_out_who_has_no_number(measured):
    results = [result for result, _ in measured]
    summary = summarize(results)
    endings = [result.ending for result in results]
    assert summary.measured["collision"].count == endings.count("collision")
    assert summary.measured["success"].count + summary.measured[
        "collision"
    ].count + summary.measured["timeout"].count == len(results)
    assert summary.measured["impact_speed"].episodes == summary.measured["collision"].count
    assert summary.measured["time_to_goal"].episodes == summary.measured["success"].count
    assert (
        summary.measured["false_braking"].of
        == summary.steps
        == sum(result.steps for result in results)
    )
    assert summary.total["timeout"] == Mean(None, 0)


def test_what_comes_back_of_an_episode_holds_no_frames(street):
    driven = drive_episode(street, DRIVERS["full_throttle"](), 0)
    assert len(pickle.dumps(driven)) < 10_000


def test_processes_change_nothing():
    drives = [drive(), drive("oracle", episodes=1)]
    assert list(evaluate(drives, workers=1)) == list(evaluate(drives, workers=2))


def test_cells_go_by_name():
    assert len(CELLS) == 6
    assert all(Cell.parse(str(cell)) == cell for cell in CELLS)
    with pytest.raises(SfolError, match="did you mean 'low/full'"):
        Cell.parse("low/ful")


@pytest.mark.parametrize(
    ("stem", "name"),
    [
        ("add-seed0", "add-seed0"),
        ("my policy (1)", "my_policy_1_"),
        ("..[bold]", "_bold_"),
        ("ä" * 99, "_"),
    ],
)
def test_what_a_policy_is_called_is_a_name(tmp_path, stem, name):
    file = tmp_path / f"{stem}.safetensors"
    file.write_bytes(b"")
    some = Drive(str(file), CELLS[0], sfol.KnowledgeBase.load("crossing"))
    assert some.settings.driver == f"{name}-{file_hash(file)}"
    assert ResultFolder(tmp_path).file(some).parent.parent == tmp_path


# ── The command ──────────────────────────────────────────────────────────────────────────────


def aeb(*arguments):
    return CliRunner().invoke(app, ["evaluate", *map(str, arguments)])


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results") / "[bold] [/]"  # no markup of the terminal
    command = ["--driver", "full_throttle", "--episodes", 3, "--record", "--output", folder, *QUICK]
    return folder, command, aeb(*command)


def test_the_command_prints_tables_and_writes_files(run):
    folder, _, done = run
    assert done.exit_code == 0, done.output
    for title in ("Collision test", "Driving", "Rule coverage"):
        assert title in done.output
    files = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    stem = "full_throttle/low-full"
    assert files == {"summary.csv", *(f"{stem}.{kind}" for kind in ("json", "csv", "parquet"))}


def test_the_result_says_what_made_it_and_what_came_out(run):
    folder, _, _ = run
    content = json.loads((folder / "full_throttle/low-full.json").read_text())
    assert content["settings"]["seed"] == 10_000
    assert content["settings"]["knowledge_base_hash"] == KB.hash
    assert content["versions"]["sfol"] == sfol.__version__
    assert content["command"].startswith("aeb evaluate --driver full_throttle --cell low/full")
    rows = list(csv.DictReader((folder / "full_throttle/low-full.csv").open()))
    assert [row["seed"] for row in rows] == ["10000", "10001", "10002"]
    collisions = [row["ending"] for row in rows].count("collision")
    assert content["summary"]["collision"]["count"] == collisions
    (line,) = csv.DictReader((folder / "summary.csv").open())
    assert float(line["collision"]) == pytest.approx(collisions / 3, abs=1e-5)


def test_the_log_gives_the_same_returns_again(run):
    folder, _, _ = run
    log = read_log(folder / "full_throttle/low-full.parquet")
    rows = list(csv.DictReader((folder / "full_throttle/low-full.csv").open()))
    reward = sfol.RewardFunction(KB)
    for episode, row in zip(log.episodes, rows, strict=True):
        assert episode.ending == row["ending"]
        total = sum(reward(step.facts, **step.signals) for step in episode.steps)
        assert total == pytest.approx(float(row["total"]), rel=1e-4)


def stamps(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("low-full.*")}


def test_what_is_there_is_not_driven_again_unless_asked(run):
    folder, command, first = run
    before = stamps(folder)
    again = aeb(*command)
    assert "1 of 1 cells are there already" in again.output
    assert stamps(folder) == before
    assert tables(again.output) == tables(first.output)
    assert aeb(*command, "--again").exit_code == 0
    assert all(stamp > before[path] for path, stamp in stamps(folder).items())


def tables(output):
    return output[output.index("Collision test") :]


def test_other_settings_are_driven_anew(run, tmp_path):
    folder = ResultFolder(tmp_path)
    some = drive()
    folder.write(some, evaluate([some]), "a command")
    assert folder.find(some).command == "a command"
    others = [{"seed": 5}, {"episodes": 3}, {"hazard": False}, {"perception": "simulator"}]
    assert all(folder.find(drive(**other)) is None for other in others)
    assert folder.find(some, log=True) is None


def test_a_result_is_read_back_as_it_was_written(tmp_path):
    folder, some = ResultFolder(tmp_path), drive(episodes=1)
    result = folder.write(some, evaluate([some]), "a command")
    assert result.summary.measured["stopping_distance"].mean is None
    assert read_json(folder.file(some), DriveResult) == result


def test_nothing_is_left_half_written(tmp_path):
    folder, some = ResultFolder(tmp_path), drive()

    def interrupted():
        yield next(iter(evaluate([some], logs=True)))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        folder.write(some, interrupted(), "a command", log=True)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_damaged_result_is_an_error(tmp_path):
    folder, some = ResultFolder(tmp_path), drive()
    folder.file(some).parent.mkdir()
    folder.file(some).write_text("{}")
    with pytest.raises(SfolError, match="is no result"):
        folder.find(some)


def test_a_damaged_result_of_another_drive_shows_before_anybody_drives(tmp_path, monkeypatch):
    (tmp_path / "crawl").mkdir()
    (tmp_path / "crawl/low-full.json").write_text('{"settings": 7}')
    nobody_drives(monkeypatch)
    done = aeb("--driver", "full_throttle", "--episodes", 1, "--output", tmp_path, *QUICK)
    message = str(done.exception)
    assert "crawl/low-full.json' is no result: settings: " in message
    assert "remove it" in message


def nobody_drives(monkeypatch):
    def fail(*_, **__):
        raise AssertionError("somebody drives")

    monkeypatch.setattr(evaluation, "in_order", fail)


RUNS = st.fixed_dictionaries(
    {"episodes": st.integers(1, 2), "discount": st.sampled_from([0.9, 1.0]), "log": st.booleans()}
)


@given(runs=st.lists(RUNS, min_size=1, max_size=6))
@settings(max_examples=25)
def test_the_files_of_a_cell_are_those_of_one_run(episodes_of_two, tmp_path_factory, runs):
    """Whatever was there before, a log or a table that is found belongs to its result."""
    folder = ResultFolder(tmp_path_factory.mktemp("runs"))
    for run in runs:
        log = run["log"]
        asked = drive(episodes=run["episodes"], discount=run["discount"])
        if folder.find(asked, log=log) is None:
            folder.write(asked, episodes_of_two[: asked.episodes], "a command", log=log)
        assert folder.find(asked, log=log) is not None
        rows = list(csv.DictReader(folder.file(asked, ".csv").open()))
        assert len(rows) == asked.episodes
        parquet = folder.file(asked, ".parquet")
        assert parquet.exists() or not log
        if parquet.exists():
            assert len(read_log(parquet).episodes) == asked.episodes


@pytest.fixture(scope="module")
def episodes_of_two():
    return list(evaluate([drive()], logs=True))


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("change", [Path.unlink, lambda path: path.write_bytes(b"another's")])
def test_a_result_beside_which_another_s_file_stands_is_not_taken(
    tmp_path, episodes_of_two, suffix, change
):
    folder, some = ResultFolder(tmp_path), drive()
    folder.write(some, episodes_of_two, "a command", log=True)
    assert folder.find(some, log=True) is not None
    change(folder.file(some, suffix))
    assert folder.find(some, log=True) is None


def test_results_from_before_there_were_hashes_count_without_their_logs(tmp_path, episodes_of_two):
    folder, some = ResultFolder(tmp_path), drive()
    folder.write(some, episodes_of_two, "a command", log=True)
    content = json.loads(folder.file(some).read_text())
    del content["files"]
    folder.file(some).write_text(json.dumps(content | {"schema_version": 2}))
    assert folder.find(some) is not None
    assert folder.find(some, log=True) is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--driver", "cautios"], "did you mean 'cautious'"),
        (["--cell", "low/fall"], "did you mean 'low/full'"),
        (["--cell", "low/full", "--traffic", "low"], "use one way"),
        (["--rules", "crosing"], "did you mean 'crossing'"),
        (["--driver", "nowhere.zip"], "no policy file"),
    ],
)
def test_mistakes_are_named_before_anybody_drives(tmp_path, options, message):
    done = aeb(*options, "--output", tmp_path / "results")
    assert isinstance(done.exception, SfolError)
    assert message in str(done.exception)
    assert not (tmp_path / "results").exists()


def test_the_help_teaches():
    output = aeb("--help").output
    assert "aeb evaluate --driver cautious" in re.sub(r"\s+", " ", output)
    for name in DRIVERS:
        assert name in output


# ── Returns ──────────────────────────────────────────────────────────────────────────────────


def returns(*values):
    return [
        BehaviourReturn(behaviour.name, Mean(value, 1), Mean(value, 1))
        for behaviour, value in zip(REFERENCE_BEHAVIOURS, values, strict=True)
    ]


def test_behaviours_name_drivers_and_endings():
    for behaviour in REFERENCE_BEHAVIOURS:
        assert behaviour.driver in DRIVERS
        assert behaviour.ending in Ending.__args__


def test_a_reward_in_order_has_no_faults():
    assert faults(returns(-50.0, 0.0, 5.0, 60.0, 70.0)) == []


@pytest.mark.parametrize(
    ("values", "less", "more"),
    [
        ((1.0, 0.0, 5.0, 60.0, 70.0), "collision", "standing still"),
        ((-1.0, 65.0, 5.0, 60.0, 70.0), "standing still", "goal, carefully"),
        ((-1.0, 0.0, 80.0, 90.0, 70.0), "crawling", "goal, at once"),
    ],
)
def test_what_pays_better_than_it_should_is_a_fault(values, less, more):
    (fault,) = faults(returns(*values))
    assert fault.startswith(f"'{less}'")
    assert f"'{more}'" in fault


def test_a_behaviour_without_episodes_says_nothing():
    assert faults(returns(None, 0.0, None, 60.0, None)) == []


@pytest.mark.long
def test_the_command_tells_whether_the_reward_is_exploitable(tmp_path):
    done = aeb("--returns", "--episodes", 4, "--output", tmp_path, *QUICK)
    assert done.exit_code == 0, done.output
    assert re.search("exploitable|in order", done.output)
