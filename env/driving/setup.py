"""Setups: what is trained, on which streets, as data that people edit."""

from __future__ import annotations

import hashlib
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from env.world.cells import Cell, CellOcclusion, Traffic
from sfol import strict_yaml
from sfol.errors import UsageError, did_you_mean
from sfol.strict_yaml import Document
from vsr.hypervectors.methods import Method

_FOLDER = Path(__file__).resolve().parents[2] / "setups"

# γ of a return. With 0.99, 10 s count, and a quick collision was worth more than standing still.
DISCOUNT = 0.997

Positive = Annotated[int, Field(gt=0)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Stage(_Section):
    """A part of the training, with the cells that its episodes are drawn from."""

    steps: Positive = Field(description="decisions of all streets together")
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
    """Hyperparameters of PPO, by the names of stable-baselines3 where it has them."""

    learning_rate: float = Field(3e-4, gt=0, description="at the beginning")
    last_learning_rate: float = Field(
        3e-4, gt=0, description="at the end; from the first to the last it falls evenly"
    )
    rollout_steps: Positive = Field(2048, description="decisions of all streets, for one update")
    batch_size: Positive = Field(64, description="decisions for one gradient")
    n_epochs: Positive = Field(10, description="passes over the decisions of an update")
    gamma: float = Field(
        DISCOUNT,
        gt=0,
        le=1,
        description="γ, the discount of a control step; a decision of k steps has γ^k",
    )
    gae_lambda: float = Field(0.95, ge=0, le=1, description="λ of generalised advantage estimation")
    clip_range: float = Field(
        0.2, gt=0, description="how far the ratio of new to old probabilities may be from 1"
    )
    ent_coef: float = Field(0.0, ge=0, description="factor on the policy's entropy in the loss")
    norm_obs: bool = Field(
        default=True,
        description="whether each number of an observation is given a mean of 0 and a deviation of "
        "1, by those seen so far; the policy keeps what was measured",
    )
    observation_scale: float = Field(
        0.1,
        gt=0,
        description="without norm_obs: factor on all numbers of an observation, so that the first "
        "layer is not saturated and what varies little stays small",
    )
    norm_reward: bool = Field(
        default=True,
        description="whether rewards are divided by the deviation of the returns seen so far",
    )
    log_std_init: float = Field(-0.5, description="logarithm of the actions' first deviation")
    value_steps: Positive = Field(
        8192,
        description="where a training starts from a policy: decisions driven before the first "
        "update, in whole rollouts, to learn what the policy is worth",
    )
    layers: tuple[Annotated[int, Field(gt=0, le=4096)], ...] = Field(
        (128, 128), max_length=8, description="of policy and value networks"
    )


class Setup(_Section):
    """A training: its street, its reward, its observation and its hyperparameters."""

    version: Literal[2] = Field(description="version of this format")
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
    unit_rms: bool = Field(
        default=True,
        description="whether SSI and SF of each entity, and what they are fused to, are scaled to "
        "a root mean square of 1",
    )
    speed: bool = Field(
        default=False, description="whether ego's speed is added to the observation vsr"
    )
    frames: int = Field(
        1,
        gt=0,
        le=64,
        description="how many observations, the last ones, a policy is given together",
    )
    decision_steps: Positive = Field(
        4,
        le=100,
        description="control steps, of 0.1 s, that an action is held; the reward is computed at "
        "each, and summed",
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
        "be given less than the setup says; null: from nothing",
    )
    checkpoint_steps: Positive = Field(10_000, description="decisions between two checkpoints")
    evaluation_steps: Positive = Field(20_000, description="decisions between two evaluations")
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
    def steps(self) -> int:
        """Decisions of the whole training."""
        return sum(stage.steps for stage in self.stages)

    @property
    def cells(self) -> tuple[Cell, ...]:
        """All that its stages draw from, each once."""
        return tuple(dict.fromkeys(cell for stage in self.stages for cell in stage.cells))

    @property
    def discount(self) -> float:
        """γ of a decision."""
        return float(self.learning.gamma**self.decision_steps)

    def stage_at(self, step: int) -> Stage:
        """Return the stage that a decision belongs to; after the end, the last one."""
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
