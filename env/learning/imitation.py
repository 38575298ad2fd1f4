"""Imitation: what a policy could learn at best from what a setup lets it see.

A teacher that reaches the goal shows what it would do, wherever the learner leads (DAgger). No
reward and no exploration is involved, so where the learner fails its observation says too little,
or its network is too small.

Source: Ross, Gordon, Bagnell, "A Reduction of Imitation Learning and Structured Prediction to
No-Regret Online Learning", 2011.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import torch
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor, nn
from torch.nn import functional

import sfol
from env.driving.drivers import DRIVERS
from env.driving.policy_files import Interface, PolicyCard, PolicyFile, Standardised, policy_network
from env.driving.setup import Learning, Setup
from env.evaluation.results import versions
from env.learning.journal import History
from env.learning.new_model import codebook_of
from env.learning.training import EVALUATION_DRAWS, evaluated, evaluation_streets
from env.learning.vector_streets import make_streets
from sfol.errors import UsageError, did_you_mean
from sfol.locking import locked_folder

Array = npt.NDArray[np.float32]
# Called with the decisions driven so far, and what is being done.
Progress = Callable[[int, str], None]

_DRAWS = 3_000_000_000  # of what streets draw, as in `env.learning.training`
_DEVIATION = 1e-4  # what varies less than this is not amplified


@dataclass(frozen=True)
class Lessons:
    """How a teacher is imitated.

    Attributes:
        teacher: a scripted driver.
        rounds: of driving and learning. In the first the teacher drives, then the learner.
        decisions: of all streets together, in a round.
        patience: passes over all that was seen without a better result on the part that is held
            back, after which a round's learning ends.
        most_passes: after which it ends in any case.
        batch_size: decisions for one gradient.
        learning_rate: of Adam.
        weight_decay: of Adam (AdamW).
        held_back: share of the decisions, whole stretches of driving, that nothing is learnt from.
    """

    teacher: str = "cautious"
    rounds: int = 8
    decisions: int = 4096
    patience: int = 4
    most_passes: int = 40
    batch_size: int = 256
    learning_rate: float = 1e-3
    weight_decay: float = 1e-2
    held_back: float = 0.1


@dataclass(frozen=True)
class Imitated:
    """What came of it.

    Attributes:
        policy: the file of the policy after the last round.
        rounds: of each, ``steps``, the decisions seen so far, the mean squared errors of the pedal
            on what was learnt from and on what was held back, ``error`` and ``held_back_error``,
            and how the learner drove in an evaluation.
    """

    policy: Path
    rounds: tuple[dict[str, float], ...]


def imitate(
    setup: Setup,
    folder: Path,
    lessons: Lessons | None = None,
    *,
    progress: Progress = lambda decisions, what: None,
) -> Imitated:
    """Teach a setup's policy by showing it what to do.

    Args:
        setup: gives streets, observation, the length of decisions and the network's layers.
        folder: for the policy and ``rounds.jsonl``. It must not have them yet.
        lessons: how it is taught.
        progress: called while it drives and learns.

    Raises:
        UsageError: there is no such teacher, or the folder has a policy already.
        SfolError: another process has the folder, or a street's process ended.
    """
    lessons = lessons or Lessons()
    _check(lessons, folder)
    torch.manual_seed(setup.seed)
    with locked_folder(folder):
        history = History(folder / "rounds.jsonl", ("steps",))
        history.go_back_to(0)  # what was stopped begins anew: what was seen is not kept
        streets = make_streets(
            setup,
            setup.cells,
            _DRAWS + 1_000_000 * setup.seed,
            teacher=DRIVERS[lessons.teacher](),
        )
        with closing(streets), closing(evaluation_streets(setup)) as unseen:
            learner = _Learner(setup, streets, lessons)
            for number in range(1, lessons.rounds + 1):
                learner.drive(number == 1, progress)
                errors = learner.learn(number, progress)
                progress(learner.seen, "evaluating")
                unseen.seed(EVALUATION_DRAWS + 1_000_000 * setup.seed)
                result = evaluated(unseen, learner.act, setup.evaluation_episodes)
                history.append({"steps": learner.seen, **errors, **result})
        file = PolicyFile(folder / "policy.safetensors")
        file.write(_card(setup, lessons, learner.seen, result), learner.network, codebook_of(setup))
        return Imitated(file.path, tuple(history.rows()))


def _check(lessons: Lessons, folder: Path) -> None:
    if lessons.teacher not in DRIVERS:
        raise UsageError(
            f"there is no teacher '{lessons.teacher}'",
            name=lessons.teacher,
            suggestion=did_you_mean(lessons.teacher, DRIVERS) or f"one of {', '.join(DRIVERS)}",
        )
    if (folder / "policy.safetensors").exists():
        raise UsageError(
            f"'{folder}' has a policy already", name=str(folder), suggestion="another --output"
        )


class _Learner:
    """A network, all that it was shown, and the streets that it drives on."""

    def __init__(self, setup: Setup, streets: VecEnv, lessons: Lessons) -> None:
        (self._size,) = cast(tuple[int], streets.observation_space.shape)
        self.network = policy_network(self._size, Interface.of(setup))
        self._learning = setup.learning
        self._lessons = lessons
        self._streets = streets
        self._rng = np.random.default_rng(setup.seed)
        self._observations: list[Array] = []
        self._pedals: list[Array] = []
        self._now: Any = streets.reset()
        self._shown = _shown(streets.unwrapped.reset_infos)  # wrappers do not pass them on

    @property
    def seen(self) -> int:
        """How many decisions it was shown."""
        return sum(map(len, self._pedals))

    def act(self, observations: Array) -> Array:
        """Return the pedals that the network chooses, float32 (B, 1)."""
        with torch.inference_mode():
            pedals = self.network(torch.from_numpy(observations))
        return cast(Array, pedals.clamp(-1.0, 1.0).numpy())

    def drive(self, teacher: bool, progress: Progress) -> None:
        """Drive a round, and keep what was seen with what the teacher would have done.

        Args:
            teacher: whether the teacher drives; else the learner does.
            progress: called after every decision.
        """
        who, before = ("the teacher" if teacher else "the learner"), self.seen
        observations, pedals = [], []
        for step in range(-(-self._lessons.decisions // self._streets.num_envs)):
            observations.append(self._now)
            pedals.append(self._shown)
            action = self._shown if teacher else self.act(self._now)
            self._now, _, dones, infos = self._streets.step(action)
            started = self._streets.unwrapped.reset_infos
            now = [started[i] if done else infos[i] for i, done in enumerate(dones)]
            self._shown = _shown(now)
            progress(before + (step + 1) * self._streets.num_envs, f"{who} drives")
        # By street, so that neighbours in the arrays are neighbours in time.
        self._observations.append(np.stack(observations, axis=1).reshape(-1, self._size))
        self._pedals.append(np.stack(pedals, axis=1).reshape(-1, 1))

    def learn(self, number: int, progress: Progress) -> dict[str, float]:
        """Fit the network to all that was shown, and return its errors."""
        held = [self._held_back(len(pedals)) for pedals in self._pedals]
        learnt, tested = (
            tuple(
                torch.from_numpy(np.concatenate([rows[mask] for rows, mask in pairs]))
                for pairs in (
                    list(zip(self._observations, masks, strict=True)),
                    list(zip(self._pedals, masks, strict=True)),
                )
            )
            for masks in ([~mask for mask in held], held)
        )
        _standardise(self.network, learnt[0], self._learning)
        return _fit(
            self.network,
            learnt,
            tested,
            self._lessons,
            lambda p: progress(self.seen, f"learning, round {number}, pass {p}"),
        )

    def _held_back(self, count: int) -> npt.NDArray[np.bool_]:
        """Return a mask of the last stretch of a round's driving on every street."""
        length = count // self._streets.num_envs
        mask = np.arange(length) >= round(length * (1.0 - self._lessons.held_back))
        return np.tile(mask, self._streets.num_envs)


