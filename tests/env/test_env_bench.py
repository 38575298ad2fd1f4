"""The street's benchmark reports every stage. No time is asserted."""

import json

from typer.testing import CliRunner

import sfol.bench
from env.cli import app


def test_every_stage_is_reported(monkeypatch):
    monkeypatch.setattr(sfol.bench, "_SECONDS", 0.0)
    done = CliRunner().invoke(app, ["bench"])
    assert done.exit_code == 0, done.output
    figures = json.loads(done.stdout)
    stages = {"camera", "segmenter", "entities_and_facts", "reward", "descriptor_ssi", "step"}
    assert stages == {name.removesuffix("_ms") for name in figures if name.endswith("_ms")}
    assert all(value > 0 for value in figures.values())
