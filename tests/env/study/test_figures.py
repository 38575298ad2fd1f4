"""Tables and figures of a study: what is pooled, what stays empty, and where the paper stands."""

import csv
import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scipy.stats import binomtest
from typer.testing import CliRunner

import sfol
from env.cli import app, main
from env.driving.setup import setup_names, training_name
from env.evaluation.evaluate import Drive, Settings, Summary
from env.evaluation.results import DriveResult, write_csv, write_json
from env.evaluation.statistics import Mean, Share
from env.study.figures import collision_test, driving
from env.study.figures.contenders import gather, groups, pool
from env.study.figures.curves import draw_curves, mean_curve, smoothed
from env.study.figures.driving import CHARACTERISTICS, driving_rows
from env.study.figures.paper import load_paper
from env.study.figures.radar import HALFWAY, Axis, axes_of, draw_radar
from env.study.figures.texts import as_cell, plain
from env.study.figures.trajectory import (
    UNGROUPED,
    at_crosswalk,
    draw_trajectory,
    head_groups,
    knowledge_base,
)
from env.study.study_results import (
    CurvePoint,
    StudyFolder,
    TrainingResult,
    Trajectory,
)
from env.world.cells import CELLS, Cell
from sfol.errors import FileError, UsageError
from sfol.knowledge_base.loading import bundled_folder

KB = sfol.KnowledgeBase.load("crossing")
PICTURES = {"radar.png", "fluctuation.png", "training_curves.png", "trajectory-add-seed0.png"}
TABLES = {"collision_test.md", "collision_test.csv", "driving.csv"}


def drive_of(driver, cell, success=90, collision=8, stop=3.0, stops=50, **options):
    """The result of 100 episodes; whoever collides does so at 5 m/s."""
    summary = Summary(
        steps=10_000,
        measured={
            "success": Share.out_of(success, 100),
            "collision": Share.out_of(collision, 100),
            "timeout": Share.out_of(100 - success - collision, 100),
            "near_miss": Share.out_of(20, 100),
            "false_braking": Share.out_of(30, 10_000),
            "stopping_distance": Mean(stop if stops else None, stops),
            "rms_speed": Mean(6.0 + success / 100, 100),
            "rms_acceleration": Mean(2.0, 100),
            "rms_jerk": Mean(5.0 + collision / 10, 100),
            "min_ttc": Mean(1.5 - collision / 100, 100),
            "impact_speed": Mean(5.0 if collision else None, collision),
            "time_to_goal": Mean(16.0 if success else None, success),
            "contact_at_rest": 0,
        },
        total={},
        discounted={},
        fluctuation={"safety": Mean(0.3, 100), "efficiency": Mean(0.1 + collision / 100, 100)},
        heads={},
        rules={},
    )
    settings = Settings(
        driver, None, *cell, True, "simulator", 100, 10_000, "crossing", KB.hash, 1.0
    )
    return DriveResult(replace(settings, **options), "aeb study", {}, summary)


def training_of(setup, seed):
    curve = tuple(CurvePoint(1000 * n, 10, float(n + seed), 0.5, 0.4, 0.1) for n in range(1, 21))
    evaluations = tuple({"steps": 5000.0 * n, "success": n / 5} for n in range(1, 5))
    return TrainingResult(
        setup, "hash", seed, 20_000, 1.0, "crossing", KB.hash, "policy", "aeb study", {},
        evaluations, curve,
    )  # fmt: skip


def trajectory_of(driver, **changes):
    steps = 60
    ramp = tuple(n / steps for n in range(steps))
    trajectory = Trajectory(
        driver=driver,
        policy="policy",
        traffic="high",
        occlusion="full",
        seed=10_000,
        ending="success",
        knowledge_base="crossing",
        knowledge_base_hash=KB.hash,
        command="aeb study",
        control_dt=0.1,
        crosswalk=(60.0, 64.0),
        position=tuple(40.0 + n for n in range(steps)),
        speed=tuple(10 * x for x in ramp),
        action=ramp,
        distance=(None,) * 10 + ramp[10:],
        reward=ramp,
        confidences=dict.fromkeys(KB.heads, ramp),
        weights=dict.fromkeys(KB.weights, ramp),
    )
    return replace(trajectory, **changes)


