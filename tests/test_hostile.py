"""What a stranger might hand over, tried end to end: nothing is run, and nothing written elsewhere.

Each test lists all that there is below its folder, before and after, and a trap tells whether code
of the stranger's has run.
"""

import base64
import json
import pickle
import subprocess
import zipfile
from pathlib import Path

import pytest

from tests.sfol.command_line import RULES, sfol

KITCHEN = (RULES / "cartpole.yaml").read_text()


class Trap:
    """Makes a file when it is unpickled."""

    def __init__(self, file):
        self.file = file

    def __reduce__(self):
        return Path.touch, (self.file,)


def listed(folder):
    """Return every path below a folder with what stands there."""
    return {
        path.relative_to(folder): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


@pytest.fixture
def place(tmp_path):
    """A folder of a user's, with something to lose beside it."""
    (tmp_path / "precious.txt").write_text("kept")
    (tmp_path / "home").mkdir()
    return tmp_path / "home"


@pytest.fixture
def aeb(monkeypatch):
    pytest.importorskip("pybullet")
    from typer.testing import CliRunner  # noqa: PLC0415

    from env.cli import app  # noqa: PLC0415

    return lambda *words: CliRunner().invoke(app, [str(word) for word in words])


HOSTILE_YAML = [
    "!!python/object/apply:os.system ['touch {sprung}']",
    "!!python/object/new:subprocess.Popen [['touch', '{sprung}']]",
    "&a [*a, *a, *a]",
    "__import__('pathlib').Path('{sprung}').touch()",
    "(lambda: open('{sprung}', 'w'))()",
    "../../precious",
    "{sprung}",
]
COMMANDS = ("check", "show", "explain", "lint", "test", "graph", "fmt", "schema", "diff")


@pytest.mark.parametrize("value", HOSTILE_YAML)
@pytest.mark.parametrize(
    "key",
    ["name", "extends", "background", "rules", "terms", "weights", "signals", "tests", "formula"],
)
def test_a_knowledge_base(place, key, value):
    sprung = place / "sprung"
    hostile = value.replace("{sprung}", str(sprung))
    text = "\n".join(line for line in KITCHEN.splitlines() if not line.startswith(f"{key}:"))
    if key == "formula":
        text = KITCHEN.replace("formula:", f"formula: {json.dumps(hostile)} #")
    else:
        text += f"\n{key}: {hostile}\n"
    (place / "x.yaml").write_text(text)
    before = listed(place.parent)
    for command in COMMANDS:
        arguments = [place / "x.yaml"] if command != "schema" else []
        sfol(command, *arguments, *(["--check"] if command == "fmt" else []))
    assert listed(place.parent) == before
    assert not sprung.exists()


def test_a_repository(place):
    """Its configuration and hooks would run programs, if git were let."""
    sprung = place / "sprung"

    def git(*words):
        subprocess.run(["git", "-c", "user.name=x", "-c", "user.email=x@y", *words], cwd=place,
                       check=True, capture_output=True)  # fmt: skip

    (place / "x.yaml").write_text(KITCHEN)
    (place / ".gitattributes").write_text("*.yaml filter=evil diff=evil\n")
    git("init")
    git("add", ".")
    git("commit", "-m", "first")
    for name in ("post-checkout", "pre-commit", "fsmonitor-watchman"):
        hook = place / ".git" / "hooks" / name
        hook.write_text(f"#!/bin/sh\ntouch {sprung}\n")
        hook.chmod(0o755)
    for key, program in (
        ("filter.evil.smudge", f"touch {sprung}"),
        ("filter.evil.clean", f"touch {sprung}"),
        ("diff.evil.textconv", f"touch {sprung}"),
        ("diff.evil.command", f"touch {sprung}"),
        ("core.fsmonitor", str(place / ".git/hooks/fsmonitor-watchman")),
        ("core.pager", f"touch {sprung}"),
        ("core.sshCommand", f"touch {sprung}"),
    ):
        git("config", key, program)
    sprung.unlink(missing_ok=True)
    (place / "x.yaml").write_text(KITCHEN.replace("version: 1", "version: 1 # changed"))
    before = listed(place.parent)
    done = sfol("diff", place / "x.yaml")
    assert (done.code, done.err) == (0, "")
    assert not sprung.exists()
    assert listed(place.parent) == before


def test_a_log(place):
    pytest.importorskip("pyarrow")
    sprung = place / "sprung"
    contents = [pickle.dumps(Trap(sprung)), b"PAR1" + pickle.dumps(Trap(sprung)) + b"PAR1", b""]
    for content in contents:
        (place / "x.parquet").write_bytes(content)
        before = listed(place.parent)
        for words in (
            ["replay"],
            ["lint", "cartpole", "--log"],
            ["diff", "cartpole", "aeb", "--log"],
        ):
            assert sfol(*words, place / "x.parquet").code == 2
        assert listed(place.parent) == before
    assert not sprung.exists()


def trap(sprung):
    """Return bytes that run code if they are unpickled, and a .zip as stable-baselines3 makes."""
    code = pickle.dumps(Trap(sprung))
    archive = sprung.with_name("trap.zip")
    with zipfile.ZipFile(archive, "w") as made:
        serialised = {":serialized:": base64.b64encode(code).decode()}
        made.writestr("data", json.dumps({"policy_class": serialised}))
    packed = archive.read_bytes()
    archive.unlink()
    return code, packed


def test_a_policy(place, aeb):
    sprung = place / "sprung"
    code, packed = trap(sprung)
    for name, content in (("p.zip", packed), ("p.safetensors", code), ("p.safetensors", packed)):
        (place / name).write_bytes(content)
        (place / "p.json").write_text("{}")
        before = listed(place.parent)
        done = aeb("evaluate", "--driver", place / name, "--episodes", 1, "--output", place / "out")
        assert done.exit_code != 0
        assert {k: v for k, v in listed(place.parent).items() if "out" not in k.parts} == before
    assert not sprung.exists()


def test_a_folder_of_a_training(place, aeb):
    sprung = place / "sprung"
    code, packed = trap(sprung)
    run = place / "run"
    run.mkdir()
    for name, content in (
        ("checkpoint-000000016.zip", packed),
        ("checkpoint-000000016.safetensors", code),
        ("policy.zip", packed),
        ("setup.json", code),
        ("evaluations.jsonl", code),
        ("progress.jsonl", packed),
    ):
        (run / name).write_bytes(content)
    before = listed(place.parent)
    done = aeb("train", "--setup", "state", "--output", run)
    assert done.exit_code != 0
    assert listed(place.parent) == before
    assert not sprung.exists()


def test_a_folder_of_results(place, aeb):
    sprung = place / "sprung"
    code, _ = trap(sprung)
    hostile = {"driver": "../../../precious", "cell": "<script>", "settings": {"name": "=cmd()"}}
    for name in ("drives/x/low-full", "training/x", "trajectories/x"):
        for content in (code, json.dumps(hostile).encode(), b"[" * 100_000):
            file = place / "study" / f"{name}.json"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
            before = listed(place.parent)
            done = aeb("figures", "--study", place / "study", "--drivers", place / "none",
                       "--output", place / "out")  # fmt: skip
            assert done.exit_code != 0
            after = {k: v for k, v in listed(place.parent).items() if "out" not in k.parts}
            assert after == before
            file.unlink()
    assert not sprung.exists()
