"""`sfol init`, and what all commands share."""

import re
import subprocess
import sys

import pytest

from sfol.knowledge_base import KnowledgeBase
from tests.sfol.command_line import ROOT, sfol

COMMANDS = ["check", "diff", "explain", "fmt", "graph", "init", "lint", "replay", "schema", "show", "test"]  # fmt: skip


def test_the_new_file_is_good_to_start_from(tmp_path):
    path = tmp_path / "my_rules.yaml"
    done = sfol("init", path)
    assert done.code == 0
    assert f"sfol test {path}" in done.out
    assert KnowledgeBase.load(path).name == "my_rules"
    assert sfol("check", path).code == 0
    tested = sfol("test", path)
    assert tested.code == 0
    assert "rule coverage 100%" in tested.out
    assert sfol("fmt", "--check", path).code == 0
    assert sfol("lint", path).out == f"{path}: nothing found\n"
    assert path.read_text().count("#") > 8


@pytest.mark.parametrize("stem", ["123", "yes", "a b: c", "né"])
def test_any_file_name_makes_a_name(tmp_path, stem):
    path = tmp_path / f"{stem}.yaml"
    assert sfol("init", path).code == 0
    assert KnowledgeBase.load(path).name == stem


def test_it_replaces_nothing_unless_told(tmp_path):
    path = tmp_path / "x.yaml"
    path.write_text("mine")
    done = sfol("init", path)
    assert (done.code, path.read_text()) == (2, "mine")
    assert "--force replaces it" in done.err
    assert sfol("init", path, "--force").code == 0
    assert KnowledgeBase.load(path).name == "x"
    assert "is no YAML file — such as x.yaml" in sfol("init", tmp_path / "x.txt").err
    assert "can't be written" in sfol("init", path / "y.yaml").err


def test_help_lists_every_command():
    shown = sfol("--help").out
    assert set(COMMANDS) <= set(re.findall(r"^│ ([a-z]+) ", shown, re.M))


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command_teaches_with_an_example(command):
    done = sfol(command, "--help")
    assert done.code == 0
    assert f"sfol {command}" in done.out.partition("Example:")[2]


def test_colours_are_not_forced_and_no_color_is_respected():
    for environment in ({"NO_COLOR": "1", "FORCE_COLOR": "1"}, {}):
        done = subprocess.run(
            [sys.executable, "-m", "sfol.cli", "diff", "aeb", "crossing"],
            capture_output=True, text=True, cwd=ROOT, check=False,
            env={"PATH": "/usr/bin:/bin", "PYTHONPATH": str(ROOT), **environment},
        )  # fmt: skip
        assert done.returncode == 1
        assert "[31m" not in done.stdout