def write_drives(folder, results):
    for result in results:
        s = result.settings
        write_json(folder / s.driver / f"{s.traffic}-{s.occlusion}.json", result)


def figures(folder, *more):
    arguments = ["--study", "study", "--drivers", "drivers", "--output", "out"]
    paths = [x if x.startswith("--") else str(folder / x) for x in arguments]
    return CliRunner().invoke(app, ["figures", *paths, *more], env={"COLUMNS": "120"})


def cells_of(folder, name="collision_test.csv"):
    with (folder / "out" / name).open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def row_of(rows, **wanted):
    (row,) = (row for row in rows if wanted.items() <= row.items())
    return row


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """Two setups, one of them with two seeds that differ and one with a single cell more."""
    folder = tmp_path_factory.mktemp("study")
    drives = [drive_of("add-seed0", cell) for cell in CELLS]
    drives += [drive_of("add-seed1", cell, 80, 20, stop=5.0, stops=150) for cell in CELLS]
    drives += [drive_of("ssi-seed0", cell, 100, 0, stops=0) for cell in CELLS]
    drives.append(drive_of("sf-seed0", CELLS[0]))
    write_drives(folder / "study" / "drives", drives)
    write_drives(folder / "drivers", [drive_of("oracle", cell, 100, 0) for cell in CELLS])
    results = StudyFolder(folder / "study")
    for setup, seed in (("add", 0), ("add", 1), ("ssi", 0), ("ce_ps", 0)):
        results.write_training(training_name(setup, seed), training_of(setup, seed))
    results.write_trajectory("add-seed0", trajectory_of("add-seed0"))
    return folder


@pytest.fixture(scope="module")
def printed(study):
    done = figures(study)
    assert done.exit_code == 0, done.output
    return done.output


@pytest.fixture(scope="module")
def made(study, printed):
    return study


# -- the paper's numbers --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("label", "setup", "cell", "numbers"),
    [
        ("SF only", "sf", "high/partial", (86, 14, 0, 3.27)),
        ("SSI ⊕ SF", "add", "low/full", (99, 1, 0, 4.15)),
        ("SSI ⊗ SF", "multiply", "medium/full", (97, 3, 0, 5.79)),
        ("SSI only", "ssi", "high/full", (67, 33, 0, 2.06)),
        ("Risk factors", "risk_factors", "medium/partial", (95, 5, 0, 3.96)),
        ("CE & CS", "add", "high/full", (95, 5, 0, 4.11)),
        ("CE & PS", "ce_ps", "low/partial", (9, 91, 0, 0.85)),
        ("PE & CS", "pe_cs", "low/partial", (73, 8, 19, 5.94)),
        ("PE & PS", "pe_ps", "medium/full", (89, 10, 1, 3.93)),
    ],
)
def test_the_paper_s_numbers_stand_in_their_row_and_column(made, label, setup, cell, numbers):
    traffic, occlusion = cell.split("/")
    row = row_of(cells_of(made), label=label, traffic=traffic, occlusion=occlusion)
    assert row["setup"] == setup
    names = ("success", "collision", "timeout", "stopping_distance")
    found = [float(row[f"{name}_paper"]) for name in names]
    assert found == pytest.approx([*(x / 100 for x in numbers[:3]), numbers[3]])


def test_the_paper_s_outcomes_add_up_except_where_the_remark_says_so():
    paper = load_paper()
    odd = {
        (setup.label, cell): c.success + c.collision + c.timeout
        for s in paper.sets
        for setup in s.setups
        for cell, c in setup.cells.items()
        if c.success + c.collision + c.timeout != 100
    }
    assert odd == {("PE & CS", "high/full"): 110}
    assert any("PE & CS" in remark and "110 %" in remark for remark in paper.remarks)


