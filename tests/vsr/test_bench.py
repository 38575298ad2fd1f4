"""The benchmark reports every stage, of the scene that it promises. No time is asserted."""

import json

import numpy as np

import sfol.tools.bench
from vsr import bench
from vsr.classes import DYNAMIC_CLASSES
from vsr.entities import find_entities
from vsr.hypervectors.codebook import GRID


def test_every_stage_is_reported_and_torchhd_gives_the_same_vector(monkeypatch):
    monkeypatch.setattr(sfol.tools.bench, "_SECONDS", 0.0)
    figures = bench.measure()
    assert figures["entities"] == 12
    stages = {"entities_and_facts", "layout", "vsr_ssi_unscaled", "vsr_ssi", "vsr_add", "torchhd"}
    assert stages == {name.removesuffix("_ms") for name in figures if name.endswith("_ms")}
    assert all(value > 0 for value in figures.values())
    assert figures["torchhd_difference"] < 1e-5


def test_without_torchhd_the_rest_is_measured(monkeypatch):
    monkeypatch.setattr(sfol.tools.bench, "_SECONDS", 0.0)
    monkeypatch.setattr(bench, "find_spec", lambda name: None)
    assert not any("torchhd" in name for name in bench.measure())


def test_the_scene_has_twelve_entities_three_neighbours_and_twenty_cells():
    layout = bench.layout()
    assert layout.coverage.shape == (12, GRID, GRID)
    assert (layout.neighbours.sum(axis=(1, 2)) == 3).all()
    assert (np.count_nonzero(layout.coverage, axis=(1, 2)) == 20).all()


def test_the_street_has_twelve_entities_and_a_crosswalk():
    found = find_entities(np.eye(28, dtype=np.float32)[bench.street()].transpose(2, 0, 1))
    assert sum(entity.kind in DYNAMIC_CLASSES for entity in found) == bench.ENTITIES == 12
    assert len(found) == 13


def test_the_command_prints_descriptor_and_networks(monkeypatch, capsys):
    monkeypatch.setattr(bench, "measure", lambda: {"vsr_ssi_ms": 0.3})
    monkeypatch.setattr(
        bench.network_speed, "measure", lambda frames: {"unet_ms": float(frames[0].gray.size)}
    )
    bench.main()
    assert json.loads(capsys.readouterr().out) == {
        "descriptor": {"vsr_ssi_ms": 0.3},
        "networks": {"unet_ms": 224.0 * 224.0},
    }
