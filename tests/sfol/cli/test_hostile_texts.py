"""What a file says reaches the terminal as it stands: no markup, no commands to the terminal."""

import subprocess
import sys

import pytest

from tests.sfol.command_line import ROOT, sfol

LINK = "[link=https://example.org]click[/link]"
NAMES = [
    LINK,
    "[/]",
    "[bold]",
    "\\[/]",
    "a\\",
    "[red]x",
    "=HYPERLINK(1)",
    "<b>&\"'",
    "🙂 é",
    "x" * 300,
]
FILE = """\
version: 1
name: {name}
description: {name}
predicates: {{P(X): {name}}}
rules: {{{name}: {{rule: h(X) :- P(X)., description: {name}}}}}
signals: {{v: {{unit: {name}, description: {name}}}}}
weights: {{{name}: {{normalizer: 1, coefficients: {{h: 1}}, description: {name}}}}}
terms: {{{name}: {{weight: {name}, formula: k * v, parameters: {{k: 1}}, description: {name}}}}}
tests: [{{name: {name}, facts: P(ego)., signals: {{v: 1}}, expect: {{reward: 2}}}}]
"""
COMMANDS = [
    *(["check"], ["test"], ["show"], ["lint"], ["fmt", "--check"], ["graph"], ["diff", "aeb"]),
    ["explain", "--facts", "P(ego).", "-s", "v=1"],
]


def quoted(name):
    return "'" + name.replace("'", "''") + "'"


@pytest.mark.parametrize("name", NAMES)
def test_names_are_printed_and_not_obeyed(tmp_path, name):
    path = tmp_path / "hostile.yaml"
    path.write_text(FILE.format(name=quoted(name)), encoding="utf-8")
    for command, *options in COMMANDS:
        done = sfol(command, *options, path)
        printed = done.out + done.err
        assert "\x1b" not in printed
        assert "Traceback" not in printed
        if command in ("show", "explain", "test") and len(name) < 50:
            assert name in printed, (command, printed)


@pytest.mark.parametrize("character", ["\\e", "\\a", "\\x9b", "\\u202e", "\\0", "\\ud800"])
@pytest.mark.parametrize("place", ["name", "key"])
def test_control_characters_are_refused_with_their_place(tmp_path, character, place):
    path = tmp_path / "hostile.yaml"
    bad, plain = f'"a{character}b"', "plain"
    text = FILE.format(name=plain)
    old = "name: plain" if place == "name" else "rules: {plain"
    path.write_text(text.replace(old, old.replace(plain, bad), 1))
    done = sfol("check", path)
    assert done.code == 2
    assert "a text can't have the character" in done.err
    assert f"{path}:{2 if place == 'name' else 5}:" in done.err


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "utf-8"])
@pytest.mark.parametrize("arguments", [["--help"], ["show", "aeb"], ["check", "nowhere.yaml"]])
def test_a_console_that_lacks_a_character_shows_another(encoding, arguments):
    done = subprocess.run(
        [sys.executable, "-m", "sfol.cli", *arguments],
        capture_output=True,
        cwd=ROOT,
        check=False,
        env={"PYTHONIOENCODING": encoding, "PYTHONPATH": str(ROOT), "COLUMNS": "100"},
    )
    assert b"Traceback" not in done.stderr
    assert done.returncode == (2 if "check" in arguments else 0)
    (done.stdout + done.stderr).decode(encoding)