def test_the_paper_s_setups_are_those_of_the_project_with_all_cells():
    for table in load_paper().sets:
        for setup in table.setups:
            assert setup.name in setup_names()
            assert list(setup.cells) == [str(cell) for cell in CELLS]


# -- pooling --------------------------------------------------------------------------------------


def test_seeds_are_pooled_over_their_episodes_and_their_range_is_told(made):
    row = row_of(cells_of(made), label="CE & CS", traffic="low", occlusion="full")
    interval = binomtest(170, 200).proportion_ci(0.95, method="wilson")
    assert (row["seeds"], row["episodes"]) == ("2", "200")
    assert float(row["success"]) == 0.85
    assert float(row["success_low"]) == pytest.approx(interval.low, abs=1e-6)
    assert float(row["success_high"]) == pytest.approx(interval.high, abs=1e-6)
    assert (float(row["success_least_seed"]), float(row["success_most_seed"])) == (0.8, 0.9)
    assert float(row["stopping_distance"]) == (50 * 3.0 + 150 * 5.0) / 200
    assert row["stopping_distance_episodes"] == "200"
    text = (made / "out" / "collision_test.md").read_text()
    assert re.search(r"\| CE & CS \| full \| 2 \| 85 \[79–89\] \{80–90\} \| 99 \|", text)


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(0, 50)), min_size=1, max_size=5))
def test_pooled_shares_are_shares_of_all_episodes_together(parts):
    shares = [Share.out_of(count, count + rest) for count, rest in parts]
    counts = sum(count for count, _ in parts), sum(map(sum, parts))
    assert pool(shares) == Share.out_of(*counts)


def test_a_level_pools_both_occlusions_of_those_seeds_that_have_both():
    results = [
        drive_of("add-seed0", Cell("low", "partial"), 90, 10),
        drive_of("add-seed0", Cell("low", "full"), 70, 30),
        drive_of("add-seed1", Cell("low", "partial"), 10, 90),
    ]
    (row,) = driving_rows(gather(results, []).setups.values())
    assert row.traffic == "low"
    near_miss, impacts = row.measured["near_miss"].whole, row.measured["impact_speed"].whole
    assert (near_miss.count, near_miss.of) == (40, 200)
    assert (impacts.mean, impacts.episodes) == (5.0, 40)


def test_drives_under_different_conditions_are_not_pooled():
    results = [
        drive_of("add-seed0", CELLS[0]),
        drive_of("add-seed1", CELLS[0], perception="unet"),
    ]
    with pytest.raises(UsageError, match=r"add-seed1.*differ in perception"):
        gather(results, [])


def test_streets_where_nobody_crosses_are_left_out():
    results = [drive_of("add-seed0", CELLS[0], hazard=False)]
    assert gather(results, results).setups == {}
    assert gather(results, results).drivers == {}


# -- tables ---------------------------------------------------------------------------------------


def test_cells_without_results_stay_empty(made):
    rows = cells_of(made)
    assert row_of(rows, setup="sf", traffic="low", occlusion="partial")["success"] == "0.9"
    missing = [row_of(rows, setup="sf", traffic="low", occlusion="full")]
    missing += [row for row in rows if row["setup"] in {"multiply", "pe_ps"}]
    assert len(missing) == 1 + 2 * len(CELLS)
    for row in missing:
        assert row["seeds"] == "0"
        for name in ("success", "collision_low", "timeout", "stopping_distance"):
            assert row[name] == ""
        assert row["success_paper"]
    text = (made / "out" / "collision_test.md").read_text()
    assert "| PE & PS | full | – | – | 91 | – | 9 | – | 0 | – | – | 4.12 |" in text


