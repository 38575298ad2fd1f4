"""Training: PPO of stable-baselines3 on a setup's streets, in a folder from which it can go on."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from stable_baselines3.common.logger import configure
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecEnv

import sfol
from env.driving.policies import file_hash
from env.driving.policy_files import PolicyCard, PolicyFile
from env.driving.setup import Setup
from env.evaluation.parallel import cores
from env.evaluation.results import versions
from env.learning.callbacks import (
    BetweenUpdates,
    Curriculum,
    Episodes,
    LessNoise,
    Progress,
    ProgressReport,
    RewardParts,
)
from env.learning.journal import Clock, History, Row
from env.learning.new_model import DEVICE, codebook_of, new_model, start_of
from env.learning.vector_streets import make_streets
from env.street.seeds import EVALUATION
from env.world.cells import Cell
from sfol.errors import UsageError
from sfol.writing import replacing

log = logging.getLogger(__name__)

# Of what streets draw: cells, and the seeds of their episodes.
_TRAINING_DRAWS = 1_000_000_000
_EVALUATION_DRAWS = 2_000_000_000
_KEPT_CHECKPOINTS = 3


@dataclass(frozen=True)
class Trained:
    """What came of a training.

    Attributes:
        policy: the file of the best policy, by success and then return in the evaluations.
        steps: of all streets together.
        seconds: that it took.
        evaluations: what each evaluation found, in order, with ``steps`` and ``seconds``.
        episodes: those of the training itself, in order.
    """

    policy: Path
    steps: int
    seconds: float
    evaluations: tuple[Row, ...]
    episodes: tuple[Row, ...]


def train(setup: Setup, folder: Path, *, progress: Progress = lambda steps, stage: None) -> Trained:
    """Train a setup, or go on with its training.

    Args:
        setup: what is trained.
        folder: for checkpoints, tensorboard's files, evaluations and the policy. A training that
            was stopped goes on from the last checkpoint that can be read.
        progress: called with the steps done, and with the present traffic and the share of
            successes among the last episodes.

    Raises:
        UsageError: the folder holds the training of another setup, or the policy to start from
            can't be used.
    """
    start_of(setup)  # refused before anything is written
    folder.mkdir(parents=True, exist_ok=True)
    _claim(folder, setup)
    evaluations = History(folder / "evaluations.jsonl").rows()
    if evaluations and evaluations[-1]["steps"] >= setup.steps:
        steps = evaluations[-1]["steps"]
        return _Record(setup, folder, steps).trained(steps)
    with _threads_for(setup):
        return _train(setup, folder, progress)


def _train(setup: Setup, folder: Path, progress: Progress) -> Trained:
    set_random_seed(setup.seed)
    streets = make_streets(setup, setup.stages[0].cells, _TRAINING_DRAWS)
    try:
        model = _last_model(streets, folder)
        done = model.num_timesteps if model else 0
        if done < setup.steps:
            # All at once: later, the others would wait whenever one builds, for seconds each time.
            progress(done, "building streets")
            streets.env_method("build")
        if model is None:
            model = new_model(setup, streets, progress)
        # The model has given the streets its own seed; and a training that goes on meets new ones.
        streets.seed(_TRAINING_DRAWS + 1_000_000 * setup.seed + model.num_timesteps)
        record = _Record(setup, folder, model.num_timesteps)
        model.set_logger(configure(str(folder), ["tensorboard"]))
        callbacks: list[BaseCallback] = [
            Curriculum(setup),
            LessNoise(setup),
            RewardParts(),
            Episodes(record.episode),
            BetweenUpdates(setup.checkpoint_steps, partial(_checkpoint, folder)),
            BetweenUpdates(setup.evaluation_steps, record.evaluate),
            ProgressReport(setup, progress),
        ]
        if setup.start and not record.evaluated:
            record.evaluate(model)  # nothing worse than it started from is to come of a training
        if model.num_timesteps < setup.steps:
            model.learn(
                setup.steps - model.num_timesteps,
                callback=CallbackList(callbacks),
                reset_num_timesteps=False,
            )
            _checkpoint(folder, model)
        record.evaluate(model)
    finally:
        streets.close()
    return record.trained(model.num_timesteps)


@contextmanager
def _threads_for(setup: Setup) -> Iterator[None]:
    """Let torch use one thread where others drive, since only small networks are run here then.

    On two cores, with the workers that drive, more threads halved the pace.
    """
    threads = torch.get_num_threads()
    if setup.streets > 1:
        torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


# -- checkpoints ----------------------------------------------------------------------------------


def _claim(folder: Path, setup: Setup) -> None:
    """Write down whose folder it is, or make sure that it is this setup's."""
    file, text = folder / "setup.json", setup.model_dump_json(indent=2)
    if not file.exists():
        with replacing(file) as part:
            part.write_text(text, encoding="utf-8")
    elif json.loads(file.read_text(encoding="utf-8")) != json.loads(text):
        raise UsageError(
            f"'{folder}' holds the training of another setup",
            name=str(folder),
            suggestion=f"another --output, or the setup in {file}",
        )


def _last_model(streets: VecEnv, folder: Path) -> PPO | None:
    """Return the model of the last checkpoint that can be read; None where there is none."""
    for path in sorted(folder.glob("checkpoint-*.zip"), reverse=True):
        try:
            return PPO.load(path, env=streets, device=DEVICE)
        except Exception as error:  # whatever unpickling half a file may raise
            log.warning("%s can't be read and is skipped: %s", path, error)
    return None


