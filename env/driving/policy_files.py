"""Trained policies as files: weights that run no code when loaded, and a card that says what it is.

A policy is ``<name>.safetensors``, its card ``<name>.json`` and, if it drives by VSR vectors, the
symbols that these are made of, ``<name>.codebook.safetensors``.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import torch
from gymnasium import spaces
from pydantic import BaseModel, ConfigDict
from safetensors.torch import save
from torch import Tensor, nn

from env.driving.setup import Setup
from env.street.observation import Observer, observer_of
from env.world.camera import DashCameraParameters
from sfol.errors import FileError
from vsr import tensor_files
from vsr.hypervectors.codebook import Codebook
from vsr.tensor_files import Header, Sha256


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
        sha256: of the file of weights; None before it is written.
        codebook_sha256: of the file of symbols; None if it has none.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    setup: Setup
    start_hash: str | None = None
    steps: int
    knowledge_base: str
    knowledge_base_hash: str
    evaluation: dict[str, float]
    versions: dict[str, str]
    sha256: Sha256 | None = None
    codebook_sha256: Sha256 | None = None


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
        """Write a policy: all of its files, or none.

        Args:
            card: what it is; the hashes of its files are added to it.
            model: PPO of stable-baselines3, with an `env.learning.actor_critic.ActorCritic`.
            codebook: the symbols that it was trained with; None where it observes no vector.

        Raises:
            UsageError: it can't be written.
        """
        weights = save(_actor_state(model, card.setup.learning.observation_scale))
        symbols = codebook.content() if codebook else None
        hashes = {
            "sha256": tensor_files.sha256(weights),
            "codebook_sha256": tensor_files.sha256(symbols) if symbols else None,
        }
        tensor_files.write_together(
            {
                **({self._codebook: symbols} if symbols else {}),
                self.path: weights,
                self._card: tensor_files.write_card(card.model_copy(update=hashes)),
            }
        )

    def card(self) -> PolicyCard:
        """Return the card.

        Raises:
            FileError: there is none, or it is incomplete.
        """
        return tensor_files.read_card(self._card, PolicyCard, "card of a policy")

    def load(self) -> tuple[Observer, nn.Module]:
        """Return what gives its observations, and its network, which takes the last ones of them.

        Raises:
            FileError: as `network` and `codebook` do.
        """
        setup = self.card().setup
        codebook = self.codebook() if setup.observation == "vsr" else None
        side = DashCameraParameters().size
        observer = observer_of(setup.observation, side, setup.fusion, codebook, speed=setup.speed)
        (numbers,) = cast(spaces.Box, observer.space).shape
        return observer, self.network(setup.frames * numbers)

    def network(self, inputs: int | None = None) -> nn.Module:
        """Return the network: observations, float32 (B, N), to pedals, float32 (B, 1).

        Args:
            inputs: N; if None, whatever the file has.

        Raises:
            FileError: the file or the card can't be read, they do not belong together, the weights
                are not those of such a network, or a number is not finite.
        """
        card, header = self.card(), tensor_files.read_header(self.path)
        tensor_files.check_belongs(self.path, card.sha256, self._card)
        widths = [inputs or _inputs(header), *card.setup.learning.layers, 1]
        with torch.device("meta"):  # which has no memory: the card may say anything
            expected = tensor_files.kinds_of(_perceptron(widths).state_dict())
        difference = tensor_files.misfit(header, expected)
        if difference:
            raise FileError(
                f"'{self.path}' holds no policy as its card says: {difference}",
                name=str(self.path),
                suggestion="its card says layers, frames and observation",
            )
        network = _perceptron(widths)
        network.load_state_dict(tensor_files.load_finite(self.path))
        return network.eval().requires_grad_(False)

    def codebook(self) -> Codebook:
        """Return the symbols of its observations.

        Raises:
            FileError: there is no such file, it can't be read, or it is another policy's.
        """
        codebook = Codebook.load(self._codebook)
        tensor_files.check_belongs(self._codebook, self.card().codebook_sha256, self._card)
        return codebook


def _inputs(header: Header) -> int:
    """Return how many numbers a file's first layer takes; 1 if it says no such thing."""
    match header.tensors.get("0.weight"):
        case (_, (_, int(inputs))):
            return max(inputs, 1)
    return 1


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
