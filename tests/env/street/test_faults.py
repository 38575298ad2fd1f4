"""What goes wrong is said, and nothing is left behind."""

import gc

import gymnasium
import numpy as np
import psutil
import pybullet
import pytest
from gymnasium.wrappers import RecordVideo
from matplotlib import pyplot as plt

from env.street.crossing import OccludedCrossing
from env.world import window
from env.world.meshes import VehicleSize
from env.world.window import Window
from env.world.world import World
from sfol.errors import SfolError, UsageError

LIGHT = {"traffic": "low", "perception": "truth", "observation": "state"}


@pytest.fixture(scope="module")
def street():
    with OccludedCrossing(**LIGHT) as built:
        yield built


def failing(*_, **__):
    raise pybullet.error("no memory left")


@pytest.mark.parametrize("connect", [lambda *_: -1, failing], ids=["refused", "raises"])
def test_a_renderer_that_does_not_start_is_an_error(monkeypatch, connect):
    monkeypatch.setattr(pybullet, "connect", connect)
    with pytest.raises(UsageError, match="renderer does not start"):
        OccludedCrossing(**LIGHT)


def test_actions_out_of_range_are_clipped(street):
    ends = []
    for action in (1.0, 7.0):
        street.reset(seed=1)
        for _ in range(5):
            *_, info = street.step(np.array([action], np.float32))
        ends.append(info)
    assert ends[0] == ends[1]


@pytest.mark.parametrize("action", [[np.nan], [np.inf], [], [0.0, 0.0]])
def test_actions_that_are_no_number_are_errors_and_change_nothing(street, action):
    street.reset(seed=1)
    with pytest.raises(SfolError, match="one finite number"):
        street.step(np.array(action, np.float32))
    assert (street.ego.position, street.ego.speed) == (0.0, 0.0)


def test_an_unknown_level_is_named_with_the_one_that_was_meant():
    with pytest.raises(UsageError, match="did you mean 'medium'"):
        gymnasium.make("env:OccludedCrossing-v0", traffic="medum")


def test_weights_that_are_missing_are_named(monkeypatch, tmp_path):
    monkeypatch.setenv("AEB_WEIGHTS", str(tmp_path))
    with pytest.raises(UsageError, match="there are no weights"):
        OccludedCrossing(traffic="low", perception="unet")


@pytest.mark.parametrize("speed_limit", [0.0, -40.0, 1000.0, np.nan])
def test_a_speed_limit_is_that_of_a_street(speed_limit):
    with pytest.raises(UsageError, match="speed_limit can't be"):
        OccludedCrossing(**LIGHT, speed_limit=speed_limit)


def test_full_throttle_approaches_the_speed_limit():
    with OccludedCrossing(**LIGHT, speed_limit=20.0) as street:
        street.reset(seed=0)
        for _ in range(60):
            *_, ended, _, info = street.step(np.ones(1, np.float32))
            if ended:
                break
        assert 0.95 * 20 / 3.6 < info["speed"] < 20 / 3.6


def test_a_window_without_a_screen_is_an_error():
    with pytest.raises(UsageError, match="no screen"):
        OccludedCrossing(**LIGHT, render_mode="human")


@pytest.fixture
def screen(monkeypatch):
    """Make believe that what matplotlib draws on is a screen."""
    monkeypatch.setattr(window.plt, "get_backend", lambda: "TkAgg")
    yield
    plt.close("all")


def test_the_window_shows_every_step(screen, monkeypatch):
    shown = []
    monkeypatch.setattr(Window, "show", lambda self, picture: shown.append(picture))
    with OccludedCrossing(**LIGHT, render_mode="human", render_view="dash") as street:
        street.reset(seed=0)
        street.step(np.ones(1, np.float32))
        assert street.render() is None
        assert np.array_equal(shown[-1][..., 0], street.frame.gray)
    assert len(shown) == 2


def test_the_window_has_the_picture_s_pixels(screen):
    picture = np.random.default_rng(0).integers(0, 255, (60, 80, 3), np.uint8)
    opened = Window("test")
    opened.show(picture)
    (figure,) = map(plt.figure, plt.get_fignums())
    figure.canvas.draw()
    assert np.array_equal(np.asarray(figure.canvas.buffer_rgba())[..., :3], picture)
    opened.close()
    opened.close()
    assert plt.get_fignums() == []


@pytest.mark.parametrize(
    ("view", "shape"), [("third_person", (360, 480, 3)), ("dash", (224, 224, 3))]
)
def test_pictures_come_in_both_views(view, shape):
    with OccludedCrossing(**LIGHT, render_mode="rgb_array", render_view=view) as street:
        street.reset(seed=0)
        picture = street.render()
        assert picture.shape == shape
        assert picture.dtype == np.uint8
        assert picture.std() > 10.0


def test_a_film_is_recorded(tmp_path):
    street = OccludedCrossing(**LIGHT, render_mode="rgb_array", max_seconds=0.5)
    with RecordVideo(street, str(tmp_path)) as recorded:
        recorded.reset(seed=0)
        while not any(recorded.step(np.ones(1, np.float32))[2:4]):
            pass
    assert [path.suffix for path in tmp_path.iterdir()] == [".mp4"]


def test_closing_twice_is_closing_once():
    street = OccludedCrossing(**LIGHT)
    street.close()
    street.close()


def memory():
    """Return this process's resident memory, in MB."""
    return psutil.Process().memory_info().rss / 2**20


def growth(cycle, count):
    """Return by how much memory grows over so many cycles, after as many that warm up."""
    used = []
    for _ in range(2):
        for _ in range(count):
            cycle()
        gc.collect()
        used.append(memory())
    return used[1] - used[0]


def test_closed_streets_leave_no_memory_behind():
    def cycle():
        World(2, "partial", VehicleSize(4.2, 1.8, 1.45)).close()

    assert growth(cycle, 15) < 15  # MB; without sharing the meshes it is 60


@pytest.mark.long
def test_500_streets_leave_no_memory_behind():
    def cycle():
        with OccludedCrossing(**LIGHT) as street:
            street.reset(seed=0)

    assert growth(cycle, 250) < 25  # MB; without sharing the meshes it is 1600
