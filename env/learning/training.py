"""Training: PPO of stable-baselines3 on a setup's streets, in a folder from which it can go on."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from pydantic import ValidationError
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from stable_baselines3.common.logger import configure
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

import sfol
from env.driving.policies import check_exists, file_hash
from env.driving.policy_files import Interface, PolicyCard, PolicyFile
from env.driving.setup import Setup
from env.evaluation.parallel import cores
from env.evaluation.results import versions
from env.learning.callbacks import (
    BetweenUpdates,
    Curriculum,
    Episodes,
    Progress,
    ProgressReport,
    RewardParts,
)
from env.learning.checkpoints import Checkpoints, other_rules
from env.learning.journal import Clock, History, Row
from env.learning.new_model import (
    codebook_of,
    divergence_told,
    new_model,
    normalised,
    policy_of,
    start_of,
)
from env.learning.vector_streets import make_streets
from env.street.seeds import EVALUATION
from env.world.cells import Cell
from sfol.errors import FileError, UsageError
from sfol.knowledge_base import KnowledgeBase
from sfol.locking import locked_folder
from sfol.reading import content_of, first_reason
from sfol.writing import replacing
from vsr.threads import one_thread

# Of what streets draw: cells, and the seeds of their episodes.
_TRAINING_DRAWS = 1_000_000_000
EVALUATION_DRAWS = 2_000_000_000
# The numbers that each row has, of an episode and of an evaluation.
_EPISODE = ("steps", "seconds", "return", "is_success", "collision", "timeout")
_EVALUATION = ("steps", "seconds", "return", "success")


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
            can't be used, or a file of the folder is damaged.
        SfolError: another process has the folder, it holds a training under other rules, a street's
            process ended, or the training has diverged.
    """
    start_of(setup)  # refused before anything is written
    rules = sfol.KnowledgeBase.load(*setup.rules)
    with locked_folder(folder), one_thread(), divergence_told():
        _claim(folder, setup)
        record = _Record(setup, rules, folder)
        if record.last_evaluation >= setup.steps:
            return record.trained(record.last_evaluation)
        return _train(setup, record, Checkpoints(folder, rules), progress)


def _train(setup: Setup, record: _Record, checkpoints: Checkpoints, progress: Progress) -> Trained:
    set_random_seed(setup.seed)
    streets = normalised(setup, make_streets(setup, setup.stages[0].cells, _TRAINING_DRAWS))
    try:
        model = checkpoints.last_model(setup, streets)
        done = model.num_timesteps if model else 0
        if done < setup.steps:
            # All at once: later, the others would wait whenever one builds, for seconds each time.
            progress(done, "building streets")
            streets.env_method("build")
        if model is None:
            model = new_model(setup, streets, progress)
        # The model has given the streets its own seed; and a training that goes on meets new ones.
        streets.seed(_TRAINING_DRAWS + 1_000_000 * setup.seed + done)
        record.go_back_to(done)
        _learn(model, setup, record, checkpoints, progress)
    finally:
        streets.close()
    return record.trained(model.num_timesteps)


def _learn(
    model: PPO, setup: Setup, record: _Record, checkpoints: Checkpoints, progress: Progress
) -> None:
    """Let a model learn to its last step, evaluations and checkpoints included."""

    def evaluate(model: PPO) -> None:
        checkpoints.write(model)  # a training that goes on does not forget what was found
        record.evaluate(model)

    model.set_logger(configure(str(record.folder), ["tensorboard"]))
    if setup.start and record.last_evaluation < 0:
        record.evaluate(model)  # nothing worse than it started from is to come of a training
    done, evaluated = model.num_timesteps, max(record.last_evaluation, 0)
    callbacks: list[BaseCallback] = [
        Curriculum(setup),
        RewardParts(),
        Episodes(record.episode),
        BetweenUpdates(setup.checkpoint_steps, checkpoints.write, last=done),
        BetweenUpdates(setup.evaluation_steps, evaluate, last=evaluated),
        ProgressReport(setup, progress),
    ]
    if done < setup.steps:
        model.learn(setup.steps - done, callback=CallbackList(callbacks), reset_num_timesteps=False)
        checkpoints.write(model)
    record.evaluate(model)


def _claim(folder: Path, setup: Setup) -> None:
    """Write down whose folder it is, or make sure that it is this setup's."""
    file = folder / "setup.json"
    if not file.exists():
        with replacing(file) as part:
            part.write_text(setup.model_dump_json(indent=2), encoding="utf-8")
        return
    content = content_of(file, "setup")
    try:
        known = Setup.model_validate_json(content)
    except ValidationError as error:
        raise FileError(
            f"'{file}' can't be read as a setup: {first_reason(error)}",
            name=str(file),
            suggestion="remove it if the folder holds this setup's training; else another --output",
        ) from None
    if known != setup:
        raise UsageError(
            f"'{folder}' holds the training of another setup",
            name=str(folder),
            suggestion=f"another --output, or the setup in {file}",
        )


# -- what is written down -------------------------------------------------------------------------