def _checkpoint(folder: Path, model: BaseAlgorithm) -> None:
    """Save a model, whole or not at all, beside the last few, and remove older ones."""
    with replacing(folder / f"checkpoint-{model.num_timesteps:09d}.zip") as part:
        model.save(part)
    for old in sorted(folder.glob("checkpoint-*.zip"))[:-_KEPT_CHECKPOINTS]:
        old.unlink()


# -- what is written down -------------------------------------------------------------------------


class _Record:
    """Episodes, evaluations, and the policy that did best in them.

    Args:
        setup: what is trained.
        folder: of the training.
        steps: that are done already; what is written of later ones is forgotten.
    """

    def __init__(self, setup: Setup, folder: Path, steps: int) -> None:
        self._setup = setup
        start = start_of(setup)
        self._start_hash = file_hash(start.path) if start else None
        self._codebook = codebook_of(setup)
        self._episodes = History(folder / "episodes.jsonl")
        self._evaluations = History(folder / "evaluations.jsonl")
        self._policy = PolicyFile(folder / "policy.safetensors")
        histories = (self._episodes, self._evaluations)
        for history in histories:
            history.go_back_to(steps)
        past = [row["seconds"] for history in histories for row in history.rows()]
        self._clock = Clock(max(past, default=0.0))

    @property
    def evaluated(self) -> bool:
        """Whether there has been an evaluation."""
        return bool(self._evaluations.rows())

    def episode(self, steps: int, info: dict[str, Any]) -> None:
        """Write down an episode that ended."""
        row = {"steps": steps, "seconds": self._clock.seconds}
        result = {"return": float(info["episode"]["r"]), "length": int(info["episode"]["l"])}
        endings = {name: bool(info[name]) for name in ("is_success", "collision", "timeout")}
        cell = {name: info[name] for name in Cell._fields}
        self._episodes.append({**row, **cell, **result, **endings})

    def evaluate(self, model: BaseAlgorithm) -> None:
        """Evaluate a policy, and keep it if none before was better."""
        result = evaluate_policy(model, self._setup)
        best = max(map(_goodness, self._evaluations.rows()), default=(-math.inf, -math.inf))
        if _goodness(result) >= best:
            self._policy.write(self._card(model.num_timesteps, result), model, self._codebook)
        # The row comes last: whoever finds it finds the policy, too.
        steps = {"steps": model.num_timesteps, "seconds": self._clock.seconds}
        self._evaluations.append({**steps, **result})
        for name, value in result.items():
            model.logger.record(f"Evaluation/{name}", value)

    def trained(self, steps: int) -> Trained:
        """Return what came of the training so far."""
        evaluations, episodes = self._evaluations.rows(), self._episodes.rows()
        seconds = max(row["seconds"] for row in (*evaluations, *episodes))
        return Trained(self._policy.path, steps, seconds, tuple(evaluations), tuple(episodes))

    def _card(self, steps: int, evaluation: dict[str, float]) -> PolicyCard:
        kb = sfol.KnowledgeBase.load(*self._setup.rules)
        return PolicyCard(
            setup=self._setup,
            start_hash=self._start_hash,
            steps=steps,
            knowledge_base=kb.name,
            knowledge_base_hash=kb.hash,
            evaluation=evaluation,
            versions=versions(),
        )


def _goodness(evaluation: Row) -> tuple[float, float]:
    return evaluation["success"], evaluation["return"]


def evaluate_policy(model: BaseAlgorithm, setup: Setup) -> dict[str, float]:
    """Return how a policy does on streets that training never sees, over all of a setup's cells.

    Args:
        model: drives by its most likely actions.
        setup: gives the streets and the number of episodes.

    Returns:
        Shares of success, collision and timeout, the mean return and length of an episode, and the
        share of success in each density of traffic that was drawn, such as ``success_low``.
    """
    cells = tuple(dict.fromkeys(cell for stage in setup.stages for cell in stage.cells))
    # Those of the training wait meanwhile, and hold memory: more than there are processors are of
    # no use.
    count = min(setup.streets, cores())
    draws = _EVALUATION_DRAWS + 1_000_000 * setup.seed
    streets = make_streets(setup, cells, draws, seeds=EVALUATION, count=count)
    try:
        infos = list(_endings(model, streets, setup.evaluation_episodes))
    finally:
        streets.close()
    levels = sorted({info["traffic"] for info in infos})
    by_traffic = {
        f"success_{level}": float(
            np.mean([info["is_success"] for info in infos if info["traffic"] == level])
        )
        for level in levels
    }
    return {
        "success": float(np.mean([info["is_success"] for info in infos])),
        "collision": float(np.mean([info["collision"] for info in infos])),
        "timeout": float(np.mean([info["timeout"] for info in infos])),
        "return": float(np.mean([info["episode"]["r"] for info in infos])),
        "length": float(np.mean([info["episode"]["l"] for info in infos])),
        **by_traffic,
    }


def _endings(model: BaseAlgorithm, streets: VecEnv, episodes: int) -> Iterator[dict[str, Any]]:
    """Yield the last info of each of the first episodes.

    How many each street drives is settled beforehand. Were it the first to end that count, those
    that end soon, in a collision, would be among them too often.
    """
    left = [len(range(street, episodes, streets.num_envs)) for street in range(streets.num_envs)]
    observations: Any = streets.reset()
    while any(left):
        actions, _ = model.predict(observations, deterministic=True)
        observations, _, dones, infos = streets.step(actions)
        for street in np.flatnonzero(dones):
            if left[street]:
                left[street] -= 1
                yield infos[street]
