"""Whatever a command can't read or write: exit code 2, a line for each error, no traceback."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from sfol import Facts
from sfol.logs import LogWriter
from tests.sfol.command_line import ROOT, sfol

COMMANDS = [
    *(
        ["check"],
        ["test"],
        ["show"],
        ["lint"],
        ["fmt"],
        ["fmt", "--check"],
        ["migrate"],
        ["graph"],
        ["explain"],
    ),
    *(["bench"], ["diff"], ["diff", "aeb"], ["replay"], ["lint", "aeb", "--log"]),
    *(["diff", "aeb", "aeb", "--log"], ["explain", "aeb", "--facts"]),
]


@pytest.fixture
def folder(tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    (tmp_path / "loop.yaml").symlink_to(tmp_path / "loop.yaml")
    (tmp_path / "dangling.yaml").symlink_to(tmp_path / "nowhere")
    (tmp_path / "folder.yaml").mkdir()
    (tmp_path / "latin.yaml").write_bytes(b"name: \xff")
    (tmp_path / "long.yaml").write_bytes(b"#" * 1_000_001)
    (tmp_path / "empty.yaml").write_bytes(b"")
    return tmp_path


FEW = ["pipe.yaml", "loop.yaml", "latin.yaml", "x" * 5000]
MORE = ["dangling.yaml", "folder.yaml", "long.yaml", "empty.yaml", "none.yaml", "latin.yaml/x.yaml",
        "loop.yaml/x.yaml", "x" * 5000 + ".yaml", "/dev/zero", "nowhere", ""]  # fmt: skip
CASES = [(name, command) for command in COMMANDS for name in FEW]
CASES += [(name, command) for command in (["check"], ["replay"]) for name in MORE]


@pytest.mark.parametrize(("name", "command"), CASES, ids=lambda part: " ".join(part)[:12])
def test_what_can_not_be_read(folder, monkeypatch, name, command):
    monkeypatch.chdir(folder)
    done = sfol(*command, f"@{name}" if command[-1] == "--facts" else name)
    assert done.code == 2
    assert done.err
    assert all("error: " in line for line in done.err.splitlines()), done.err


@pytest.mark.parametrize(
    "name",
    ["folder.yaml", "empty.yaml/x.yaml", "x" * 5000 + ".yaml"],
    ids=lambda name: name[:12],
)
def test_what_can_not_be_written(folder, monkeypatch, name):
    monkeypatch.chdir(folder)
    before = sorted(os.listdir())
    done = sfol("init", "--force", name)
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert sorted(os.listdir()) == before


def test_a_picture_that_can_not_be_written(folder, kitchen):
    kb = kitchen()
    with LogWriter(folder / "x.parquet", kb) as log:
        log.step(Facts(), 0.0, speed=1.0)
    (folder / "picture.png").mkdir()
    done = sfol(
        "replay", folder / "x.parquet", folder / "kitchen.yaml", "--plot", folder / "picture.png"
    )
    assert done.code == 2
    assert "can't be written" in done.err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is full")
@pytest.mark.parametrize("arguments", [["show", "aeb"], ["graph", "aeb"], ["--help"]])
def test_a_full_output_is_told(arguments):
    command = [sys.executable, "-m", "sfol.cli", *arguments]
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, text=True, cwd=ROOT, check=False
        )
    assert done.returncode == 2
    assert done.stderr == "error: the output can't be read or written: No space left on device\n"


def test_a_reader_who_has_read_enough_is_no_error():
    command = [sys.executable, "-m", "sfol.cli", "show", "aeb", "--yaml"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT
    ) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 1
