"""`aeb renderers` compares what both renderers draw of the same moments. No time is asserted."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from env.cli import app
from env.street.seeds import FRAMES
from env.tools import renderers
from env.tools.frames import frame_set
from env.tools.renderers import likeness, quality, side_by_side
from sfol.errors import UsageError
from vsr.classes import SemanticClass

SEEDS = FRAMES["test"][:1]


@pytest.fixture(scope="module")
def both():
    return [frame_set(SEEDS, pairs=True, renderer=renderer) for renderer in ("street", "tiny")]


def test_the_same_moments_are_drawn_by_both(both):
    street, tiny = both
    assert [some.card["renderer"] for some in both] == [
        "street rasteriser",
        "pybullet TinyRenderer",
    ]
    assert np.array_equal(street.steps, tiny.steps)
    assert len(street) == 20
    assert likeness(street, tiny)["all"].same > 0.999


def test_likeness_counts_pixels(both):
    _, tiny = both
    alike = likeness(tiny, tiny)
    assert all(row[1:] == (1.0, 1.0, 1.0, 1.0, 0.0) for row in alike.values())
    assert sum(row.share for name, row in alike.items() if name != "all") == pytest.approx(1.0)

    classes, gray = tiny.classes.copy(), tiny.gray.copy()
    rows = np.flatnonzero(classes.ravel() == SemanticClass.ROAD)
    half = rows[: len(rows) // 2]
    classes.ravel()[half] = SemanticClass.SIDEWALK
    gray.ravel()[rows[-100:]] = np.where(gray.ravel()[rows[-100:]] > 127, 0, 255)
    road = likeness(replace(tiny, classes=classes, gray=gray), tiny)["road"]
    kept = len(rows) - len(half)
    assert road.same == road.iou == pytest.approx(kept / len(rows))
    assert road.equal == road.close == pytest.approx(1 - 100 / kept)
    assert road.difference >= 100 * 127 / kept


def test_the_picture_shows_both_and_where_they_differ(both):
    street, tiny = both
    picture = np.asarray(side_by_side(street, tiny))
    assert picture.shape == (4 * 224, 3 * 224)
    assert np.array_equal(picture[:224, :224], tiny.gray[0])
    assert np.array_equal(picture[:224, 224:448], street.gray[0])
    same = street.gray[0] == tiny.gray[0]
    assert np.array_equal(picture[:224, 448:] == 255, same)


def test_the_networks_see_as_well_on_either_renderer_s_frames(both):
    street, tiny = map(quality, both)
    for name, before in tiny.items():
        if not np.isnan(before):
            assert street[name] == pytest.approx(before, abs=0.2 if "dB" in name else 0.02), name
    assert street["IoU, road"] > 0.9


def test_the_command_prints_tables_and_saves_the_picture(monkeypatch, tmp_path):
    monkeypatch.setattr(renderers, "_SAMPLES", 1)
    file = tmp_path / "renderers.png"
    done = CliRunner().invoke(app, ["renderers", "--frames", "1", "--picture", str(file)])
    assert done.exit_code == 0, done.output
    assert "20 frames" in done.output
    for word in ("pedestrian", "street rasteriser", "medium"):
        assert word in done.output
    with Image.open(file) as picture:
        assert picture.size == (3 * 224, 4 * 224)


@pytest.mark.parametrize("frames", [0, 10**9])
def test_there_are_only_so_many_frames(frames, tmp_path):
    done = CliRunner().invoke(app, ["renderers", "--frames", str(frames)])
    assert done.exit_code == 2 or isinstance(done.exception, UsageError)
