"""Trained weights on disk: a safetensors file, and a card beside it that says what they are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from pydantic import BaseModel, ConfigDict
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor, nn

from sfol.errors import UsageError
from sfol.reading import first_reason
from sfol.writing import replacing


class TrainedOn(BaseModel):
    """The frames that a network has learnt from.

    Attributes:
        renderer: what drew them; a network is valid for frames of this one.
        camera: the lens: ``size`` in px, ``fov`` in degrees, ``height`` in m.
        train: the card of the training frames: source, seeds, command.
        validation: the card of the validation frames.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    renderer: str
    camera: dict[str, float]
    train: dict[str, Any]
    validation: dict[str, Any]


class Card(BaseModel):
    """What there is to know of a file of weights.

    Attributes:
        network: ``segmenter`` or ``autoencoder``.
        architecture: in words.
        weights: type of the numbers in the file.
        trained_on: the frames.
        schedule: how the training went: seed, steps, batch, learning rate, minutes.
        metrics: figures of the validation frames, for the weights as they are in the file.
        command: what made the file.
        started_from: the card of the weights that the training began with, if it did.
        versions: of the libraries.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    network: str
    architecture: str
    weights: str
    trained_on: TrainedOn
    schedule: dict[str, Any]
    metrics: dict[str, float]
    command: str
    started_from: dict[str, Any] | None = None
    versions: dict[str, str]


def halved(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """Return the weights in float16 wherever float16 reaches that far."""
    return {name: _half(tensor) for name, tensor in state.items()}


def _half(tensor: Tensor) -> Tensor:
    if not tensor.is_floating_point():
        return tensor
    half = tensor.to(torch.float16)
    return half if torch.isfinite(half).all() else tensor


def save_weights(folder: Path, card: Card, state: dict[str, Tensor]) -> Path:
    """Write ``<network>.safetensors`` and the card ``<network>.json`` beside it.

    Args:
        folder: where; made if need be.
        card: what the weights are.
        state: a network's state by names.

    Returns:
        The file of weights.

    Raises:
        UsageError: they can't be written.
    """
    file = folder / f"{card.network}.safetensors"
    plain = {name: tensor.detach().cpu().contiguous() for name, tensor in state.items()}
    with replacing(file) as part:
        part.write_bytes(save(plain))
    with replacing(_card_of(file)) as part:
        part.write_text(card.model_dump_json(indent=2) + "\n", encoding="utf-8")
    return file


def load_weights(file: Path, network: nn.Module) -> Card:
    """Put the weights of a file into a network, as float32.

    Args:
        file: what `save_weights` wrote, its card beside it.
        network: of the architecture that the weights belong to.

    Returns:
        The card.

    Raises:
        UsageError: file or card can't be read, or belong to another network.
    """
    card = read_card(file)
    try:
        network.load_state_dict(load_file(file))
    except (OSError, SafetensorError) as error:
        raise UsageError(f"'{file}' can't be read: {error}", name=str(file)) from None
    except RuntimeError as error:
        raise UsageError(
            f"'{file}' holds weights of another network: {first_reason(error)}",
            name=str(file),
            suggestion=f"its card says {card.architecture}",
        ) from None
    return card


def read_card(file: Path) -> Card:
    """Return the card of a file of weights.

    Raises:
        UsageError: there is none, or it is incomplete.
    """
    path = _card_of(file)
    try:
        return Card.model_validate(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        reason = first_reason(error)
        raise UsageError(f"'{path}' is no card of weights: {reason}", name=str(path)) from None


def _card_of(file: Path) -> Path:
    return file.with_suffix(".json")
