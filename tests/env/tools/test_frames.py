import json

import numpy as np
import pytest
from typer.testing import CliRunner

from env.cli import app
from env.street.seeds import FRAMES
from env.tools import frames as rendering
from env.tools.frames import STREETS_PER_FILE, frames_of_street
from sfol.errors import UsageError
from vsr.classes import SemanticClass
from vsr.training.frames import load_frames

SEED = FRAMES["test"].start


def render(*arguments):
    return CliRunner().invoke(app, ["frames", *(str(argument) for argument in arguments)])


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """One street of ten frames, each with its successor."""
    folder = tmp_path_factory.mktemp("frames")
    done = render("test", "--frames", 10, "--pairs", "--output", folder)
    assert done.exit_code == 0, done.output
    return folder


def test_a_street_is_the_same_whenever_it_is_rendered(street_of, rendered):
    street = street_of("low", "partial")
    saved = load_frames(rendered)
    street.reset(seed=1)  # what was before leaves no trace
    again = list(frames_of_street(street, SEED, count=2, pairs=True))
    assert [step for step, _ in again] == saved.steps[:4].tolist()
    for index, (_, frame) in enumerate(again):
        assert np.array_equal(frame.gray, saved.gray[index])
        assert np.array_equal(frame.classes, saved.classes[index])
        assert np.array_equal(frame.instances, saved.instances[index])


def test_frames_are_apart_and_each_has_its_successor(rendered):
    frames = load_frames(rendered)
    assert len(frames) == 20
    assert set(frames.streets.tolist()) == {SEED}
    chosen = frames.without_successors()
    assert 10 <= len(chosen) < 20
    first, second = frames.pairs()[0]
    change = np.mean(frames.classes[first] != frames.classes[second])
    later = np.mean(frames.classes[first] != frames.classes[-1])
    assert 0.0 < change < later


def test_other_seeds_are_other_streets(street_of, rendered):
    (_, frame), *_ = frames_of_street(street_of("low", "partial"), SEED + 6, count=1)
    assert not np.array_equal(frame.gray, load_frames(rendered).gray[0])


def test_frames_show_what_is_to_be_learnt(street_of):
    street = street_of("high", "full")
    seen = [frame for seed in (4, 10) for _, frame in frames_of_street(street, seed, count=8)]
    shown = np.unique(np.stack([frame.classes for frame in seen]))
    wanted = {SemanticClass.PEDESTRIAN, SemanticClass.TRUCK, SemanticClass.CROSSWALK}
    assert wanted <= set(shown.tolist())
    assert all(
        street.world.classes[frame.instances].tolist() == frame.classes.tolist()
        for frame in seen[:2]
    )


def test_the_card_says_where_the_frames_come_from(rendered):
    card = json.loads((rendered / "frames.json").read_text())
    assert card["renderer"] == "street rasteriser"
    assert card["camera"] == {"size": 224, "fov": 50.0, "height": 1.5}
    assert card["seeds"] == [SEED, SEED]
    assert card["command"] == "aeb frames test --frames 10 --pairs"


def test_what_is_there_is_kept_and_what_is_damaged_is_rendered_again(rendered, monkeypatch):
    (file,) = rendered.glob("*.npz")
    content = file.read_bytes()
    with monkeypatch.context() as patched:
        patched.setattr(rendering, "frames_of_street", lambda *_: pytest.fail("rendered again"))
        assert render("test", "--frames", 10, "--pairs", "--output", rendered).exit_code == 0
    file.write_bytes(content[: len(content) // 2])
    assert render("test", "--frames", 10, "--pairs", "--output", rendered).exit_code == 0
    assert len(load_frames(rendered)) == 20


def test_frames_of_other_settings_are_not_mixed_in(rendered):
    refused = render("train", "--frames", 10, "--output", rendered)
    assert isinstance(refused.exception, UsageError)
    assert "other frames" in str(refused.exception)


def test_a_file_has_as_many_streets_of_every_cell():
    assert STREETS_PER_FILE % 6 == 0


def test_a_set_that_does_not_exist_is_an_error(tmp_path):
    refused = render("tests", "--output", tmp_path / "new")
    assert isinstance(refused.exception, UsageError)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("frames", [-5, 0, 10**9])
def test_there_are_only_so_many_frames(tmp_path, frames):
    """More would be of the next set's streets."""
    done = render("test", "--frames", frames, "--output", tmp_path / "frames")
    assert done.exit_code == 2 or isinstance(done.exception, UsageError)
    assert not (tmp_path / "frames").exists()