def test_a_stopping_distance_that_no_episode_has_stays_empty(made):
    row = row_of(cells_of(made), setup="ssi", traffic="low", occlusion="full")
    assert (row["stopping_distance"], row["stopping_distance_episodes"]) == ("", "0")
    assert row["success"] == "1"


def test_scripted_drivers_stand_below_without_numbers_of_the_paper(made):
    rows = cells_of(made)
    assert {row["setup"] for row in rows[-len(CELLS) :]} == {"oracle"}
    assert row_of(rows, setup="oracle", traffic="low", occlusion="full")["success_paper"] == ""


def test_setups_that_the_paper_does_not_have_get_a_table_of_their_own():
    *sets, others = groups(load_paper(), ["add", "mine"])
    assert len(sets) == 2
    assert others.labels == {"mine": "mine"}
    assert len(groups(load_paper(), ["add"])) == 2


def test_the_terminal_shows_ours_and_the_paper_s(printed):
    lines = printed.splitlines()
    ours = next(n for n, line in enumerate(lines) if "CE & CS" in line)
    assert lines[ours].split()[3:] == 6 * ["85/14/1"]
    assert lines[ours + 2].split() == [
        "paper", "99/1/0", "99/1/0", "97/3/0", "95/5/0", "97/3/0", "95/5/0",
    ]  # fmt: skip


def test_driving_characteristics_are_in_si_units_per_level(made):
    rows = cells_of(made, "driving.csv")
    assert {row["driver"] for row in rows} == {"add", "ssi", "oracle"}  # sf lacks a cell of each
    row = row_of(rows, driver="add", traffic="high")
    assert float(row["false_braking"]) == 0.003
    assert float(row["impact_speed"]) == 5.0
    assert row["impact_speed_episodes"] == str(2 * (8 + 20))
    assert row_of(rows, driver="ssi", traffic="high")["impact_speed"] == ""


# -- radar ----------------------------------------------------------------------------------------


@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=8, unique=True), st.booleans())
def test_outward_is_better_and_the_range_is_used(values, starred):
    axis = Axis.over([*values, None], starred=starred)
    best, worst = (min, max) if starred else (max, min)
    assert axis.outward(best(values)) == 1.0
    assert axis.outward(worst(values)) == 0.0
    assert all(0.0 <= axis.outward(value) <= 1.0 for value in values)


def test_what_nobody_has_is_a_gap_and_never_zero():
    axis = Axis.over([3.0, 5.0, None], starred=True)
    assert np.isnan(axis.outward(None))
    assert np.isnan(Axis.over([None], starred=True).outward(None))


def test_where_all_are_equal_they_are_drawn_halfway():
    axis = Axis.over([2.0, 2.0], starred=False)
    assert axis.flat
    assert axis.outward(2.0) == HALFWAY


def test_the_paper_s_starred_characteristics_are_inverted():
    results = [drive_of("add-seed0", cell, 90, 10) for cell in CELLS]
    results += [drive_of("ssi-seed0", cell, 50, 50) for cell in CELLS]
    rows = driving_rows(gather(results, []).setups.values())
    axes = axes_of(rows)
    starred = {c.name for c in CHARACTERISTICS if c.starred}
    assert starred == {
        "rms_acceleration", "rms_jerk", "impact_speed", "near_miss", "false_braking", "time_to_goal",
    }  # fmt: skip
    assert (axes["rms_jerk"].worst, axes["rms_jerk"].best) == (10.0, 6.0)
    assert (axes["min_ttc"].worst, axes["min_ttc"].best) == (1.0, 1.4)


def test_gaps_and_axes_on_which_all_are_equal_are_told_below_the_plots():
    results = [drive_of("add-seed0", cell, 90, 10) for cell in CELLS[:5]]
    results += [drive_of("ssi-seed0", cell, 100, 0) for cell in CELLS]
    setups = gather(results, []).setups
    figure = draw_radar(driving_rows(setups.values()), groups(load_paper(), setups))
    text = figure.get_supxlabel().replace("\n", " ")
    assert "min TTC 1.4 → 1.5 s" in text
    assert "RMS jerk* 6 → 5 m/s³" in text
    assert re.search(r"drawn halfway: [^.]*time to goal\*", text)
    assert "impact speed*: ssi (low), ssi (medium), ssi (high)." in text
    assert "not driven yet: add (high)." in text


