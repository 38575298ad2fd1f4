"""What a file says reaches the terminal as it stands: no markup, no commands to the terminal."""

import io
import subprocess
import sys

import pytest

from sfol.cli import main
from sfol.cli.app import app
from sfol.cli.output import print_errors
from sfol.errors import Place, SfolError
from sfol.tools.texts import visible
from tests.sfol.command_line import ROOT, sfol

commands = [command.name or command.callback.__name__ for command in app.registered_commands]
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
    ":smile:",
    "a [bold",
    "x] [/",
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
    *(
        ["check"],
        ["test"],
        ["show"],
        ["lint"],
        ["fmt", "--check"],
        ["migrate", "--check"],
        ["graph"],
        ["diff", "aeb"],
    ),
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


FILES = [
    "[bold].yaml",
    "[/].yaml",
    "a [red",
    "x\x1b[31m.yaml",
    "two\nlines.yaml",
    "\u202edoc.yaml",
    ":smile:.yaml",
    "\udcff.yaml",
]


@pytest.mark.parametrize("name", FILES)
def test_names_of_files_are_printed_and_not_obeyed(tmp_path, name):
    (tmp_path / name).mkdir(parents=True)
    valid, broken = tmp_path / name / "valid.yaml", tmp_path / name / "broken.yaml"
    valid.write_text(FILE.format(name="plain"))
    broken.write_text("name: x")
    shown = visible(tmp_path / name)
    for command, *options in [
        *COMMANDS,
        ["replay"],
        ["lint", "aeb", "--log"],
        ["explain", "aeb", "--facts"],
    ]:
        for path in (valid, broken, tmp_path / name):
            done = sfol(command, *options, f"@{path}" if options[-1:] == ["--facts"] else path)
            assert all(c.isprintable() or c == "\n" for c in done.err + done.out), command
            assert done.code in (0, 1, 2)
            if command in ("check", "test", "lint") or done.code == 2:
                assert shown in done.out + done.err, (command, done)
            if done.code == 2:
                assert all("error: " in line for line in done.err.splitlines())


def test_a_message_and_its_hint_make_no_markup_together(capsys):
    print_errors(SfolError("an [bold", suggestion="b] [/", place=Place("x [red")))
    assert capsys.readouterr().err == "x [red: error: an [bold — b] [/\n"


@pytest.mark.parametrize("command", [[], *([name] for name in commands)])
@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_help_can_be_shown_on_every_console(monkeypatch, encoding, command):
    out = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "argv", ["sfol", *command, "--help"])
    with pytest.raises(SystemExit) as end:
        main()
    out.flush()
    assert end.value.code == 0
    assert "Usage" in out.buffer.getvalue().decode(encoding)


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
@pytest.mark.parametrize(
    "arguments",
    [["show", "--yaml"], ["graph"], ["graph", "--format", "svg"], ["diff", "aeb", "--json"]],
)
def test_what_is_written_into_a_file_is_utf_8_on_every_console(
    tmp_path, monkeypatch, encoding, arguments
):
    path = tmp_path / "x.yaml"
    path.write_text(FILE.format(name="é→🙂"), encoding="utf-8")
    out = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "argv", ["sfol", *arguments, str(path)])
    with pytest.raises(SystemExit):
        main()
    out.flush()
    text = out.buffer.getvalue().decode("utf-8")
    assert "é" in text
    assert "?" not in text


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
