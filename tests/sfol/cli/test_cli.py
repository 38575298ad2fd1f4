"""The command line, as a user calls it."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import sfol

ROOT = Path(__file__).parents[3]
RULES = ROOT / "rules"


def run(*arguments, cwd=ROOT):
    return subprocess.run(
        [sys.executable, "-m", "sfol.cli", *map(str, arguments)],
        capture_output=True, text=True, cwd=cwd, check=False,
        env={"PATH": "/usr/bin:/bin", "COLUMNS": "200", "NO_COLOR": "1", "PYTHONPATH": str(ROOT)},
    )  # fmt: skip


def test_check_reports_every_file_as_valid():
    done = run("check", "rules/")
    assert done.returncode == 0
    files = sorted(str(p.relative_to(ROOT)) for p in RULES.rglob("*.yaml"))
    assert [line.partition(":")[0] for line in done.stdout.splitlines()] == files
    assert all(": valid (" in line for line in done.stdout.splitlines())
    assert done.stderr == ""


@pytest.fixture
def misspelt(tmp_path):
    shutil.copytree(RULES, tmp_path / "rules")
    path = tmp_path / "rules" / "aeb.yaml"
    text = path.read_text()
    rule = "safe2(X) :- Vehicle(X), Pedestrian(P), OnCrosswalk(P)."
    assert rule in text
    path.write_text(text.replace(rule, rule.replace("Pedestrian", "Pedestrain")))
    line = path.read_text()[: path.read_text().index("Pedestrain")].count("\n") + 1
    return tmp_path, line


def test_a_misspelt_predicate_is_reported_once_with_place_and_suggestion(misspelt):
    folder, line = misspelt
    done = run("check", "rules", cwd=folder)
    assert done.returncode == 2
    assert done.stderr == (
        f"rules/aeb.yaml:{line}:35: error: unknown predicate 'Pedestrain'"
        " — did you mean 'Pedestrian'?\n"
    )
    assert "Traceback" not in done.stdout + done.stderr


def test_the_grounding_section_is_checked_by_its_readers_model(tmp_path):
    shutil.copy(RULES / "aeb.yaml", tmp_path)
    text = (RULES / "crossing.yaml").read_text()
    (tmp_path / "crossing.yaml").write_text(text.replace("approaching:", "aproaching:"))
    done = run("check", tmp_path / "crossing.yaml")
    assert done.returncode == 2
    assert "unknown key 'aproaching' in grounding.segmentation" in done.stderr
    assert "did you mean 'approaching'?" in done.stderr


def test_the_tests_of_the_papers_knowledge_base_pass_with_full_coverage():
    done = run("test", "rules/aeb.yaml")
    assert done.returncode == 0, done.stdout
    assert "rule coverage 100%" in done.stdout
    assert " 0 failed" in done.stdout


def test_a_failing_test_shows_what_came_out(tmp_path):
    text = (RULES / "aeb.yaml").read_text()
    broken = tmp_path / "aeb.yaml"
    broken.write_text(text.replace("CenterOf(P, X).", "LeftOf(P, X)."))
    done = run("test", broken)
    assert done.returncode == 1
    assert "FAIL a pedestrian on the road straight ahead" in done.stdout
    assert "bound of safe1: expected [0.915, 0.96], found nothing concluded" in done.stdout


def test_explain_prints_the_proof_tree_as_text_and_as_json():
    arguments = ("explain", "aeb", "--facts", "Pedestrian(p1). OnCrosswalk(p1).",
                 "-s", "v=6", "-s", "v_next=5", "-s", "d=14")  # fmt: skip
    text = run(*arguments)
    assert text.returncode == 0
    assert "rule safe2 with X = ego, P = p1" in text.stdout
    tree = json.loads(run(*arguments, "--json").stdout)
    assert tree["kind"] == "reward"


def test_explain_takes_the_scene_of_a_test_or_of_a_file(tmp_path):
    name = "a pedestrian on the road straight ahead"
    assert "reward -0.06875" in run("explain", "aeb", "--test", name).stdout
    (tmp_path / "scene.txt").write_text("NoCrosswalk(ego). EmptyLane(ego).")
    (tmp_path / "wrong.txt").write_text("NoCrosswalk(ego).\n  EmptyLane{ego}.")
    wrong = run("explain", "aeb", "--facts", f"@{tmp_path}/wrong.txt")
    assert wrong.stderr.startswith(f"{tmp_path}/wrong.txt:2:12: error: ")
    scene = run(
        "explain", "aeb", "--facts", f"@{tmp_path}/scene.txt", "-s", "v=4", "-s", "v_next=4"
    )
    assert "efficiency1(ego) [1, 1]" in scene.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("check", "nowhere"), "there is no knowledge base 'nowhere'"),
        (("check", "nowhere.yaml"), "can't be read"),
        (("check", "vsr/"), "no knowledge base below"),
        (("explain", "aeb", "--test", "an empty raod is for driving"), "did you mean 'an empty road"),
        (("explain", "aeb", "-s", "v:6"), "'v:6' is not a signal"),
        (("explain", "aeb", "-s", "v=6"), "the signal 'v_next' is missing"),
        (("explain", "aeb", "--facts", "Pedestrian(p1)"), "'.' is expected"),
        (("explain", "aeb", "--facts", "@nowhere.txt"), "can't be read"),
    ],
)  # fmt: skip
def test_errors_end_with_two_and_no_traceback(arguments, message):
    done = run(*arguments)
    assert done.returncode == 2
    assert message in done.stderr
    assert "Traceback" not in done.stderr


def test_version_and_help():
    assert run("--version").stdout.strip() == sfol.__version__
    shown = run("--help").stdout
    assert all(command in shown for command in ("check", "test", "explain"))