class _Record:
    """Episodes, evaluations, and the policy that did best in them.

    Args:
        setup: what is trained.
        rules: that reward it.
        folder: of the training.

    Raises:
        UsageError: a file is damaged or missing.
        SfolError: the training was under other rules.
    """

    def __init__(self, setup: Setup, rules: KnowledgeBase, folder: Path) -> None:
        self.folder = folder
        self._setup = setup
        self._rules = rules
        start = start_of(setup)
        self._start_hash = file_hash(start.path) if start else None
        self._codebook = codebook_of(setup)
        self._episodes = History(folder / "episodes.jsonl", _EPISODE)
        self._evaluations = History(folder / "evaluations.jsonl", _EVALUATION)
        self._policy = PolicyFile(folder / "policy.safetensors")
        self._clock = Clock(0.0)
        if self._evaluations.rows():
            self._check_policy()

    def go_back_to(self, steps: int) -> None:
        """Forget what is written of later steps, and let the clock go on."""
        histories = (self._episodes, self._evaluations)
        for history in histories:
            history.go_back_to(steps)
        past = [row["seconds"] for history in histories for row in history.rows()]
        self._clock = Clock(max(past, default=0.0))

    @property
    def last_evaluation(self) -> int:
        """How many steps were done at the last evaluation; -1 where there was none."""
        return max((row["steps"] for row in self._evaluations.rows()), default=-1)

    def episode(self, steps: int, info: dict[str, Any]) -> None:
        """Write down an episode that ended."""
        row = {"steps": steps, "seconds": self._clock.seconds}
        result = {"return": float(info["episode"]["r"]), "length": int(info["episode"]["l"])}
        endings = {name: bool(info[name]) for name in ("is_success", "collision", "timeout")}
        cell = {name: info[name] for name in Cell._fields}
        self._episodes.append({**row, **cell, **result, **endings})

    def evaluate(self, model: PPO) -> None:
        """Evaluate a policy, and keep it if none before was better."""
        result = evaluate_policy(model, self._setup)
        best = max(map(_goodness, self._evaluations.rows()), default=(-math.inf, -math.inf))
        if _goodness(result) >= best:
            card = self._card(model.num_timesteps, result)
            self._policy.write(card, policy_of(model, card.interface), self._codebook)
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
        return PolicyCard(
            interface=Interface.of(self._setup),
            training=self._setup.model_dump(mode="json"),
            start_hash=self._start_hash,
            steps=steps,
            knowledge_base=self._rules.name,
            knowledge_base_hash=self._rules.hash,
            evaluation=evaluation,
            versions=versions(),
        )

    def _check_policy(self) -> None:
        """Make sure that the best policy so far can be driven by, and is of the same rules."""
        try:
            check_exists(self._policy.path)
            self._policy.network()
            if self._codebook is not None:
                self._policy.codebook()
        except UsageError as error:
            raise FileError(
                f"{error.message}, though '{self._evaluations.file}' has its evaluation",
                name=error.name,
                suggestion=f"put it back, or remove '{self._evaluations.file.name}': the next "
                "evaluation writes a policy",
                place=error.place,
            ) from None
        if self._policy.card().knowledge_base_hash != self._rules.hash:
            raise other_rules(self.folder, self._rules)


def _goodness(evaluation: Row) -> tuple[float, float]:
    return evaluation["success"], evaluation["return"]


def evaluate_policy(model: PPO, setup: Setup) -> dict[str, float]:
    """Return how a policy does on streets that training never sees, over all of a setup's cells.

    Args:
        model: drives by its most likely actions.
        setup: gives the streets and the number of episodes.

    Returns:
        See `evaluated`.
    """
    seen = cast(VecNormalize, model.get_vec_normalize_env())

    def act(observations: Any) -> Any:
        return model.predict(seen.normalize_obs(observations), deterministic=True)[0]

    with closing(evaluation_streets(setup)) as streets:
        return evaluated(streets, act, setup.evaluation_episodes)


def evaluation_streets(setup: Setup) -> VecEnv:
    """Return streets with the episodes that a setup's policies are evaluated in."""
    # Those of the training wait meanwhile, and hold memory: more than there are processors are of
    # no use.
    count = min(setup.streets, cores())
    draws = EVALUATION_DRAWS + 1_000_000 * setup.seed
    return make_streets(setup, setup.cells, draws, seeds=EVALUATION, count=count)


def evaluated(streets: VecEnv, act: Callable[[Any], Any], episodes: int) -> dict[str, float]:
    """Return how somebody drives.

    Args:
        streets: which are reset.
        act: chooses the actions, (B, 1), by observations, (B, N).
        episodes: of all streets together.

    Returns:
        Shares of success, collision and timeout, the mean return and length of an episode, and the
        share of success in each density of traffic that was drawn, such as ``success_low``.
    """
    infos = list(_endings(streets, act, episodes))
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


def _endings(streets: VecEnv, act: Callable[[Any], Any], episodes: int) -> Iterator[dict[str, Any]]:
    """Yield the last info of each of the first episodes.

    How many each street drives is settled beforehand. Were it the first to end that count, those
    that end soon, in a collision, would be among them too often.
    """
    left = [len(range(street, episodes, streets.num_envs)) for street in range(streets.num_envs)]
    observations: Any = streets.reset()
    while any(left):
        observations, _, dones, infos = streets.step(act(observations))
        for street in np.flatnonzero(dones):
            if left[street]:
                left[street] -= 1
                yield infos[street]
