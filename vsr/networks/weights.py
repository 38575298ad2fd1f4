"""Trained weights on disk: a safetensors file, and a card beside it that says what they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import torch
from pydantic import BaseModel, ConfigDict
from safetensors.torch import save
from torch import Tensor, nn

from sfol.errors import FileError
from vsr import tensor_files
from vsr.tensor_files import Sha256


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
        sha256: of the file of weights; None before it is written.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    network: Literal["segmenter", "autoencoder"]
    architecture: str
    weights: str
    trained_on: TrainedOn
    schedule: dict[str, Any]
    metrics: dict[str, float]
    command: str
    started_from: dict[str, Any] | None = None
    versions: dict[str, str]
    sha256: Sha256 | None = None


def halved(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """Return the weights in float16 wherever float16 reaches that far."""
    return {name: _half(tensor) for name, tensor in state.items()}


def _half(tensor: Tensor) -> Tensor:
    if not tensor.is_floating_point():
        return tensor
    half = tensor.to(torch.float16)
    return half if torch.isfinite(half).all() else tensor


def save_weights(folder: Path, card: Card, state: dict[str, Tensor]) -> Path:
    """Write ``<network>.safetensors`` and, if that can be written, ``<network>.json`` beside it.

    Args:
        folder: where; made if need be.
        card: what the weights are; their hash is added to it.
        state: a network's state by names.

    Returns:
        The file of weights.

    Raises:
        UsageError: they can't be written.
    """
    file = folder / f"{card.network}.safetensors"
    weights = save({name: tensor.detach().cpu().contiguous() for name, tensor in state.items()})
    written = card.model_copy(update={"sha256": tensor_files.sha256(weights)})
    tensor_files.write_together({file: weights, _card_of(file): tensor_files.write_card(written)})
    return file


def load_weights(file: Path, network: nn.Module) -> Card:
    """Put the weights of a file into a network, as float32.

    Args:
        file: what `save_weights` wrote, its card beside it.
        network: of the architecture that the weights belong to.

    Returns:
        The card.

    Raises:
        FileError: file or card can't be read, do not belong together or belong to another network,
            or a number is not finite.
    """
    card, header = read_card(file), tensor_files.read_header(file)
    tensor_files.check_belongs(file, card.sha256, _card_of(file))
    difference = tensor_files.misfit(header, tensor_files.kinds_of(network.state_dict()))
    if difference:
        raise FileError(
            f"'{file}' holds weights of another network: {difference}",
            name=str(file),
            suggestion=f"its card says {card.architecture}",
        )
    network.load_state_dict(tensor_files.load_finite(file))
    return card


def read_card(file: Path) -> Card:
    """Return the card of a file of weights.

    Raises:
        FileError: there is none, or it is incomplete.
    """
    return tensor_files.read_card(_card_of(file), Card, "card of weights")


def _card_of(file: Path) -> Path:
    return file.with_suffix(".json")