# -- training curves ------------------------------------------------------------------------------


def test_smoothing_weighs_points_by_their_episodes():
    points = [
        CurvePoint(100, 1, 0.0, 0, 0, 0),
        CurvePoint(200, 3, 8.0, 0, 0, 0),
        CurvePoint(300, 0, 99.0, 0, 0, 0),
        CurvePoint(900, 5, 7.0, 0, 0, 0),
    ]
    steps, totals = smoothed(points, window=200)
    assert steps.tolist() == [100, 200, 900]
    assert totals.tolist() == [6.0, 6.0, 7.0]


def test_seeds_are_averaged_where_all_of_them_have_been():
    long = np.array([0.0, 10.0, 20.0]), np.array([0.0, 10.0, 20.0])
    short = np.array([5.0, 15.0]), np.array([1.0, 1.0])
    steps, values = mean_curve([long, short])
    assert steps.tolist() == [5, 10, 15]
    assert values.tolist() == [3.0, 5.5, 8.0]


def test_a_training_without_an_episode_of_its_own_has_its_evaluations_drawn():
    training = replace(training_of("add", 0), curve=())
    figure = draw_curves([training], groups(load_paper(), ["add"]))
    returns, *_, successes = figure.axes
    assert not returns.lines
    assert successes.lines[0].get_ydata().tolist() == [0.2, 0.4, 0.6, 0.8]


# -- trajectories ---------------------------------------------------------------------------------


def test_heads_are_grouped_by_the_weights_of_the_episode_s_rules():
    trajectory = trajectory_of("add-seed0")
    kb, remark = knowledge_base(trajectory)
    assert kb.hash == KB.hash
    assert "changed" not in remark
    assert head_groups(trajectory, kb) == {
        weight: tuple(KB.weights[weight].coefficients) for weight in ("efficiency", "safety")
    }


def test_the_rules_of_a_setup_are_found_by_their_hash():
    rules = sfol.KnowledgeBase.load("crossing", "risk_factors")
    there = trajectory_of("x", knowledge_base=rules.name, knowledge_base_hash=rules.hash)
    kb, remark = knowledge_base(there)
    assert kb.hash == rules.hash
    assert "changed" not in remark


def test_rules_that_have_changed_or_are_gone_are_told():
    changed = trajectory_of("x", knowledge_base_hash="0" * 64)
    assert "changed" in knowledge_base(changed)[1]
    gone = trajectory_of("x", knowledge_base="nowhere", knowledge_base_hash="0" * 64)
    kb, remark = knowledge_base(gone)
    assert kb is None
    assert "isn't at hand" in remark
    assert head_groups(gone, kb) == {UNGROUPED: tuple(gone.confidences)}


def test_the_time_on_the_crosswalk_is_that_of_ego_s_front():
    on = trajectory_of("x", position=(58.0, 59.9, 60.0, 62.0, 64.0) + 55 * (64.1,), control_dt=0.5)
    assert list(at_crosswalk(on)) == [(1.0, 2.5)]
    assert list(at_crosswalk(trajectory_of("x", position=60 * (1.0,)))) == []


# -- files ----------------------------------------------------------------------------------------


def test_all_tables_and_pictures_are_written(made):
    assert {path.name for path in (made / "out").iterdir()} == TABLES | PICTURES


@pytest.mark.parametrize("name", sorted(PICTURES))
def test_pictures_fit_a_page_and_are_not_blank(made, name):
    path = made / "out" / name
    assert path.stat().st_size < 300_000
    with Image.open(path) as picture:
        assert picture.format == "PNG"
        pixels = np.asarray(picture.convert("RGB"), int)
    assert pixels.shape[1] <= 1300
    coloured = np.ptp(pixels, axis=2) > 60
    assert coloured.any(axis=1).mean() > 0.3  # colour all over the height, and the width
    assert coloured.any(axis=0).mean() > 0.3


