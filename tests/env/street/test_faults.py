"""What goes wrong is said, and nothing is left behind."""

import contextlib
import copy
import gc
import pickle
from functools import partial

import gymnasium
import numpy as np
import psutil
import pybullet
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.wrappers import RecordVideo
from matplotlib import pyplot as plt

from env.learning.curriculum import StreetsInTurn
from env.street.crossing import OccludedCrossing
from env.street.observation import StateObserver
from env.world import window
from env.world.cells import Cell
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
    with pytest.raises(UsageError, match="does not start"):
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


@pytest.mark.parametrize("name", ["speed_limit", "control_hz", "max_seconds"])
@pytest.mark.parametrize("value", ["40", None, True, [1.0], 1j])
def test_what_is_no_number_is_none(name, value):
    with pytest.raises(UsageError, match=f"{name} can't be"):
        OccludedCrossing(**LIGHT, **{name: value})


@pytest.mark.parametrize("control_hz", [10.5, 0, -10, 0.5, np.nan, np.inf, 3.0])
def test_a_control_rate_divides_that_of_the_physics(control_hz):
    with pytest.raises(UsageError, match="control_hz can't be"):
        OccludedCrossing(**LIGHT, control_hz=control_hz)


@pytest.mark.parametrize("control_hz", [10.0, np.int64(10), np.float32(10.0)])
def test_ten_is_ten_in_whatever_form(street, control_hz):
    with OccludedCrossing(**LIGHT, control_hz=control_hz) as other:
        for one in (street, other):
            one.reset(seed=1)
        assert other.step(np.ones(1, np.float32))[-1] == street.step(np.ones(1, np.float32))[-1]


@pytest.mark.parametrize("seed", [-1, -(2**70), 1.5, "1", True, np.int64(-3)])
def test_a_seed_is_a_whole_number(street, seed):
    with pytest.raises(UsageError, match="seed can't be"):
        street.reset(seed=seed)


@pytest.mark.parametrize("seed", [0, 2**32, 10**30, np.int64(3), np.uint8(200)])
def test_seeds_may_be_large_and_numpy_s(street, seed):
    first, _ = street.reset(seed=seed)
    second, _ = street.reset(seed=int(seed))
    assert np.array_equal(first, second)


@pytest.mark.parametrize("view", ["third_person", "dash"])
def test_nothing_is_shown_before_an_episode_begins(view):
    with OccludedCrossing(**LIGHT, render_mode="rgb_array", render_view=view) as street:
        for look in (street.render, lambda: street.frame):
            with pytest.raises(ResetNeeded, match="call reset"):
                look()


def test_a_reset_that_fails_begins_no_episode(street, monkeypatch):
    street.reset(seed=1)

    def fail(*_):
        raise UsageError("nothing is seen")

    with monkeypatch.context() as patch:
        patch.setattr(type(street._perceive), "__call__", fail)
        with pytest.raises(UsageError, match="nothing is seen"):
            street.reset(seed=2)
    with pytest.raises(ResetNeeded):
        street.step(np.ones(1, np.float32))


def test_a_closed_street_says_so():
    street = OccludedCrossing(**LIGHT, render_mode="rgb_array")
    street.reset(seed=0)
    street.close()
    with pytest.raises(ResetNeeded):
        street.step(np.ones(1, np.float32))
    for use in (street.render, lambda: street.frame, lambda: street.reset(seed=0)):
        with pytest.raises(UsageError, match="the street is closed"):
            use()


COPIES = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    **{
        f"pickle {protocol}": partial(pickle.dumps, protocol=protocol)
        for protocol in range(pickle.HIGHEST_PROTOCOL + 1)
    },
}


@pytest.fixture(scope="module")
def several():
    cells = (Cell("low", "full"),)
    with contextlib.closing(StreetsInTurn(cells, StateObserver(), perception="truth")) as built:
        yield built


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
def test_a_street_can_t_be_copied(street, several, copied):
    for original in (street, street.world, several):
        with pytest.raises(UsageError, match="can't be copied or pickled"):
            copied(original)
    street.reset(seed=1)  # it is as it was


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


def test_a_street_that_nobody_closes_is_closed_when_it_is_dropped():
    gc.collect()
    before = clients()
    street = OccludedCrossing(**LIGHT)
    street.reset(seed=0)
    street.step(np.ones(1, np.float32))
    assert clients() == before + 1
    gc.disable()  # it is not left to chance
    try:
        del street
        assert clients() == before
    finally:
        gc.enable()


def test_a_street_that_can_t_be_built_leaves_nothing_behind(monkeypatch, tmp_path):
    monkeypatch.setenv("AEB_WEIGHTS", str(tmp_path))
    gc.collect()
    before = clients()
    with contextlib.suppress(UsageError):
        OccludedCrossing(traffic="low", perception="unet")
    gc.collect()
    assert clients() == before


def clients():
    """Return how many physics clients there are in this process."""
    return sum(pybullet.isConnected(client) for client in range(1000))


def test_two_windows_of_one_title_are_two(screen):
    picture = np.zeros((60, 80, 3), np.uint8)
    first, second = Window("test"), Window("test")
    first.show(picture)
    second.show(picture)
    assert len(plt.get_fignums()) == 2
    first.close()
    assert len(plt.get_fignums()) == 1
    del second
    assert plt.get_fignums() == []


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
