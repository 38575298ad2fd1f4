"""`sfol init`, and what all commands share."""

import re
import subprocess
import sys
from io import StringIO

import pytest

from sfol import KnowledgeBase, RewardFunction
from sfol.tools.starting import DOMAIN
from tests.sfol.command_line import ROOT, sfol

COMMANDS = ["check", "diff", "explain", "fmt", "graph", "init", "lint", "migrate", "replay", "schema", "show", "test"]  # fmt: skip


OBSERVE = "position=2.4, _, left_leg=0.2095, _"


@pytest.mark.parametrize(
    "options",
    [
        (),
        ("--subject", "lander", "--domain", "Land: softly, between 'the' # flags."),
        ("--subject", "lander", "--observe", OBSERVE),
        ("--observe", "x"),
        ("--observe", "x,y=1e-7,on=3e8", "--domain", "né\nné"),
        ("--observe", ",".join(f"x{i}" for i in range(63))),
    ],
)
def test_the_new_file_is_good_to_start_from(tmp_path, options):
    path = tmp_path / "my_rules.yaml"
    done = sfol("init", path, *options)
    assert done.code == 0, done.err
    assert f"sfol test {path}" in done.out
    kb = KnowledgeBase.load(path)
    given = dict(zip(options[::2], options[1::2], strict=True))
    assert (kb.name, kb.semantics.conjunction) == ("my_rules", "minimum")
    assert kb.subject == given.get("--subject", "robot")
    assert kb.description == given.get("--domain", DOMAIN)
    assert sfol("check", path).code == 0
    tested = sfol("test", path)
    assert tested.code == 0
    assert "rule coverage 100%" in tested.out
    assert sfol("fmt", "--check", path).code == 0
    assert sfol("lint", path).out == f"{path}: nothing found\n"
    assert path.read_text().count("#") > 8


def test_names_of_numbers_become_an_observation(tmp_path):
    path = tmp_path / "lander.yaml"
    sfol("init", path, "--subject", "lander", "--observe", OBSERVE)
    reward = RewardFunction(path)
    assert reward.kb.observation["state"].columns == {"position": 0, "left_leg": 2}
    facts = reward.observe([1.2, 9.0, 0.0, 9.0])
    assert str(facts) == "SmallPosition(lander): [0.5, 0.5].\nSmallLeftLeg(lander)."
    # No cliff: what hardly holds is hardly worth anything.
    rewards = [
        reward.transition([x, 0, 0, 0], None, [x, 0, 0, 0]).reward for x in (2.5, 2.39, 1.2, 0)
    ]
    assert rewards == pytest.approx([0.0, 0.01 / 2.4, 0.5, 1.0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--subject", "Robot"), "the subject 'Robot' is not a constant"),
        (("--subject", "two words"), "is not a constant"),
        (("--subject", "person"), "would share its name with the predicate 'Person'"),
        (("--subject", "small_x", "--observe", "x"), "with the predicate 'SmallX'"),
        (("--observe", "x,y,x"), "'x' is named twice"),
        (("--observe", "_,_"), "0 numbers of the observation are named"),
        (("--observe", ",".join(f"x{i}" for i in range(64))), "name 1 to 63"),
        (("--observe", "x,,y"), "'' is not a name"),
        (("--observe", "_x"), "begins with a letter"),
        (("--observe", "if"), "call it if_"),
        (("--observe", "x=wide"), "the margin of 'x' is 'wide'"),
        (("--observe", "x=0"), "how far from 0"),
        (("--observe", "x=nan"), "how far from 0"),
        (("--observe", "x=inf"), "how far from 0"),
    ],
)
def test_what_no_file_can_be_made_of_is_an_error(tmp_path, options, message):
    path = tmp_path / "x.yaml"
    done = sfol("init", path, *options)
    assert done.code == 2
    assert message in done.err
    assert not path.exists()


class Terminal(StringIO):
    """Somebody at a terminal, and what they type."""

    def isatty(self):
        return True


def test_it_asks_at_a_terminal(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.stdin", Terminal("cart\nKeep the pole upright.\nplace=2.4,_,tilt\n"))
    path = tmp_path / "cart.yaml"
    done = sfol("init", path)
    assert "Whom do the rules reward, in one word? [robot]" in done.out
    kb = KnowledgeBase.load(path)
    assert (kb.subject, kb.description) == ("cart", "Keep the pole upright.")
    assert [fact.atom.predicate for fact in kb.facts] == ["SmallPlace", "SmallTilt"]


def test_at_a_terminal_nothing_but_enter_gives_the_robot(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.stdin", Terminal("\n\n\n"))
    asked, silent = tmp_path / "a" / "x.yaml", tmp_path / "b" / "x.yaml"
    for path in (asked, silent):
        path.parent.mkdir()
    sfol("init", asked)
    monkeypatch.setattr("sys.stdin", StringIO())
    assert "Whom" not in sfol("init", silent).out
    assert asked.read_text() == silent.read_text()


def test_options_leave_nothing_to_ask(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.stdin", Terminal())
    assert sfol("init", tmp_path / "x.yaml", "--subject", "cart").code == 0


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
