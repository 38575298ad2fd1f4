"""Training: PPO of stable-baselines3 on a setup's streets, in a folder from which it can go on."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from stable_baselines3.common.logger import configure
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv, VecMonitor

import sfol
from env.cells import Cell
from env.curriculum import StreetsInTurn
from env.description import Describer
from env.networks import load_autoencoder, load_segmenter
from env.pipeline import ScenePipeline
from env.setup import Setup
from env.vector import DescribedStreets
from sfol.errors import UsageError
from sfol.writing import replacing
from vsr.segmentation import SimulatorSegmenter

log = logging.getLogger(__name__)

Progress = Callable[[int, str], None]

# Seeds of training and of the evaluations during it; the final test has small ones.
TRAINING_SEEDS = 1_000_000_000
EVALUATION_SEEDS = 2_000_000_000
_KEPT_CHECKPOINTS = 3


@dataclass(frozen=True)
class Trained:
    """What came of a training.

    Attributes:
        policy: the file of the last policy.
        steps: steps of all streets together.
        evaluations: what each evaluation during training found, in order.
    """

    policy: Path
    steps: int
    evaluations: tuple[dict[str, float], ...]


def train(setup: Setup, folder: Path, *, progress: Progress = lambda steps, stage: None) -> Trained:
    """Train a setup, or go on with its training.

    Args:
        setup: what is trained.
        folder: for checkpoints, tensorboard's files, evaluations and the policy. A training that
            was stopped goes on from the last checkpoint that can be read.
        progress: called with the steps done and the present cells.

    Raises:
        UsageError: the folder holds the training of another setup.
    """
    folder.mkdir(parents=True, exist_ok=True)
    _claim(folder, setup)
    set_random_seed(setup.seed)
    streets = make_streets(setup, setup.stages[0].cells, TRAINING_SEEDS + 1000 * setup.seed)
    try:
        model = _model(setup, streets, folder)
        model.set_logger(configure(str(folder), ["tensorboard"]))
        callbacks: list[BaseCallback] = [
            _Curriculum(setup),
            _RewardParts(),
            _BetweenUpdates(setup.checkpoint_steps, partial(_checkpoint, folder)),
            _BetweenUpdates(setup.evaluation_steps, partial(_record_evaluation, setup, folder)),
            _Progress(setup, progress),
        ]
        if model.num_timesteps < setup.steps:
            model.learn(
                setup.steps - model.num_timesteps,
                callback=CallbackList(callbacks),
                reset_num_timesteps=False,
            )
        policy = folder / "policy.zip"
        _save(model, policy)
    finally:
        streets.close()
    return Trained(policy, model.num_timesteps, tuple(_read_evaluations(folder)))


def make_streets(setup: Setup, cells: Sequence[Cell], seed: int, *, count: int = 0) -> VecEnv:
    """Return a setup's streets, with its observations and rewards.

    Args:
        setup: gives rules, perception, observation, fusion and the number of streets.
        cells: to draw from.
        seed: of the first street; the others follow.
        count: how many streets; the setup's number by default.
    """
    described = setup.observation == "vsr"
    options = {
        "rules": sfol.KnowledgeBase.load(*setup.rules),
        "observation": "frame" if described else setup.observation,
        "perception": "none" if described else setup.perception,
    }
    make: Callable[[], Any] = partial(StreetsInTurn, tuple(cells), **options)
    number = count or setup.streets
    streets: VecEnv = (
        DummyVecEnv([make]) if number == 1 else SubprocVecEnv([make] * number, start_method="spawn")
    )
    if described:
        pipeline = _pipeline(setup)
        encoder = None if setup.fusion == "ssi" else load_autoencoder()
        describer = Describer(pipeline, setup.fusion, encoder)
        streets = DescribedStreets(streets, pipeline, describer)
    streets = VecMonitor(streets)
    streets.seed(seed)
    return streets


def _pipeline(setup: Setup) -> ScenePipeline:
    segmenter = load_segmenter() if setup.perception == "unet" else SimulatorSegmenter()
    return ScenePipeline(sfol.KnowledgeBase.load(*setup.rules), segmenter)


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


def _model(setup: Setup, streets: VecEnv, folder: Path) -> PPO:
    """Return the model of the last checkpoint that can be read, or a new one."""
    for path in sorted(folder.glob("checkpoint-*.zip"), reverse=True):
        try:
            return PPO.load(path, env=streets, device="auto")
        except Exception as error:  # whatever unpickling half a file may raise
            log.warning("%s can't be read and is skipped: %s", path, error)
    learning = setup.learning
    layers = list(learning.layers)
    return PPO(
        "MlpPolicy",
        streets,
        seed=setup.seed,
        policy_kwargs={
            "net_arch": {"pi": layers, "vf": layers},
            "log_std_init": learning.log_std_init,
        },
        **learning.model_dump(exclude={"layers", "log_std_init"}),
    )


def _save(model: BaseAlgorithm, path: Path) -> None:
    """Save a model so that the file appears complete or not at all."""
    with replacing(path) as part:
        model.save(part)


# -- callbacks ------------------------------------------------------------------------------------


class _BetweenUpdates(BaseCallback):
    """Does something between two updates, when that many steps have passed since the last time."""

    def __init__(self, interval: int, action: Callable[[BaseAlgorithm], None]) -> None:
        super().__init__()
        self._interval = interval
        self._action = action
        self._last = 0

    def _on_training_start(self) -> None:
        self._last = self.num_timesteps

    def _on_rollout_start(self) -> None:
        if self.num_timesteps - self._last >= self._interval:
            self._last = self.num_timesteps
            self._action(self.model)

    def _on_step(self) -> bool:
        return True


def _checkpoint(folder: Path, model: BaseAlgorithm) -> None:
    """Save a model beside the last few, and remove older ones."""
    _save(model, folder / f"checkpoint-{model.num_timesteps:09d}.zip")
    for old in sorted(folder.glob("checkpoint-*.zip"))[:-_KEPT_CHECKPOINTS]:
        old.unlink()


def _record_evaluation(setup: Setup, folder: Path, model: BaseAlgorithm) -> None:
    """Evaluate a policy, and write down what comes of it."""
    result = evaluate_policy(model, setup)
    for name, value in result.items():
        model.logger.record(f"Evaluation/{name}", value)
    with (folder / "evaluations.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps({"steps": model.num_timesteps, **result}) + "\n")


class _Curriculum(BaseCallback):
    """Changes the cells where the setup says so."""

    def __init__(self, setup: Setup) -> None:
        super().__init__()
        self._setup = setup
        self._cells = setup.stages[0].cells

    def _on_rollout_start(self) -> None:
        cells = self._setup.stage_at(self.num_timesteps).cells
        if cells != self._cells:
            self._cells = cells
            self.training_env.env_method("use", cells)

    def _on_step(self) -> bool:
        return True


class _RewardParts(BaseCallback):
    """Writes what rewards were made of: sums of terms and means of weights over each episode."""

    def _on_training_start(self) -> None:
        self._sums: list[dict[str, float]] = [{} for _ in range(self.training_env.num_envs)]
        self._lengths = [0] * self.training_env.num_envs

    def _on_step(self) -> bool:
        for street, (info, done) in enumerate(
            zip(self.locals["infos"], self.locals["dones"], strict=True)
        ):
            sums = self._sums[street]
            for name, value in info.items():
                if name.startswith(("reward_", "weight_", "confidence_")):
                    sums[name] = sums.get(name, 0.0) + float(value)
            self._lengths[street] += 1
            if done:
                self._write(sums, self._lengths[street])
                for ending in ("is_success", "collision", "timeout"):
                    self.logger.record_mean(f"Episode/{ending}", float(info[ending]))
                self._sums[street], self._lengths[street] = {}, 0
        return True

    def _write(self, sums: dict[str, float], length: int) -> None:
        for name, total in sums.items():
            kind, part = name.split("_", 1)
            if kind == "reward":
                self.logger.record_mean(f"Episode_Reward/{part}", total)
            else:
                self.logger.record_mean(f"{kind.capitalize()}/{part}", total / length)


class _Progress(BaseCallback):
    """Reports how far the training is."""

    def __init__(self, setup: Setup, progress: Progress) -> None:
        super().__init__()
        self._setup = setup
        self._report = progress

    def _on_step(self) -> bool:
        stage = self._setup.stage_at(self.num_timesteps)
        self._report(self.num_timesteps, f"{'/'.join(stage.traffic)} traffic")
        return True


def evaluate_policy(model: BaseAlgorithm, setup: Setup) -> dict[str, float]:
    """Return how a policy does on streets that training never sees, over all of a setup's cells.

    Args:
        model: drives by its most likely actions.
        setup: gives the streets and the number of episodes.

    Returns:
        Shares of success, collision and timeout, and the mean return and length of an episode.
    """
    cells = tuple(dict.fromkeys(cell for stage in setup.stages for cell in stage.cells))
    streets = make_streets(setup, cells, EVALUATION_SEEDS + 1000 * setup.seed, count=1)
    try:
        infos = list(islice(_endings(model, streets), setup.evaluation_episodes))
    finally:
        streets.close()
    return {
        "success": float(np.mean([info["is_success"] for info in infos])),
        "collision": float(np.mean([info["collision"] for info in infos])),
        "timeout": float(np.mean([info["timeout"] for info in infos])),
        "return": float(np.mean([info["episode"]["r"] for info in infos])),
        "length": float(np.mean([info["episode"]["l"] for info in infos])),
    }


def _endings(model: BaseAlgorithm, streets: VecEnv) -> Iterator[dict[str, Any]]:
    """Yield the last info of one episode after the other."""
    observations: Any = streets.reset()
    while True:
        actions, _ = model.predict(observations, deterministic=True)
        observations, _, dones, infos = streets.step(actions)
        if dones[0]:
            yield infos[0]


def _read_evaluations(folder: Path) -> list[dict[str, float]]:
    file = folder / "evaluations.jsonl"
    if not file.exists():
        return []
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
