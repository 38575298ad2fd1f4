"""Trained policies as files: weights that run no code when loaded, and a card that says what it is.

A policy is ``<name>.safetensors``, its card ``<name>.json`` and, if it drives by VSR vectors, the
symbols that these are made of, ``<name>.codebook.safetensors``.
"""

from __future__ import annotations

from collections import OrderedDict
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import torch
from gymnasium import spaces
from pydantic import BaseModel, ConfigDict, Field, JsonValue, PositiveInt
from safetensors.torch import save
from torch import Tensor, nn

from env.driving.setup import Setup
from env.street.observation import Observer, observer_of
from env.world.camera import DashCameraParameters
from sfol.errors import FileError
from vsr import tensor_files
from vsr.hypervectors.codebook import Codebook
from vsr.hypervectors.methods import Method
from vsr.tensor_files import Header, Sha256

CLIP = 10.0  # deviations from the mean; what VecNormalize of stable-baselines3 has by default


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Interface(_Section):
    """What a policy is given, how long its actions last, and how its network is made.

    Attributes:
        observation: see `env.driving.setup.Setup`, as for the next ones.
        fusion: of SSI and SF.
        unit_rms: whether entities' vectors are scaled.
        speed: whether ego's speed is added.
        frames: how many observations are given together.
        decision_steps: control steps that an action is held.
        layers: widths of the hidden layers.
        standardised: whether observations are standardised by numbers in the file first, as in
            all policies but the first that there were.
    """

    observation: Literal["vsr", "state"]
    fusion: Method = "add"
    unit_rms: bool = True
    speed: bool = False
    frames: PositiveInt = 1
    decision_steps: PositiveInt = 1
    layers: tuple[Annotated[int, Field(gt=0, le=4096)], ...] = Field(max_length=8)
    standardised: bool = False

    @classmethod
    def of(cls, setup: Setup) -> Interface:
        """Return that of the policy that a setup trains."""
        return cls(
            observation=setup.observation,
            fusion=setup.fusion,
            unit_rms=setup.unit_rms,
            speed=setup.speed,
            frames=setup.frames,
            decision_steps=setup.decision_steps,
            layers=setup.learning.layers,
            standardised=True,
        )


class PolicyCard(_Section):
    """What there is to know of a trained policy.

    Attributes:
        interface: all that driving by it needs.
        training: what it was trained as, as setups were written then.
        start_hash: of the file of the policy that its training started from; None if from nothing.
        steps: decisions of all streets together, that it was trained for.
        knowledge_base: the name of that which rewarded it.
        knowledge_base_hash: of its content.
        evaluation: how it drove on streets that training did not see.
        versions: of the software that trained it.
        sha256: of the file of weights; None before it is written.
        codebook_sha256: of the file of symbols; None if it has none.
    """

    interface: Interface
    training: dict[str, JsonValue]
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

    def write(self, card: PolicyCard, network: nn.Module, codebook: Codebook | None = None) -> None:
        """Write a policy: all of its files, or none.

        Args:
            card: what it is; the hashes of its files are added to it.
            network: from `policy_network`, as the card's interface says.
            codebook: the symbols that it was trained with; None where it observes no vector.

        Raises:
            UsageError: it can't be written.
        """
        state = network.state_dict()
        weights = save({name: tensor.cpu().contiguous() for name, tensor in state.items()})
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
        given = self.card().interface
        codebook = self.codebook() if given.observation == "vsr" else None
        side = DashCameraParameters().size
        observer = observer_of(
            given.observation,
            side,
            given.fusion,
            codebook,
            speed=given.speed,
            unit_rms=given.unit_rms,
        )
        (numbers,) = cast(spaces.Box, observer.space).shape
        return observer, self.network(given.frames * numbers)

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
        inputs = inputs or _inputs(header)
        with torch.device("meta"):  # which has no memory: the card may say anything
            expected = tensor_files.kinds_of(policy_network(inputs, card.interface).state_dict())
        difference = tensor_files.misfit(header, expected)
        if difference:
            raise FileError(
                f"'{self.path}' holds no policy as its card says: {difference}",
                name=str(self.path),
                suggestion="its card says layers, frames and observation",
            )
        network = policy_network(inputs, card.interface)
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


class Standardised(nn.Module):
    """z = (x - mean) / deviation, at most `CLIP` from 0: observations as a policy learnt from them.

    Args:
        size: N, how many numbers an observation has.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("deviation", torch.ones(size))

    def forward(self, observations: Tensor) -> Tensor:
        """Return z of observations, float (B, N)."""
        return ((observations - self.mean) / self.deviation).clamp(-CLIP, CLIP)


def policy_network(inputs: int, interface: Interface) -> nn.Sequential:
    """Return an untrained network: linear layers with tanh between them, as ``MlpPolicy`` has them.

    Args:
        inputs: N, how many numbers it is given.
        interface: says layers, and whether it standardises what it is given.
    """
    widths = [inputs, *interface.layers, 1]
    layers: list[nn.Module] = []
    for width, outputs in pairwise(widths):
        layers += [nn.Linear(width, outputs), nn.Tanh()]
    parts = OrderedDict((str(number), layer) for number, layer in enumerate(layers[:-1]))
    if interface.standardised:
        parts["standardised"] = Standardised(inputs)
        parts.move_to_end("standardised", last=False)
    return nn.Sequential(parts)


def act(network: nn.Module, observation: Any) -> float:
    """Return the pedal that a policy's network chooses, in [-1, 1].

    Args:
        network: from `PolicyFile.network`.
        observation: float32 (N,).
    """
    with torch.inference_mode():
        (pedal,) = network(torch.from_numpy(observation).unsqueeze(0))
    return float(pedal.clamp(-1.0, 1.0))
