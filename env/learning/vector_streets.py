"""A setup's streets as PPO drives them: many at once, each in its own process."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import Any

import gymnasium
import numpy.typing as npt
import torch
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    SubprocVecEnv,
    VecEnv,
    VecFrameStack,
    VecMonitor,
)
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

import sfol
from env.driving.drivers import Driver
from env.driving.setup import Setup
from env.evaluation.parallel import start_method
from env.learning.curriculum import StreetsInTurn
from env.learning.new_model import codebook_of
from env.street.observation import observer_of
from env.street.seeds import TRAINING
from env.world.camera import DashCameraParameters
from env.world.cells import Cell
from sfol.cli.output import WarningLines
from sfol.errors import SfolError, SilentZeroWarning

_PATIENCE = 5.0  # s, with a process that has stopped answering


def make_streets(  # noqa: PLR0913 (as for an observer)
    setup: Setup,
    cells: Sequence[Cell],
    seed: int,
    *,
    seeds: range = TRAINING,
    count: int = 0,
    teacher: Driver | None = None,
) -> VecEnv:
    """Return a setup's streets, each in its own process.

    They are monitored, and neither observations nor rewards are normalised.

    The processes draw, perceive and describe for themselves, so that all processors are busy all
    the time; what they return is small.

    Args:
        setup: gives rules, perception, observation, fusion and the number of streets.
        cells: to draw from.
        seed: of the first street's draws; the others follow.
        seeds: to draw those of the episodes from.
        count: how many streets; the setup's number by default.
        teacher: says what it would do, see `env.learning.curriculum.StreetsInTurn`.

    Raises:
        SfolError: a street can't be made, or its process ended.
    """
    make: Callable[[], Any] = partial(_street, setup, tuple(cells), seeds, teacher)
    number = count or setup.streets
    streets: VecEnv = (
        DummyVecEnv([make])
        if number == 1
        else StreetProcesses([partial(_in_worker, make, n == 0) for n in range(number)])
    )
    if setup.frames > 1:
        streets = VecFrameStack(streets, setup.frames)
    streets = VecMonitor(streets)
    streets.seed(seed)
    return streets


def _street(
    setup: Setup, cells: tuple[Cell, ...], seeds: range, teacher: Driver | None
) -> StreetsInTurn:
    """Return what one process drives on."""
    observer = observer_of(
        setup.observation,
        DashCameraParameters().size,
        setup.fusion,
        codebook_of(setup),
        speed=setup.speed,
        unit_rms=setup.unit_rms,
    )
    return StreetsInTurn(
        cells,
        observer,
        decision_steps=setup.decision_steps,
        seeds=seeds,
        teacher=teacher,
        rules=sfol.KnowledgeBase.load(*setup.rules),
        perception=setup.perception,
    )


def _in_worker(make: Callable[[], StreetsInTurn], warns: bool) -> gymnasium.Env[Any, Any]:
    """Make a worker's streets, for one thread: there is a worker for each processor already.

    Of the rules, which are everybody's, one worker warns for all.
    """
    torch.set_num_threads(1)
    warnings.showwarning = WarningLines()
    if not warns:
        warnings.simplefilter("ignore", SilentZeroWarning)
    try:
        return make()
    except SfolError as error:
        return _NoStreet(error)


class _NoStreet(gymnasium.Env[Any, Any]):
    """What a worker has that could not make its streets: it is asked for their spaces first."""

    def __init__(self, error: SfolError) -> None:
        self.observation_space: Any = error
        self.action_space: Any = error


class StreetProcesses(SubprocVecEnv):
    """Streets in processes of their own; what goes wrong there is an error here.

    Args:
        makes: make the streets, each in its process.

    Raises:
        SfolError: a street can't be made, or its process ended; so do all methods.
    """

    def __init__(self, makes: list[Callable[[], gymnasium.Env[Any, Any]]]) -> None:
        with self._watched():
            super().__init__(makes, start_method=start_method())
        if isinstance(self.observation_space, SfolError):
            self.close()
            raise self.observation_space

    def reset(self) -> VecEnvObs:
        """Start an episode in every street."""
        with self._watched():
            return super().reset()

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Tell every street what to do."""
        with self._watched():
            super().step_async(actions)

    def step_wait(self) -> VecEnvStepReturn:
        """Return what came of it."""
        with self._watched():
            return super().step_wait()

    def env_method(self, method_name: str, *arguments: Any, **options: Any) -> list[Any]:
        """Call a method of the streets."""
        with self._watched():
            return super().env_method(method_name, *arguments, **options)

    def close(self) -> None:
        """End the processes, of which some may have ended; a second call does nothing."""
        if self.closed:
            return
        self.closed = True
        pairs = tuple(zip(self.processes, self.remotes, strict=True))
        for process, remote in pairs:
            if self.waiting:  # in the middle of a step; there is nothing that it could lose
                process.terminate()
            else:
                with suppress(OSError):
                    remote.send(("close", None))
        for process, remote in pairs:
            process.join()
            remote.close()

    @contextmanager
    def _watched(self) -> Iterator[None]:
        try:
            yield
        except (EOFError, ConnectionError):
            how = _first_end(self.processes)
            self.close()
            raise SfolError(
                f"a street's process {how}",
                suggestion="fewer streets at once need less memory; the same command goes on from "
                "the last checkpoint",
            ) from None


def _first_end(processes: Sequence[BaseProcess]) -> str:
    """Return how the first process that ended did so."""
    ended = wait([process.sentinel for process in processes], timeout=_PATIENCE)
    for process in processes:
        if process.sentinel in ended:
            process.join(_PATIENCE)  # what it held is closed a moment before it is gone
            code = process.exitcode or 0
            return f"was killed by signal {-code}" if code < 0 else f"ended with code {code}"
    return "does not answer"