def test_what_has_no_data_is_not_written_and_is_told(study, tmp_path):
    shutil.copytree(study / "drivers", tmp_path / "drivers")
    done = figures(tmp_path)
    assert done.exit_code == 0, done.output
    assert {path.name for path in (tmp_path / "out").iterdir()} == TABLES
    for name in ("radar.png", "fluctuation.png", "training_curves.png", "trajectory-….png"):
        assert re.search(rf"not written: {name}: .*`aeb study`", done.output)


def test_a_drive_of_one_cell_makes_the_collision_test_alone(tmp_path):
    write_drives(tmp_path / "study" / "drives", [drive_of("add-seed0", CELLS[0])])
    done = figures(tmp_path)
    assert done.exit_code == 0, done.output
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"collision_test.md", "collision_test.csv"}
    assert "not written: driving.csv: nobody has driven both cells" in done.output


def test_without_any_result_the_command_says_what_makes_some(tmp_path):
    done = figures(tmp_path)
    assert isinstance(done.exception, UsageError)
    assert "aeb study" in str(done.exception)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "place",
    ["study/drives/add-seed0/low-full.json", "study/training/x.json", "study/trajectories/x.json"],
)
def test_a_file_that_is_no_result_is_named(tmp_path, place, capsys, monkeypatch):
    path = tmp_path / place
    path.parent.mkdir(parents=True)
    path.write_text('{"settings": 1}')
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["aeb", "figures", "--study", "study", "--output", "out"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    shown = capsys.readouterr().err
    assert place in shown
    assert "Traceback" not in shown
    assert not (tmp_path / "out").exists()


# -- names and texts from files -------------------------------------------------------------------

OUTSIDE = [
    "x/../../../../ESCAPED",
    "..",
    "/tmp/x",
    "a/b",
    ".hidden",
    "=1+1",
    "<b>",
    "[/]",
    "a|b",
    "",
]


def everything(folder):
    return {path for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("name", OUTSIDE)
@pytest.mark.parametrize("kind", ["drives/x/low-full", "training/x", "trajectories/x"])
def test_a_name_that_leads_elsewhere_is_refused_and_nothing_is_written(tmp_path, kind, name):
    results = {
        "drives/x/low-full": drive_of(name, CELLS[0]),
        "training/x": training_of(name, 0),
        "trajectories/x": trajectory_of(name),
    }
    folder = tmp_path / "deep" / "in"
    write_json(folder / "study" / f"{kind}.json", results[kind])
    before = everything(tmp_path)
    done = figures(folder)
    assert isinstance(done.exception, FileError)
    assert "is no name" in str(done.exception)
    assert f"{kind}.json" in str(done.exception)
    assert everything(tmp_path) == before


@pytest.mark.parametrize("name", ["x/../../../../ESCAPED", "..", ""])
def test_no_folder_of_results_goes_by_such_a_name(tmp_path, name):
    folder = StudyFolder(tmp_path / "study")
    drive = Drive("cautious", CELLS[0], KB, name=name or ".")
    for use in (
        lambda: folder.training(name),
        lambda: folder.trajectory(name),
        lambda: folder.write_training(name, training_of("add", 0)),
        lambda: folder.write_trajectory(name, trajectory_of("add")),
        lambda: folder.drives.find(drive),
        lambda: folder.drives.write(drive, [], "a command"),
    ):
        with pytest.raises(UsageError, match="is no name"):
            use()
    assert not everything(tmp_path)


@pytest.mark.parametrize(
    ("field", "value"), [("traffic", "<b>"), ("occlusion", "../x"), ("perception", "=1+1")]
)
def test_other_words_of_a_result_are_those_that_are_known(tmp_path, field, value):
    write_json(tmp_path / "study/drives/x/x.json", drive_of("x", CELLS[0], **{field: value}))
    done = figures(tmp_path)
    assert isinstance(done.exception, FileError)
    assert not (tmp_path / "out").exists()


def test_the_knowledge_base_of_a_trajectory_is_no_path(tmp_path):
    rules = tmp_path / "mine.yaml"
    rules.write_text((bundled_folder() / "crossing.yaml").read_text())
    named = trajectory_of("add-seed0", knowledge_base=str(rules), knowledge_base_hash="other")
    kb, remark = knowledge_base(named)
    assert kb is None
    assert "isn't at hand" in remark


def test_a_trajectory_has_a_number_for_each_step(tmp_path):
    with pytest.raises(UsageError, match="a number for each of its steps"):
        trajectory_of("add-seed0", speed=(1.0, 2.0))
    path = tmp_path / "study/trajectories/add-seed0.json"
    write_json(path, trajectory_of("add-seed0"))
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"action": []}))
    done = figures(tmp_path)
    assert isinstance(done.exception, FileError)
    assert "a number for each of its steps" in str(done.exception)


