"""Setups: what is trained, on which streets, as data that people edit."""

from __future__ import annotations

import hashlib
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from env.world.cells import Cell, CellOcclusion, Traffic
from sfol import strict_yaml
from sfol.data_folder import data_folder
from sfol.errors import UsageError, did_you_mean
from sfol.strict_yaml import Document
from vsr.hypervectors.methods import Method

_FOLDER = data_folder(Path(__file__).resolve().parents[1], "setups")

# γ of a return. With 0.99, 10 s count, and a quick collision was worth more than standing still.
DISCOUNT = 0.997
MEASURED_AT_LEAST = 128  # observations, to whiten them

Positive = Annotated[int, Field(gt=0)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Stage(_Section):
    """A part of the training, with the cells that its episodes are drawn from."""

    steps: Positive = Field(description="steps of all streets together")
    traffic: tuple[Traffic, ...] = Field(
        min_length=1,
        description="levels to draw from; one that is named twice comes twice as often",
    )
    occlusion: tuple[CellOcclusion, ...] = Field(
        ("partial", "full"), min_length=1, description="kinds of occlusion to draw from"
    )

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Every combination of its traffic and occlusion."""
        return tuple(Cell(*cell) for cell in product(self.traffic, self.occlusion))


class Learning(_Section):
    """Hyperparameters of PPO, by the names of stable-baselines3 where it has them.

    With fewer steps between updates, what a policy has learnt of collisions is lost again and
    again. With noise that is new at every step, throttle and brake cancel out, and the brake is the
    stronger: ego stands.
    """

    learning_rate: float = Field(2e-4, gt=0, description="at the beginning")
    last_learning_rate: float = Field(
        2e-5, gt=0, description="at the end; from the first to the last it falls evenly"
    )
    rollout_steps: Positive = Field(4096, description="of all streets, for one update")
    batch_size: Positive = Field(256, description="steps for one gradient")
    n_epochs: Positive = Field(4, description="passes over the steps of an update")
    gamma: float = Field(DISCOUNT, gt=0, le=1, description="γ, the discount of a step")
    gae_lambda: float = Field(0.95, ge=0, le=1, description="λ of generalised advantage estimation")
    clip_range: float = Field(
        0.2, gt=0, description="how far the ratio of new to old probabilities may be from 1"
    )
    ent_coef: float = Field(0.0, ge=0, description="factor on the policy's entropy in the loss")
    use_sde: bool = Field(
        default=True,
        description="whether noise depends on the state and lasts for steps",
    )
    sde_sample_freq: int = Field(
        8, ge=-1, description="how many steps noise lasts for; -1: until the next update"
    )
    reward_scale: float = Field(
        0.02, gt=0, description="factor on rewards, so that returns are of the order of 1"
    )
    observation_scale: float = Field(
        1.0, gt=0, description="factor on observations, so that the first layer is not saturated"
    )
    whitening_steps: int = Field(
        0,
        ge=0,
        description="driven before the first update to measure how observations vary, so that "
        "learning sees all that varies alike; 0: observations are taken as they are",
    )
    value_steps: Positive = Field(
        8192,
        description="where a training starts from a policy: driven before the first update, in "
        "whole rollouts, to learn what the policy is worth",
    )
    mean_init: float = Field(
        0.2, ge=-1, le=1, description="the actions' first mean; at 0 the brake wins, and ego stands"
    )
    log_std_init: float = Field(-1.0, description="logarithm of the actions' first deviation")
    last_log_std: float | None = Field(
        None,
        description="the greatest that it may be at the end; the limit falls evenly from the first "
        "to this, so that a policy learns to drive without noise, as it will; null: no limit",
    )
    layers: tuple[Annotated[int, Field(gt=0, le=4096)], ...] = Field(
        (64, 64), max_length=8, description="of policy and value networks"
    )


class Setup(_Section):
    """A training: its street, its reward, its observation and its hyperparameters."""

    version: Literal[1] = Field(description="version of this format")
    name: str = Field(
        pattern=r"^[a-z0-9_]+$",
        max_length=64,
        description="name of the setup and of its trainings' folders: a to z, digits, _",
    )
    description: str = Field("", description="what it is for")
    rules: tuple[str, ...] = Field(
        ("crossing",), min_length=1, description="knowledge bases, applied left to right"
    )
    observation: Literal["vsr", "state"] = Field("vsr", description="what the policy is given")
    perception: Literal["simulator", "unet", "truth"] = Field(
        "simulator", description="where facts come from"
    )
    fusion: Method = Field("add", description="how SSI and SF are fused, for the observation vsr")
    speed: bool = Field(
        default=False, description="whether ego's speed is added to the observation vsr"
    )
    frames: int = Field(
        1,
        gt=0,
        le=64,
        description="how many observations, the last ones, a policy is given together",
    )
    critic: Literal["state", "observation"] = Field(
        "observation",
        # So setups from before there was a choice have the hashes that their results name.
        exclude_if=lambda critic: critic == "observation",
        description="what the value function, which training alone needs, is given: the world's "
        "state, or what the policy is given",
    )
    stages: tuple[Stage, ...] = Field(
        min_length=1, description="parts of the training, one after the other"
    )
    streets: Positive = Field(2, description="how many are driven at once, each in its own process")
    seed: int = Field(
        0, ge=0, lt=2**32, description="seed of the streets, the networks and the noise"
    )
    start: str | None = Field(
        None,
        description="the policy that training starts from, a .safetensors file or trained; it may "
        "be given less than the setup says, and nothing is whitened then; null: from nothing",
    )
    checkpoint_steps: Positive = Field(10_000, description="steps between two checkpoints")
    evaluation_steps: Positive = Field(20_000, description="steps between two evaluations")
    evaluation_episodes: Positive = Field(
        20, description="episodes of an evaluation, over all cells"
    )
    learning: Learning = Field(Learning(), description="hyperparameters of PPO")

    @model_validator(mode="after")
    def _state_has_speed(self) -> Self:
        if self.speed and self.observation == "state":
            raise ValueError("the observation state has ego's speed anyway: leave speed out")
        return self

    @model_validator(mode="after")
    def _whitening_is_measured(self) -> Self:
        if 0 < self.learning.whitening_steps < MEASURED_AT_LEAST:
            raise ValueError(
                f"{self.learning.whitening_steps} steps tell too little of how observations vary: "
                f"choose {MEASURED_AT_LEAST} or more, or 0"
            )
        return self

    @model_validator(mode="after")
    def _streets_share_the_rollout(self) -> Self:
        if self.learning.rollout_steps % self.streets:
            raise ValueError(
                f"{self.learning.rollout_steps} steps for an update are not the same for each of "
                f"{self.streets} streets: choose a multiple"
            )
        return self

    @property
    def hash(self) -> str:
        """12 hexadecimal digits of the SHA-256 of all that it says."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()[:12]

    @property
    def privileged(self) -> bool:
        """Whether the value function is given what the policy is not."""
        return self.critic == "state" and self.observation != "state"

    @property
    def steps(self) -> int:
        """Steps of the whole training."""
        return sum(stage.steps for stage in self.stages)

    def stage_at(self, step: int) -> Stage:
        """Return the stage that a step belongs to; after the end, the last one."""
        end = 0
        for stage in self.stages:
            end += stage.steps
            if step < end:
                return stage
        return self.stages[-1]


def setup_names() -> tuple[str, ...]:
    """Return the names of the bundled setups."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.yaml")))


def load_setup(source: str | Path) -> Setup:
    """Read a setup.

    Args:
        source: the path of a file, or the name of a bundled setup.

    Raises:
        UsageError: there is no such setup, or it is not valid.
    """
    path = Path(source)
    if path.suffix not in {".yaml", ".yml"}:
        path = _FOLDER / f"{source}.yaml"
    if not path.is_file():
        raise UsageError(
            f"there is no setup '{source}'",
            name=str(source),
            suggestion=did_you_mean(str(source), setup_names())
            or f"one of {', '.join(setup_names())}, or the path of a YAML file",
        )
    document = strict_yaml.read(path)
    try:
        return Setup.model_validate(document.data)
    except ValidationError as error:
        raise _invalid(str(path), error, document) from None


def training_name(setup: str, seed: int) -> str:
    """Return the name of a setup trained with a seed."""
    return f"{setup}-seed{seed}"


def changed(setup: Setup, **changes: Any) -> Setup:
    """Return a setup that differs in some fields.

    Raises:
        UsageError: it is not valid so.
    """
    try:
        return Setup.model_validate(setup.model_dump() | changes)
    except ValidationError as error:
        raise _invalid(f"the setup '{setup.name}'", error) from None


def _invalid(source: str, error: ValidationError, document: Document | None = None) -> UsageError:
    first = error.errors()[0]
    key = ".".join(map(str, first["loc"])) or "as a whole"
    last = str(first["loc"][-1]) if first["loc"] else ""
    spot = document.places.nearest(tuple(first["loc"])) if document else None
    return UsageError(
        f"{source}: {key}: {first['msg']}" if spot is None else f"{key}: {first['msg']}",
        name=key,
        place=spot.of_key() if spot else None,
        suggestion=did_you_mean(last, [*Setup.model_fields, *Learning.model_fields])
        if first["type"] == "extra_forbidden"
        else None,
    )
