"""Every id: its cell, both checkers, the same episode in another process, many at once."""

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from stable_baselines3.common.env_checker import check_env as sb3_check_env
from stable_baselines3.common.vec_env import SubprocVecEnv

from env import CELLS, IDS
from tests.env import rollout

LIGHT = {"perception": "truth", "observation": "state"}
STILL = np.zeros((2, 1), np.float32)
# What Gymnasium and stable-baselines3 raise when a worker is gone.
GONE = (BrokenPipeError, EOFError, ConnectionResetError)

make_light = partial(gymnasium.make, "env:OccludedCrossing-Low-Partial-v0", **LIGHT)


@pytest.fixture(scope="module", params=IDS)
def made(request):
    streets = []

    def build(**arguments):
        streets.append(gymnasium.make(f"env:{request.param}", **arguments))
        return streets[-1]

    build.id = request.param
    yield build
    for street in streets:
        street.close()


def test_a_street_without_networks_imports_no_torch():
    code = (
        "import sys, gymnasium; gymnasium.make('env:OccludedCrossing-v0', traffic='low');"
        "print('torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == "False"


def test_there_is_an_id_for_every_cell():
    assert len(IDS) == 7
    assert CELLS["OccludedCrossing-High-Full-v0"] == {"traffic": "high", "occlusion": "full"}
    assert {tuple(cell.values()) for cell in CELLS.values()} == {
        (traffic, occlusion)
        for traffic in ("low", "medium", "high")
        for occlusion in ("partial", "full")
    }


@pytest.mark.filterwarnings("error:.*:UserWarning:gymnasium")
@pytest.mark.filterwarnings("error:.*:UserWarning:stable_baselines3")
@pytest.mark.parametrize("observation", ["state", "image"])
def test_both_checkers_find_no_fault(made, observation):
    street = made(perception="truth", observation=observation).unwrapped
    for name, value in CELLS.get(made.id, {}).items():
        assert getattr(street, name) == value
    check_env(street, skip_render_check=True, skip_close_check=True)
    sb3_check_env(street, warn=True, skip_render_check=True)


def test_a_seed_decides_everything_in_every_process(street_of):
    default = street_of("medium", "full")
    streets = {name: street_of(**CELLS[name]) if name in CELLS else default for name in IDS}
    digests = {name: rollout.digest(street, seed=3) for name, street in streets.items()}
    assert len({*digests.values()}) == len(CELLS)
    assert rollout.digest(default, seed=4) not in digests.values()
    elsewhere = subprocess.run(
        [sys.executable, "-m", "tests.env.rollout"],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[2],
    )
    lines = (line.split() for line in elsewhere.stdout.splitlines())
    assert {name: digest for name, digest in lines if name in IDS} == digests


def alone(seed, steps):
    with make_light() as street:
        yield street.reset(seed=seed)[0]
        for _ in range(steps):
            yield street.step(STILL[0])[0]


def close(streets):
    """Close what can still be closed; both libraries stumble over a worker that is gone."""
    for process in streets.processes:
        process.kill()
        process.join()
    streets.closed = True


VECTORS = {
    "sync": SyncVectorEnv,
    "async, forked": partial(AsyncVectorEnv, context="fork"),
    "async, spawned": partial(AsyncVectorEnv, context="spawn"),
}


@pytest.mark.parametrize("build", VECTORS.values(), ids=VECTORS)
def test_gymnasium_s_vectors_drive_the_same_episodes(build):
    streets = build([make_light] * 2)
    seen = [streets.reset(seed=5)[0], *(streets.step(STILL)[0] for _ in range(3))]
    streets.close()
    for number, seed in enumerate((5, 6)):
        for together, single in zip(seen, alone(seed, 3), strict=True):
            assert np.array_equal(together[number], single)


@pytest.mark.parametrize("context", ["fork", "spawn"])
def test_stable_baselines3_s_workers_drive_the_same_episodes(context):
    streets = SubprocVecEnv([make_light] * 2, start_method=context)
    streets.seed(5)
    seen = [streets.reset(), *(streets.step(STILL)[0] for _ in range(3))]
    streets.close()
    for number, seed in enumerate((5, 6)):
        for together, single in zip(seen, alone(seed, 3), strict=True):
            assert np.array_equal(together[number], single)


@pytest.mark.parametrize("library", ["gymnasium", "stable_baselines3"])
@pytest.mark.parametrize("killed", ["between steps", "in a step"])
def test_a_killed_worker_is_an_error_and_not_a_wait_for_ever(library, killed):
    streets = (
        AsyncVectorEnv([make_light] * 2, context="fork")
        if library == "gymnasium"
        else SubprocVecEnv([make_light] * 2, start_method="fork")
    )
    streets.reset()
    worker = streets.processes[0]
    if killed == "in a step":
        os.kill(worker.pid, signal.SIGSTOP)
        streets.step_async(STILL)
        worker.kill()
    else:
        worker.kill()
        worker.join()
    with pytest.raises(GONE):
        streets.step_wait() if killed == "in a step" else streets.step(STILL)
    close(streets)