@given(st.text(st.characters(blacklist_categories=["Cs"])) | st.text("|<>[]()`*\\\n\x1b=+-@'\"&;#"))
def test_a_text_is_one_cell_of_a_markdown_table_and_no_html(text):
    cell = as_cell(text)
    assert "<" not in cell
    assert cell.isprintable()
    assert not re.search(r"(?<!\\)(\\\\)*[|`*\[]", cell)


def test_labels_are_escaped_in_the_tables():
    nasty = "a|<img src=x># [x](y)"
    contenders = gather([drive_of(f"{nasty}-seed0", cell) for cell in CELLS], [])
    paper = load_paper()
    table = collision_test.markdown(collision_test.collision_rows(contenders, paper), paper)
    for text in (table, driving.markdown(driving_rows(contenders.setups.values()))):
        assert "<img" not in text
        assert r"| a\|&lt;img src=x># \[x](y) |" in text


@given(st.text(min_size=1))
def test_no_cell_of_a_csv_file_is_a_formula(tmp_path_factory, text):
    file = tmp_path_factory.mktemp("csv") / "one.csv"
    text = text.encode(errors="replace").decode()
    write_csv(file, [{"name": text, "speed": -1.5}])
    with file.open(encoding="utf-8", newline="") as opened:
        (row,) = csv.DictReader(opened)
    assert row["speed"] == "-1.5"
    assert row["name"].removeprefix("'") == text.removeprefix("'")
    assert not row["name"].startswith(("=", "+", "-", "@", "\t", "\r", "\n"))


def test_names_of_weights_and_heads_are_drawn_as_they_are():
    nasty = ("$\\frac{", "_hidden", "\x1b[0m", "$", "[/]")
    ramp = trajectory_of("x").speed
    trajectory = trajectory_of(
        "x",
        knowledge_base="$\\frac{",
        knowledge_base_hash="other",
        confidences=dict.fromkeys(nasty, ramp),
        weights=dict.fromkeys(nasty, ramp),
    )
    figure = draw_trajectory(trajectory)
    figure.canvas.draw()
    legend = figure.axes[1].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == list(map(plain_label, nasty))


def plain_label(name):
    return plain(name).lstrip("_")


@pytest.mark.parametrize("name", ["[bold]", "[/]", "[/nothing]", "[link=x]"])
def test_an_output_may_have_any_name(tmp_path, name):
    write_drives(tmp_path / "study" / "drives", [drive_of("add-seed0", CELLS[0])])
    done = figures(tmp_path, "--output", str(tmp_path / name))
    assert done.exit_code == 0, done.output
    assert (tmp_path / name / "collision_test.md").exists()
    assert f"{name}/collision_test.md" in done.output.replace("\n", "")
