"""The training loop: batches by seed, one learning-rate cycle, checkpoints, early stopping."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from torch import Tensor, nn
from torch.utils.tensorboard import SummaryWriter

from sfol.cli.output import escaped
from sfol.errors import UsageError
from sfol.reading import opened
from sfol.writing import replacing

Metrics = dict[str, float]


class Task(Protocol):
    """What is to be learnt."""

    network: nn.Module
    size: int  # how many training frames there are

    def loss(self, indices: Tensor, rng: torch.Generator, progress: float) -> Tensor:
        """Return the loss of a batch of training frames.

        Args:
            indices: int64 (B,), which frames.
            rng: for augmentation.
            progress: how far the training is, 0 to 1.
        """
        ...

    def validate(self) -> Metrics:
        """Return figures of the validation frames; ``score`` among them, the higher the better."""
        ...


@dataclass(frozen=True)
class Schedule:
    """How long and how fast to learn.

    The learning rate rises over the first tenth and falls to almost nothing at the end (Smith and
    Topin, "Super-convergence", 2019).

    Attributes:
        epochs: passes over the frames.
        minutes: ends earlier when that much time is used, None for no limit. The learning rate
            follows whichever runs out first, so that it always ends low.
        batch: frames a step.
        learning_rate: the highest.
        weight_decay: of AdamW.
        patience: validations without a better score before the training stops.
        validations: how many there are in an epoch.
        seed: decides order and augmentation.
    """

    epochs: int = 3
    minutes: float | None = None
    batch: int = 8
    learning_rate: float = 1.5e-3
    weight_decay: float = 1e-2
    patience: int = 6
    validations: int = 2
    seed: int = 0


@dataclass
class _Course:
    """How far a training is."""

    step: int = 0
    seconds: float = 0.0
    best: float = -math.inf
    stale: int = 0
    history: list[Metrics] = field(default_factory=list)


class Training:
    """A training that can be stopped at any time and goes on from its last checkpoint.

    A step's batch and augmentation follow from the seed and its number alone, so that a training
    that was interrupted takes the same steps as one that was not. (With `minutes` the learning
    rate depends on the clock.)

    Args:
        task: what is learnt.
        schedule: how long and how fast.
        folder: for checkpoints, the best weights so far and tensorboard's scalars.
        console: where the progress bar goes.
    """

    def __init__(
        self, task: Task, schedule: Schedule, folder: Path, console: Console | None = None
    ) -> None:
        self.task = task
        self.schedule = schedule
        self._folder = folder
        self._console = console or Console(stderr=True)
        self._course = _Course()
        self._optimiser = torch.optim.AdamW(
            task.network.parameters(), schedule.learning_rate, weight_decay=schedule.weight_decay
        )
        self._steps_an_epoch = task.size // schedule.batch
        if not self._steps_an_epoch:
            raise UsageError(
                f"{task.size} frames do not fill a batch of {schedule.batch}", name="batch"
            )
        self.steps = schedule.epochs * self._steps_an_epoch
        self._between_validations = max(self._steps_an_epoch // schedule.validations, 1)

    @property
    def best_weights(self) -> Path:
        """Where the weights with the best validation score are."""
        return self._folder / "best.pt"

    @property
    def history(self) -> list[Metrics]:
        """What each validation gave."""
        return self._course.history

    @property
    def seconds(self) -> float:
        """Time spent so far, earlier runs included."""
        return self._course.seconds

    def run(self, checkpoint_every: float = 240.0) -> None:
        """Train to the end, from the last checkpoint if there is one.

        Args:
            checkpoint_every: seconds between checkpoints; validations make one too.
        """
        self._folder.mkdir(parents=True, exist_ok=True)
        self._resume()
        course, saved = self._course, time.monotonic()
        with SummaryWriter(str(self._folder)) as board, self._bar() as bar:
            shown = bar.add_task("training", total=1.0, note="")
            while self._progress() < 1.0 and course.stale < self.schedule.patience:
                started = time.monotonic()
                loss = self._step()
                course.step += 1
                course.seconds += time.monotonic() - started
                board.add_scalar("loss", loss, course.step)
                board.add_scalar("learning_rate", self._learning_rate(), course.step)
                bar.update(shown, completed=self._progress(), note=f"loss {loss:.4f}")
                if course.step % self._between_validations == 0 or self._progress() >= 1.0:
                    self._validate(board)
                    saved = self._save()
                elif time.monotonic() - saved > checkpoint_every:
                    saved = self._save()

    def _step(self) -> float:
        rng = torch.Generator().manual_seed(self.schedule.seed * 1_000_003 + self._course.step)
        self.task.network.train()
        for group in self._optimiser.param_groups:
            group["lr"] = self._learning_rate()
        loss = self.task.loss(self._batch(), rng, self._progress())
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.task.network.parameters(), 5.0)
        self._optimiser.step()
        return float(loss.detach())

    def _batch(self) -> Tensor:
        epoch, position = divmod(self._course.step, self._steps_an_epoch)
        order = np.random.default_rng([self.schedule.seed, epoch]).permutation(self.task.size)
        start = position * self.schedule.batch
        return torch.from_numpy(order[start : start + self.schedule.batch])

    def _progress(self) -> float:
        by_steps = self._course.step / self.steps
        if self.schedule.minutes is None:
            return by_steps
        return max(by_steps, self._course.seconds / (60.0 * self.schedule.minutes))

    def _learning_rate(self) -> float:
        progress, top = min(self._progress(), 1.0), self.schedule.learning_rate
        if progress < 0.1:
            return top * (0.04 + 0.96 * progress / 0.1)
        return top * (0.002 + 0.998 * 0.5 * (1.0 + math.cos(math.pi * (progress - 0.1) / 0.9)))

    def _validate(self, board: SummaryWriter) -> None:
        course = self._course
        started = time.monotonic()
        self.task.network.eval()
        with torch.inference_mode():
            metrics = self.task.validate()
        course.seconds += time.monotonic() - started
        for name, value in metrics.items():
            board.add_scalar(f"validation/{name}", value, course.step)
        course.history.append({"step": course.step, "seconds": round(course.seconds), **metrics})
        figures = ", ".join(f"{name} {value:.4f}" for name, value in metrics.items())
        self._console.print(f"step {course.step} of {self.steps}: {figures}")
        if metrics["score"] > course.best:
            course.best, course.stale = metrics["score"], 0
            _write(self.best_weights, self.task.network.state_dict())
        else:
            course.stale += 1

    def _save(self) -> float:
        state = {
            "settings": self._settings(),
            "network": self.task.network.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "course": vars(self._course),
        }
        _write(self._folder / f"checkpoint-{self._course.step:07}.pt", state)
        for old in self._checkpoints()[2:]:
            old.unlink()
        return time.monotonic()

    def _resume(self) -> None:
        for file in self._checkpoints():
            state = self._read(file)
            if state is None:
                continue
            if state["settings"] != self._settings():
                raise UsageError(
                    f"{file} belongs to a training with {state['settings']}",
                    name=str(file),
                    suggestion="delete its folder to begin anew, or name another",
                )
            self.task.network.load_state_dict(state["network"])
            self._optimiser.load_state_dict(state["optimiser"])
            self._course = _Course(**state["course"])
            self._console.print(escaped(f"going on from {file}"))
            return

    def _read(self, file: Path) -> dict[str, Any] | None:
        try:
            with opened(file, "checkpoint") as content:
                state: dict[str, Any] = torch.load(content, map_location="cpu", weights_only=True)
        except Exception as error:  # a damaged file may raise anything
            damage = f"{file} is damaged and passed over: {type(error).__name__}"
            self._console.print(escaped(damage))
            return None
        return state

    def _settings(self) -> dict[str, Any]:
        """Return what may not change between the parts of one training."""
        schedule = self.schedule
        return {
            "frames": self.task.size,
            "batch": schedule.batch,
            "learning_rate": schedule.learning_rate,
            "seed": schedule.seed,
        }

    def _checkpoints(self) -> list[Path]:
        """Return the checkpoints, latest first."""
        return sorted(self._folder.glob("checkpoint-*.pt"), reverse=True)

    def _bar(self) -> Progress:
        return Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f} % {task.fields[note]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self._console,
        )


def _write(file: Path, state: Any) -> None:
    with replacing(file) as part:
        torch.save(state, part)


def batches(size: int, batch: int) -> Iterator[slice]:
    """Yield the slices that cut `size` frames into batches."""
    return (slice(start, start + batch) for start in range(0, size, batch))
