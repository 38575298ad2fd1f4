"""Training: PPO of stable-baselines3 on a setup's streets, in a folder from which it can go on."""

from __future__ import annotations

import json
import logging
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from stable_baselines3.common.logger import configure
from stable_baselines3.common.utils import LinearSchedule, set_random_seed
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    SubprocVecEnv,
    VecEnv,
    VecEnvWrapper,
    VecFrameStack,
    VecMonitor,
)
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn
from torch import nn

import sfol
from env.camera import DashCameraParameters
from env.cells import Cell
from env.curriculum import StreetsInTurn
from env.history import Clock, History, Row
from env.observation import observer_of
from env.parallel import cores
from env.policy_files import PolicyCard, PolicyFile
from env.results import versions
from env.setup import Setup
from env.whitening import Whitening
from sfol.errors import UsageError
from sfol.writing import replacing

log = logging.getLogger(__name__)

Array = npt.NDArray[np.float32]
Progress = Callable[[int, str], None]

# From these, streets draw the seeds of their episodes.
TRAINING_SEEDS = 1_000_000_000
EVALUATION_SEEDS = 2_000_000_000
_KEPT_CHECKPOINTS = 3
_RECENT = 50  # episodes whose successes the progress tells
# Of the policy, a small network: on a GPU, where the workers' networks run, an update took half as
# long again as on the processor beside it.
_DEVICE = "cpu"
# Of a setup's hyperparameters, those that PPO does not take as they are.
_OWN = {
    "learning_rate",
    "last_learning_rate",
    "last_log_std",
    "layers",
    "mean_init",
    "log_std_init",
    "reward_scale",
    "observation_scale",
    "rollout_steps",
    "whitening_steps",
}


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
        UsageError: the folder holds the training of another setup.
    """
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
    streets = make_streets(setup, setup.stages[0].cells, TRAINING_SEEDS)
    try:
        model = _last_model(streets, folder)
        if model is None:
            model = new_model(setup, streets)
            _whiten(model, streets, setup, progress)
        # The model has given the streets its own seed; and a training that goes on meets new ones.
        streets.seed(TRAINING_SEEDS + 1_000_000 * setup.seed + model.num_timesteps)
        record = _Record(setup, folder, model.num_timesteps)
        model.set_logger(configure(str(folder), ["tensorboard"]))
        callbacks: list[BaseCallback] = [
            _Curriculum(setup),
            _LessNoise(setup),
            _RewardParts(),
            _Episodes(record),
            _BetweenUpdates(setup.checkpoint_steps, partial(_checkpoint, folder)),
            _BetweenUpdates(setup.evaluation_steps, record.evaluate),
            _Progress(setup, progress),
        ]
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


def make_streets(setup: Setup, cells: Sequence[Cell], seed: int, *, count: int = 0) -> VecEnv:
    """Return a setup's streets, with its observations and rewards, each in its own process.

    The processes draw, perceive and describe for themselves, so that all processors are busy all
    the time; what they return is small.

    Args:
        setup: gives rules, perception, observation, fusion and the number of streets.
        cells: to draw from.
        seed: of the first street; the others follow.
        count: how many streets; the setup's number by default.
    """
    make: Callable[[], Any] = partial(_street, setup, tuple(cells))
    number = count or setup.streets
    streets: VecEnv = (
        DummyVecEnv([make])
        if number == 1
        else SubprocVecEnv([partial(_in_one_thread, make)] * number, start_method="spawn")
    )
    if setup.frames > 1:
        streets = VecFrameStack(streets, setup.frames)
    # Monitored before they are scaled: returns are told as the rules give them.
    streets = ScaledStreets(
        VecMonitor(streets),
        observations=setup.learning.observation_scale,
        rewards=setup.learning.reward_scale,
    )
    streets.seed(seed)
    return streets


def _street(setup: Setup, cells: tuple[Cell, ...]) -> StreetsInTurn:
    """Return what one process drives on."""
    observer = observer_of(
        setup.observation, DashCameraParameters().size, setup.fusion, speed=setup.speed
    )
    return StreetsInTurn(
        cells,
        rules=sfol.KnowledgeBase.load(*setup.rules),
        perception=setup.perception,
        observation=observer,
    )


def _in_one_thread(make: Callable[[], Any]) -> Any:
    """Make a worker's streets; there is a worker for each processor already."""
    torch.set_num_threads(1)
    return make()


