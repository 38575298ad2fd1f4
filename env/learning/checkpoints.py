"""Checkpoints: all that is needed to go on with a training, in files that run no code when read.

A checkpoint is ``checkpoint-<steps>.safetensors``: the tensors of the model, of its optimiser and
of what normalises its observations and rewards, and what else PPO remembers as JSON in the header.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, NonNegativeInt, ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from stable_baselines3 import PPO
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from torch import Tensor

from env.driving.setup import Setup
from env.learning.new_model import is_finite, untrained_model
from sfol.errors import FileError, SfolError
from sfol.knowledge_base import KnowledgeBase
from sfol.reading import first_reason, opened
from sfol.writing import replacing

log = logging.getLogger(__name__)

_KEPT = 3
_HEADER = "training"
_POLICY, _OPTIMISER = "policy.", "optimiser."
_SEEN = "seen."
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # what Adam remembers of a parameter
_STATISTICS = ("mean", "var", "count")  # what VecNormalize does of what it has seen


class _EpisodeInfo(BaseModel):
    """Return, length and time of an episode, as stable-baselines3 names them."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    r: float
    l: int  # noqa: E741
    t: float


class _Header(BaseModel):
    """What PPO remembers beside its tensors.

    Attributes:
        knowledge_base_hash: of the rules that reward the training.
        steps: of all streets together.
        updates: passes over the steps of a rollout.
        episodes: the last ones, which tensorboard's means are made of.
        successes: whether the last ones were.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    knowledge_base_hash: str
    steps: NonNegativeInt
    updates: NonNegativeInt
    episodes: tuple[_EpisodeInfo, ...]
    successes: tuple[bool, ...]


class Checkpoints:
    """The checkpoints in the folder of a training.

    Args:
        folder: of the training.
        rules: that reward it.
    """

    def __init__(self, folder: Path, rules: KnowledgeBase) -> None:
        self._folder = folder
        self._rules = rules

    def write(self, model: Any) -> None:
        """Write a model, whole or not at all, beside the last few, and remove older ones.

        Args:
            model: PPO after an update.
        """
        header = _Header(
            knowledge_base_hash=self._rules.hash,
            steps=model.num_timesteps,
            updates=model._n_updates,
            episodes=tuple(
                _EpisodeInfo(r=float(info["r"]), l=int(info["l"]), t=float(info["t"]))
                for info in model.ep_info_buffer or ()
            ),
            successes=tuple(map(bool, model.ep_success_buffer or ())),
        )
        content = save(_tensors(model), {_HEADER: header.model_dump_json()})
        with replacing(self._folder / f"checkpoint-{header.steps:09d}.safetensors") as part:
            part.write_bytes(content)
        for old in self.files()[:-_KEPT]:
            old.unlink(missing_ok=True)

    def last_model(self, setup: Setup, streets: VecEnv) -> PPO | None:
        """Return the model of the last checkpoint that can be read; None where there is none.

        Args:
            setup: of the training.
            streets: on which it goes on; they are given the setup's seed.

        Raises:
            SfolError: there are checkpoints, but none with which this training can go on.
        """
        files = self.files()
        if not files:
            self._refuse_pickles()
            return None
        for path in reversed(files):
            try:
                return self.read(path, setup, streets)
            except FileError as error:
                log.warning("%s is skipped: %s", path, error)
        raise FileError(
            f"no checkpoint in '{self._folder}' can be read",
            name=str(self._folder),
            suggestion="put one back, or remove them all: the training begins anew then",
        )

    def files(self) -> list[Path]:
        """Return them in order."""
        return sorted(self._folder.glob("checkpoint-*.safetensors"))

    def read(self, path: Path, setup: Setup, streets: VecEnv) -> PPO:
        """Return the model of a checkpoint.

        Args:
            path: of the file.
            setup: of the training.
            streets: see `last_model`.

        Raises:
            FileError: the file can't be read, or holds something else.
            SfolError: the training was under other rules.
        """
        opened(path, "checkpoint").close()  # no pipe, which would be waited for
        try:
            with safe_open(path, framework="pt") as file:
                header = _Header.model_validate_json((file.metadata() or {}).get(_HEADER, ""))
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        except (OSError, SafetensorError, ValidationError) as error:
            raise _damaged(path, error) from None
        if header.knowledge_base_hash != self._rules.hash:
            raise other_rules(self._folder, self._rules)
        return _model(path, setup, streets, header, tensors)

    def _refuse_pickles(self) -> None:
        pickles = sorted(self._folder.glob("checkpoint-*.zip"))
        if pickles:
            raise FileError(
                f"'{pickles[-1]}' is a checkpoint of an earlier version: a pickle, which may run "
                "any code when it is read",
                name=str(pickles[-1]),
                suggestion="another --output, with --start and the policy in this folder; or remove"
                " the .zip files, and the training begins anew",
            )


def other_rules(folder: Path, rules: KnowledgeBase) -> SfolError:
    """Return the error that a training was rewarded by other rules than those it would go on by."""
    return SfolError(
        f"'{folder}' holds a training under other rules: '{rules.name}' has changed since",
        name=rules.name,
        suggestion="another --output, or the rules as they were",
    )


def _tensors(model: Any) -> dict[str, Tensor]:
    policy, optimiser = model.policy.state_dict(), model.policy.optimizer.state_dict()["state"]
    tensors = {f"{_POLICY}{name}": tensor for name, tensor in policy.items()} | {
        f"{_OPTIMISER}{number}.{name}": tensor
        for number, moments in optimiser.items()
        for name, tensor in moments.items()
    }
    for name, seen in _statistics(model.get_vec_normalize_env()).items():
        for moment in _STATISTICS:
            tensors[f"{_SEEN}{name}.{moment}"] = torch.as_tensor(
                getattr(seen, moment), dtype=torch.float64
            )
    return {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}


def _model(
    path: Path, setup: Setup, streets: VecEnv, header: _Header, tensors: Mapping[str, Tensor]
) -> PPO:
    model = untrained_model(setup, streets)
    try:
        _check_names(tensors)
        model.policy.load_state_dict(_part(tensors, _POLICY))
        _load_moments(model, _part(tensors, _OPTIMISER))
        _load_statistics(model, _part(tensors, _SEEN))
    except (KeyError, ValueError, RuntimeError) as error:  # other tensors than the setup's
        raise _damaged(path, error) from None
    if not is_finite(model):
        raise _damaged(path, ValueError("not all of its numbers are finite"))
    model.num_timesteps, model._n_updates = header.steps, header.updates
    window = model._stats_window_size
    model.ep_info_buffer = deque((info.model_dump() for info in header.episodes), window)
    model.ep_success_buffer = deque(header.successes, window)
    return model


def _check_names(tensors: Mapping[str, Tensor]) -> None:
    if not all(name.startswith((_POLICY, _OPTIMISER, _SEEN)) for name in tensors):
        raise ValueError("there are tensors that are none of a training's")


def _part(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {
        name.removeprefix(prefix): tensor
        for name, tensor in tensors.items()
        if name.startswith(prefix)
    }


def _load_moments(model: PPO, tensors: Mapping[str, Tensor]) -> None:
    """Give a model's optimiser what it remembers.

    Raises:
        KeyError: something is missing.
        ValueError: there is too much, or a tensor does not fit its parameter.
    """
    state: dict[int, dict[str, Tensor]] = {}
    for number, parameter in enumerate(model.policy.parameters()):
        state[number] = {name: tensors[f"{number}.{name}"] for name in _MOMENTS}
        shapes = {name: moment.shape for name, moment in state[number].items()}
        if shapes != dict.fromkeys(_MOMENTS, parameter.shape) | {"step": torch.Size()}:
            raise ValueError(f"the optimiser's part {number} does not fit the setup's networks")
    if len(tensors) != len(state) * len(_MOMENTS):
        raise ValueError("there are tensors that are none of a training's")
    optimiser = model.policy.optimizer
    optimiser.load_state_dict({**optimiser.state_dict(), "state": state})


def _statistics(streets: VecNormalize) -> dict[str, RunningMeanStd]:
    """Return what normalised streets have seen, by names of ours."""
    return {"observations": cast(RunningMeanStd, streets.obs_rms), "returns": streets.ret_rms}


def _load_statistics(model: PPO, tensors: Mapping[str, Tensor]) -> None:
    """Give a model's streets what they have seen.

    Raises:
        KeyError: something is missing.
        ValueError: there is too much, or a tensor has another shape or is not finite.
    """
    statistics = _statistics(cast(VecNormalize, model.get_vec_normalize_env()))
    if len(tensors) != len(statistics) * len(_STATISTICS):
        raise ValueError("there are tensors that are none of a training's")
    for name, seen in statistics.items():
        mean, var, count = (tensors[f"{name}.{moment}"] for moment in _STATISTICS)
        if mean.shape != var.shape or mean.shape != np.shape(seen.mean) or count.ndim:
            raise ValueError(f"what was seen of {name} does not fit the setup's streets")
        if not all(bool(tensor.isfinite().all()) for tensor in (mean, var, count)):
            raise ValueError(f"not all that was seen of {name} is finite")
        seen.mean, seen.var, seen.count = mean.numpy(), var.numpy(), float(count)


def _damaged(path: Path, error: Exception) -> FileError:
    reason = first_reason(error)
    return FileError(f"'{path}' can't be read as a checkpoint: {reason}", name=str(path))
