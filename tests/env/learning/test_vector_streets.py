"""Streets in processes: what goes wrong there is told here."""

import os
import signal
import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces

from env.learning.vector_streets import StreetProcesses, _in_worker
from sfol.errors import SfolError, UsageError, warn_of_silence


class Road(gymnasium.Env):
    """A street that ends itself when it is told to go fast enough."""

    observation_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        return np.zeros(1, np.float32), {}

    def step(self, action):
        if action[0] > 0.5:
            os.kill(os.getpid(), signal.SIGKILL)
        return np.zeros(1, np.float32), 0.0, False, False, {}


def no_road():
    raise UsageError("there is no road", name="road", suggestion="build one")


def make_road():
    return _in_worker(Road, warns=True)


def make_no_road():
    return _in_worker(no_road, warns=True)


def test_a_killed_process_is_an_error_and_no_hang():
    streets = StreetProcesses([make_road, make_road])
    streets.reset()
    streets.step(np.zeros((2, 1), np.float32))
    with pytest.raises(SfolError, match="process was killed by signal 9") as caught:
        streets.step(np.array([[0.0], [1.0]], np.float32))
    assert "the same command goes on" in str(caught.value)
    assert [process.is_alive() for process in streets.processes] == [False, False]
    streets.close()


def test_what_a_street_lacks_is_said_here():
    with pytest.raises(UsageError, match="there is no road") as caught:
        StreetProcesses([make_no_road])
    assert caught.value.suggestion == "build one"


def silent_road():
    warn_of_silence("no rule concludes anything")
    return Road()


@pytest.mark.parametrize(
    ("warns", "said"), [(True, "warning: no rule concludes anything\n"), (False, "")]
)
def test_one_worker_warns_for_all(monkeypatch, capsys, warns, said):
    monkeypatch.setattr(torch, "set_num_threads", lambda number: None)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)  # it is put back
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        _in_worker(silent_road, warns=warns)
    assert capsys.readouterr().err == said