def _shown(infos: Any) -> Array:
    return np.array([[info["teacher"]] for info in infos], np.float32)


def _standardise(network: nn.Sequential, observations: Tensor, learning: Learning) -> None:
    """Let a network see observations as it would in a training, once that has seen all of these."""
    part = cast(Standardised, network.standardised)
    if learning.norm_obs:
        part.mean.copy_(observations.mean(dim=0))
        part.deviation.copy_(observations.std(dim=0).clamp(min=_DEVIATION))
    else:
        part.deviation.fill_(1.0 / learning.observation_scale)


def _fit(
    network: nn.Module,
    learnt: tuple[Tensor, ...],
    tested: tuple[Tensor, ...],
    lessons: Lessons,
    progress: Callable[[int], None],
) -> dict[str, float]:
    """Let a network learn pedals, until those that are held back get no better.

    Args:
        network: is left with the weights that were best on those.
        learnt: observations, float32 (N, D), and pedals, (N, 1).
        tested: those that are held back.
        lessons: how it learns.
        progress: called before every pass.

    Returns:
        Mean squared errors.
    """
    optimiser = torch.optim.AdamW(
        network.parameters(), lr=lessons.learning_rate, weight_decay=lessons.weight_decay
    )
    best, kept, since = _error(network, *tested), _copied(network), 0
    for number in range(1, lessons.most_passes + 1):
        progress(number)
        for batch in torch.randperm(len(learnt[0])).split(lessons.batch_size):
            optimiser.zero_grad()
            functional.mse_loss(network(learnt[0][batch]), learnt[1][batch]).backward()
            optimiser.step()
        error, since = _error(network, *tested), since + 1
        if error < best:
            best, kept, since = error, _copied(network), 0
        if since >= lessons.patience:
            break
    network.load_state_dict(kept)
    return {"error": _error(network, *learnt), "held_back_error": best}


def _error(network: nn.Module, observations: Tensor, pedals: Tensor) -> float:
    with torch.inference_mode():
        parts = zip(observations.split(4096), pedals.split(4096), strict=True)
        total = sum(functional.mse_loss(network(x), y, reduction="sum").item() for x, y in parts)
    return total / len(pedals)


def _copied(network: nn.Module) -> dict[str, Tensor]:
    return {name: tensor.clone() for name, tensor in network.state_dict().items()}


def _card(setup: Setup, lessons: Lessons, seen: int, result: dict[str, float]) -> PolicyCard:
    rules = sfol.KnowledgeBase.load(*setup.rules)
    return PolicyCard(
        interface=Interface.of(setup),
        training={"setup": setup.model_dump(mode="json"), "imitation": asdict(lessons)},
        steps=seen,
        knowledge_base=rules.name,
        knowledge_base_hash=rules.hash,
        evaluation=result,
        versions=versions(),
    )