class ScaledStreets(VecEnvWrapper):
    """Streets whose observations and rewards are multiplied by factors.

    The value function has to reach the size of the returns, and from about 1 that takes many
    updates if they are 50; and units of tanh learn slowly from inputs that saturate them.

    Args:
        streets: without scales.
        observations: factor on them, `PolicyFile.write` puts it into the policy's first layer.
        rewards: factor on them.
    """

    def __init__(self, streets: VecEnv, *, observations: float, rewards: float) -> None:
        space = cast(spaces.Box, streets.observation_space)
        scaled = spaces.Box(observations * space.low, observations * space.high, dtype=np.float32)
        super().__init__(streets, observation_space=scaled)
        self._observations = np.float32(observations)
        self._rewards = rewards

    def reset(self) -> VecEnvObs:
        """Start an episode in every street, and return scaled observations."""
        return self._observations * cast(Array, self.venv.reset())

    def step_wait(self) -> VecEnvStepReturn:
        """Return what the streets return, with scaled observations and rewards."""
        observations, rewards, dones, infos = self.venv.step_wait()
        for i in np.flatnonzero(dones):
            infos[i]["terminal_observation"] *= self._observations
        scaled = self._observations * cast(Array, observations)
        return scaled, self._rewards * rewards, dones, infos


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
            return PPO.load(path, env=streets, device=_DEVICE)
        except Exception as error:  # whatever unpickling half a file may raise
            log.warning("%s can't be read and is skipped: %s", path, error)
    return None


def new_model(setup: Setup, streets: VecEnv) -> PPO:
    """Return an untrained model with a setup's hyperparameters; it gives the streets its seed."""
    learning = setup.learning
    layers = list(learning.layers)
    whitened = {"features_extractor_class": Whitening} if learning.whitening_steps else {}
    model = PPO(
        "MlpPolicy",
        streets,
        seed=setup.seed,
        device=_DEVICE,
        policy_kwargs={
            "net_arch": {"pi": layers, "vf": layers},
            "log_std_init": learning.log_std_init,
            **whitened,
        },
        learning_rate=LinearSchedule(
            learning.learning_rate, learning.last_learning_rate, end_fraction=1.0
        ),
        n_steps=learning.rollout_steps // setup.streets,
        **learning.model_dump(exclude=_OWN),
    )
    torch.nn.init.constant_(cast(nn.Linear, model.policy.action_net).bias, learning.mean_init)
    return model


def _whiten(model: PPO, streets: VecEnv, setup: Setup, progress: Progress) -> None:
    """Let an untrained policy drive, and whiten observations by what it sees."""
    steps, noise_steps = setup.learning.whitening_steps, setup.learning.sde_sample_freq
    if not steps:
        return
    observations: Any = streets.reset()
    seen: list[Array] = []
    while len(seen) * streets.num_envs < steps:
        if model.use_sde and noise_steps > 0 and len(seen) % noise_steps == 0:
            model.policy.reset_noise(streets.num_envs)
        progress(0, f"looking around, {len(seen) * streets.num_envs} of {steps} steps")
        seen.append(observations)
        observations, *_ = streets.step(model.predict(observations)[0])
    cast(Whitening, model.policy.features_extractor).measure(np.concatenate(seen))


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
        self._episodes = History(folder / "episodes.jsonl")
        self._evaluations = History(folder / "evaluations.jsonl")
        self._policy = PolicyFile(folder / "policy.safetensors")
        histories = (self._episodes, self._evaluations)
        for history in histories:
            history.go_back_to(steps)
        past = [row["seconds"] for history in histories for row in history.rows()]
        self._clock = Clock(max(past, default=0.0))

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
            self._policy.write(self._card(model.num_timesteps, result), model)
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
            steps=steps,
            knowledge_base=kb.name,
            knowledge_base_hash=kb.hash,
            evaluation=evaluation,
            versions=versions(),
        )


def _goodness(evaluation: Row) -> tuple[float, float]:
    return evaluation["success"], evaluation["return"]


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


class _LessNoise(BaseCallback):
    """Lets the actions' greatest deviation fall in the course of a training, if the setup says so.

    Policies that have learnt with much noise to the end collide more often without it.
    """

    def __init__(self, setup: Setup) -> None:
        super().__init__()
        self._steps = setup.steps
        self._first = setup.learning.log_std_init
        self._last = setup.learning.last_log_std

    def _on_rollout_start(self) -> None:
        if self._last is None:
            return
        done = self.num_timesteps / self._steps
        log_std = cast(nn.Parameter, self.model.policy.log_std)
        log_std.data.clamp_(max=self._first + done * (self._last - self._first))

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


class _Episodes(BaseCallback):
    """Writes down every episode that ends."""

    def __init__(self, record: _Record) -> None:
        super().__init__()
        self._record = record

    def _on_step(self) -> bool:
        for info, done in zip(self.locals["infos"], self.locals["dones"], strict=True):
            if done:
                self._record.episode(self.num_timesteps, info)
        return True


class _Progress(BaseCallback):
    """Reports how far the training is, and how many of its last episodes were a success."""

    def __init__(self, setup: Setup, progress: Progress) -> None:
        super().__init__()
        self._setup = setup
        self._report = progress
        self._successes: deque[bool] = deque(maxlen=_RECENT)

    def _on_step(self) -> bool:
        endings = zip(self.locals["infos"], self.locals["dones"], strict=True)
        self._successes.extend(info["is_success"] for info, done in endings if done)
        stage = self._setup.stage_at(self.num_timesteps)
        text = "/".join(stage.traffic)
        if self._successes:
            text += f", {np.mean(self._successes):.0%} of {len(self._successes)} succeed"
        self._report(self.num_timesteps, text)
        return True


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
    streets = make_streets(setup, cells, EVALUATION_SEEDS + 1_000_000 * setup.seed, count=count)
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
