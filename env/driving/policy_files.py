"""Trained policies as files: weights that run no code when loaded, and a card that says what it is.

A policy is ``<name>.safetensors``, its card ``<name>.json`` and, if it drives by VSR vectors, the
symbols that these are made of, ``<name>.codebook.safetensors``.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import torch
from pydantic import BaseModel, ConfigDict, ValidationError
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor, nn

from env.driving.setup import Setup
from sfol.errors import FileError
from sfol.reading import first_reason
from sfol.writing import replacing
from vsr.hypervectors.codebook import Codebook


class PolicyCard(BaseModel):
    """What there is to know of a trained policy.

    Attributes:
        setup: what it was trained as: rules, observation, fusion, streets, hyperparameters.
        start_hash: of the file of the policy that its training started from; None if from nothing.
        steps: of all streets together, that it was trained for.
        knowledge_base: the name of that which rewarded it.
        knowledge_base_hash: of its content.
        evaluation: how it drove on streets that training did not see.
        versions: of the software that trained it.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    setup: Setup
    start_hash: str | None = None
    steps: int
    knowledge_base: str
    knowledge_base_hash: str
    evaluation: dict[str, float]
    versions: dict[str, str]


class PolicyFile:
    """The files of a policy.

    Args:
        path: of the weights, ending in ``.safetensors``.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._card = path.with_suffix(".json")
        self._codebook = path.with_suffix(".codebook.safetensors")

    def write(self, card: PolicyCard, model: Any, codebook: Codebook | None = None) -> None:
        """Write a policy, its weights last.

        Args:
            card: what it is.
            model: PPO of stable-baselines3, with an `env.learning.actor_critic.ActorCritic`.
            codebook: the symbols that it was trained with; None where it observes no vector.
        """
        if codebook is not None:
            codebook.save(self._codebook)
        with replacing(self._card) as part:
            part.write_text(card.model_dump_json(indent=2) + "\n", encoding="utf-8")
        with replacing(self.path) as part:
            part.write_bytes(save(_actor_state(model, card.setup.learning.observation_scale)))

    def card(self) -> PolicyCard:
        """Return the card.

        Raises:
            FileError: there is none, or it is incomplete.
        """
        try:
            return PolicyCard.model_validate_json(self._card.read_bytes())
        except (OSError, ValidationError) as error:
            raise FileError(
                f"'{self._card}' is no card of a policy: {first_reason(error)}",
                name=str(self._card),
            ) from None

    def network(self) -> nn.Module:
        """Return the network: observations, float32 (B, N), to pedals, float32 (B, 1).

        Raises:
            FileError: the file or the card can't be read, or holds something else.
        """
        try:
            state = load_file(self.path)
        except (OSError, SafetensorError) as error:
            raise FileError(
                f"'{self.path}' can't be read: {first_reason(error)}", name=str(self.path)
            ) from None
        try:
            observed = state["0.weight"].shape[1]
            network = _perceptron([observed, *self.card().setup.learning.layers, 1])
            network.load_state_dict(state)
        except (KeyError, IndexError, RuntimeError) as error:
            raise FileError(
                f"'{self.path}' holds no policy: {first_reason(error)}", name=str(self.path)
            ) from None
        return network.eval().requires_grad_(False)

    def codebook(self) -> Codebook:
        """Return the symbols of its observations.

        Raises:
            UsageError: there is no such file, or it can't be read.
        """
        return Codebook.load(self._codebook)


def actor_of(model: Any) -> nn.Sequential:
    """Return what chooses the most likely actions; its names are those of `_perceptron`."""
    return nn.Sequential(*model.policy.mlp_extractor.policy_net, model.policy.action_net)


def load_actor(model: Any, file: PolicyFile, setup: Setup) -> None:
    """Let a model choose the actions that a written policy does.

    What the model is given and the policy is not, ego's speed or earlier frames, has no weight in
    the beginning.

    Args:
        model: PPO of stable-baselines3, with an `env.learning.actor_critic.ActorCritic` whose
            layers are as wide as the policy's, not whitened.
        file: of the policy.
        setup: of the model; its observation has all that the policy is given.

    Raises:
        UsageError: the file can't be read, or holds something else.
    """
    state, actor = file.network().state_dict(), actor_of(model)
    inputs = cast(nn.Linear, actor[0]).in_features
    weight = _widened(state["0.weight"], file.card().setup.frames, inputs, setup.frames)
    actor.load_state_dict({**state, "0.weight": weight / setup.learning.observation_scale})


def _widened(weight: Tensor, frames: int, inputs: int, new_frames: int) -> Tensor:
    """Return a layer's weights for more frames, and for more numbers at the end of each.

    Args:
        weight: float (H, N), for that many frames, the last one last.
        frames: divides N.
        inputs: of the layer that is returned, float (H, inputs).
        new_frames: divides them.
    """
    old = weight.unflatten(1, (frames, -1))
    new = weight.new_zeros(len(weight), new_frames, inputs // new_frames)
    new[:, new_frames - frames :, : old.shape[2]] = old
    return new.flatten(1)


def _actor_state(model: Any, scale: float) -> dict[str, Tensor]:
    """Return the weights of `actor_of` a model.

    The model was trained on observations that were scaled and whitened; these weights take them as
    they are.
    """
    actor, whitening = actor_of(model), model.policy.mlp_extractor.whitening
    state = {name: tensor.detach().cpu().clone() for name, tensor in actor.state_dict().items()}
    if whitening is not None:
        state["0.weight"], state["0.bias"] = whitening.folded(state["0.weight"], state["0.bias"])
    state["0.weight"] *= scale
    return state


def _perceptron(widths: list[int]) -> nn.Sequential:
    """Return linear layers with tanh between them, as the ``MlpPolicy`` has them."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(widths):
        layers += [nn.Linear(inputs, outputs), nn.Tanh()]
    return nn.Sequential(*layers[:-1])


def act(network: nn.Module, observation: Any) -> float:
    """Return the pedal that a policy's network chooses, in [-1, 1].

    Args:
        network: from `PolicyFile.network`.
        observation: float32 (N,).
    """
    with torch.inference_mode():
        (pedal,) = network(torch.from_numpy(observation).unsqueeze(0))
    return float(pedal.clamp(-1.0, 1.0))
