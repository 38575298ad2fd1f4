"""The street's benchmark reports every stage. No time is asserted."""

import json

from typer.testing import CliRunner

import env.tools.bench
import sfol.tools.bench
from env.cli import app


def test_every_stage_is_reported(monkeypatch):
    monkeypatch.setattr(sfol.tools.bench, "_SECONDS", 0.0)
    monkeypatch.setattr(env.tools.bench, "_FRAMES", 1)
    monkeypatch.setattr(env.tools.bench, "_STRETCH", 5)
    done = CliRunner().invoke(app, ["bench"])
    assert done.exit_code == 0, done.output
    figures = json.loads(done.stdout)
    stages = {
        "tiny_renderer",
        "camera",
        "perception",
        "reward",
        "descriptor_ssi",
        "step",
    }
    assert stages == {name.removesuffix("_ms") for name in figures if name.endswith("_ms")}
    others = {"entities_in_view", "step_over_tiny_renderer"}
    for source in ("simulator", "unet"):
        others |= {f"training_steps_per_second_{source}", f"worker_mb_{source}"}
    others |= {f"truth_steps_per_second_{traffic}" for traffic in ("low", "high")}
    assert others == {name for name in figures if not name.endswith("_ms")}
    assert all(value > 0 for value in figures.values())
