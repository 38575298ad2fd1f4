"""From a finished training to a file of weights with its card."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from sfol.errors import UsageError
from sfol.reading import opened
from vsr.networks.weights import Card, TrainedOn, halved, save_weights
from vsr.training.frames import FrameSet
from vsr.training.loop import Metrics, Task, Training

_LIBRARIES = ("torch", "torchvision", "segmentation-models-pytorch", "safetensors", "numpy")
# What rounding to float16 may cost, as a share of the validation score.
_NOT_MEASURABLE = 1e-3


def ship(training: Training, output: Path, description: Mapping[str, Any]) -> Path:
    """Write the best weights of a finished training with their card.

    Args:
        training: after its run.
        output: folder for the weights.
        description: the card's parts that the training doesn't know.

    Returns:
        The file of weights: float16 where rounding costs nothing that validation can measure.
    """
    with opened(training.best_weights, "checkpoint") as content:
        best = torch.load(content, map_location="cpu", weights_only=True)
    state, metrics = _smallest(training.task, best)
    card = Card(
        weights=_type_of(state),
        schedule={
            **asdict(training.schedule),
            "steps": training.history[-1]["step"],
            "minutes_spent": round(training.seconds / 60.0),
        },
        metrics=metrics,
        versions={
            "python": platform.python_version(),
            **{name: version(name) for name in _LIBRARIES},
        },
        **description,
    )
    return save_weights(output, card, state)


def trained_on(train: FrameSet, validation: FrameSet) -> TrainedOn:
    """Return what a card says about the frames.

    Raises:
        UsageError: frames to learn from and frames to validate on are of different kinds, or the
            same streets are among both.
    """
    for key in ("renderer", "camera"):
        first, second = (frames.card.get(key) for frames in (train, validation))
        if first is None or first != second:
            raise UsageError(
                f"training frames have the {key} {first}, those for validation {second}", name=key
            )
    if set(train.streets) & set(validation.streets):
        raise UsageError("a street is in both training and validation frames", name="data")
    return TrainedOn(
        renderer=train.card["renderer"],
        camera=train.card["camera"],
        train=_own(train),
        validation=_own(validation),
    )


def _own(frames: FrameSet) -> dict[str, Any]:
    shared = ("renderer", "camera")
    own = {name: value for name, value in frames.card.items() if name not in shared}
    return {**own, "frames": len(frames)}


def _smallest(task: Task, state: dict[str, Tensor]) -> tuple[dict[str, Tensor], Metrics]:
    """Return the state in float16 if that costs nothing, else as it is, and its figures."""
    whole, half = _validated(task, state), _validated(task, halved(state))
    if half["score"] >= whole["score"] * (1.0 - _NOT_MEASURABLE):
        return halved(state), half
    return state, whole


def _validated(task: Task, state: dict[str, Tensor]) -> Metrics:
    task.network.load_state_dict(state)
    task.network.eval()
    with torch.inference_mode():
        return {name: round(value, 4) for name, value in task.validate().items()}


def _type_of(state: dict[str, Tensor]) -> str:
    largest = max(state.values(), key=torch.numel)
    return str(largest.dtype).removeprefix("torch.")
