"""What a user may write: the pydantic models of a knowledge base file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    GetCoreSchemaHandler,
)
from pydantic_core import CoreSchema, core_schema

from sfol.facts import DEFAULT_MARGIN
from sfol.operators import BEST, CONFIDENCES, CONJUNCTIONS, DISJUNCTIONS, GROUNDINGS, POOLED

FORMAT_VERSION = 2


class _Section(BaseModel):
    # Strict: a typo is an error, and the text "0.5" is not a number.
    # Deferred: the validators are built when a file is first loaded, not at import.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, defer_build=True)


@dataclass(frozen=True)
class _OneOf:
    """The names in a table, as `Literal` has names that are known beforehand."""

    names: Iterable[str]

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.literal_schema([*self.names])


BoundPair = tuple[float, float]
_Listed = BeforeValidator(lambda pair: tuple(pair) if isinstance(pair, list) else pair)


class RuleEntry(_Section):
    """One rule; a plain text stands for a rule without a description."""

    rule: str = Field(
        description="Such as head(X) :- Body(X), not Other(X), (P(X) or Q(X)), X != Y, "
        "count(Z: R(Z, X)) >= 2, forall(Z: R(Z, X))(P(Z))."
    )
    description: str = Field("", description="What it says, in one sentence.")
    threshold: float = Field(
        0.0, ge=0, le=1, description="A positive literal's lower bound must reach this."
    )
    negation_threshold: float = Field(
        0.5, ge=0, le=1, description="A negated literal's lower bound, 1 − u, must reach this."
    )
    certainty: float | Annotated[BoundPair, _Listed] = Field(
        1.0,
        description="What the bound of the body is multiplied by: a number, or [lower, upper].",
    )
    groundings: Annotated[str, _OneOf(GROUNDINGS)] | None = Field(
        None, description="What several substitutions come to; what `semantics` says by default."
    )


class Semantics(_Section):
    """Which operators give rules their meaning."""

    conjunction: Annotated[str, _OneOf(CONJUNCTIONS)] = Field(
        "average", description="Combines the bounds of a body's literals."
    )
    groundings: Annotated[str, _OneOf(GROUNDINGS)] | None = Field(
        None,
        description="Several substitutions for one head: `pooled` averages over their distinct "
        "atoms (default for average, and defined for it only), `best` takes the best one, `sum` "
        "and `probabilistic_sum` let each further one add to it.",
    )
    disjunction: Annotated[str, _OneOf(DISJUNCTIONS)] = Field(
        "maximum", description="Combines several rules with one head."
    )
    confidence: Annotated[str, _OneOf(CONFIDENCES)] = Field(
        "midpoint", description="The confidence of a head from its bound."
    )

    @property
    def gathers(self) -> str:
        """What several substitutions come to; the default depends on the conjunction."""
        pools = CONJUNCTIONS[self.conjunction].pooled is not None
        return self.groundings or (POOLED if pools else BEST.name)


def _as_text(value: Any) -> Any:
    return repr(value) if isinstance(value, int | float) and not isinstance(value, bool) else value


# YAML reads -10 as a number; as a formula it is one as well.
_Formula = Annotated[str, BeforeValidator(_as_text, json_schema_input_type=str | float)]
_Key = str | int


class Source(_Section):
    """A part of the observation, and what its numbers are called."""

    key: _Key | list[_Key] | None = Field(
        None,
        description="Where it stands in the observation: a key, or an index, or several of them, "
        "from the outside in; without one it is the whole observation.",
    )
    fields: list[str] | dict[str, int] | None = Field(
        None,
        description="The names of its numbers in order, or name → index; without any it is one "
        "number, read by the name of the part.",
    )
    present: _Key | list[_Key] | None = Field(
        None,
        description="For a table: which of its rows are there, as a field of it, or as the key of "
        "truth values beside it; without one all are.",
    )

    @cached_property
    def path(self) -> tuple[_Key, ...]:
        """The keys that lead to it, from the outside in."""
        return _listed_keys(self.key)

    @cached_property  # asked at every step
    def columns(self) -> dict[str, int]:
        """Field → index; none for one number."""
        if isinstance(self.fields, dict):
            return self.fields
        return {name: index for index, name in enumerate(self.fields or ())}

    @cached_property
    def mask(self) -> tuple[_Key, ...] | None:
        """The keys that lead to which rows are there; None if a field says so, or nothing."""
        is_field = not isinstance(self.present, list) and self.present in self.columns
        return None if self.present is None or is_field else _listed_keys(self.present)


def _listed_keys(key: _Key | list[_Key] | None) -> tuple[_Key, ...]:
    if key is None:
        return ()
    return tuple(key) if isinstance(key, list) else (key,)


class Sort(_Section):
    """Entities of one kind: the rows of a table, or of several side by side."""

    sources: str | list[str] = Field(
        alias="from", description="Parts of the observation; their rows are the entities."
    )
    at_most: int = Field(ge=1, le=1_000, description="How many rows they have at most.")

    @cached_property
    def tables(self) -> tuple[str, ...]:
        """The names of the parts of the observation."""
        return (self.sources,) if isinstance(self.sources, str) else tuple(self.sources)


class FactEntry(_Section):
    """How true an atom is; a plain formula stands for one without settings."""

    formula: _Formula = Field(
        description="Its confidence, from 0 to 1, such as below(P.distance, 5, margin=2)."
    )
    bounds: Literal["margin", "exact"] = Field(
        "margin", description="`margin`: [c − m c, c + m c] by grounding.margin; `exact`: [c, c]."
    )
    at_least: float = Field(
        0.0, ge=0, le=1, description="With a confidence below this, the atom is unknown."
    )


class Signal(_Section):
    """A number that the environment gives at every step."""

    unit: str = Field(description="Its unit, such as m/s; 1 for a plain number.")
    description: str = Field("", description="What it is.")
    default: float | None = Field(None, description="Used where the caller gives none.")
    observed: _Formula | None = Field(
        None,
        alias="from",
        description="A formula over the observation before the action, as ego.speed, after it, as "
        "next.ego.speed, and the action; `native`, `terminated` and `truncated` are the "
        "environment's own reward of the step, and whether it ended the episode (1) or not (0).",
    )


class Time(_Section):
    """How long a step is; durations of operators over time and of smoothing are in its unit."""

    step: FiniteFloat = Field(gt=0, description="From one step to the next.")
    unit: str = Field("s", description="The unit of the step and of all durations.")


class Smoothing(_Section):
    """How a weight follows what its heads come to: after so long 1/e of a change is left."""

    rise: FiniteFloat = Field(0.0, ge=0, description="While it grows; 0 follows at once.")
    fall: FiniteFloat = Field(0.0, ge=0, description="While it falls; 0 follows at once.")


class Weight(_Section):
    """w = (1 / normalizer) Σ coefficient × confidence."""

    normalizer: FiniteFloat = Field(gt=0, description="Stays the same when rules are removed.")
    coefficients: dict[str, FiniteFloat] = Field(
        description="Head → coefficient (the paper's α, β)."
    )
    smoothing: Smoothing | None = Field(
        None, description="How it follows its heads from step to step; without it, at once."
    )
    description: str = Field("", description="What it weighs.")


class Term(_Section):
    """One summand of the reward: weight × formula."""

    weight: str | FiniteFloat = Field(description="A weight's name, or a constant.")
    formula: _Formula = Field(
        description="Over signals, parameters and heads, such as -xi * (v - v_next)**2."
    )
    parameters: dict[str, FiniteFloat] = Field(default_factory=dict, description="Name → number.")
    description: str = Field("", description="What it rewards or punishes.")


class Schedule(_Section):
    """How a number changes while an agent is trained: in a straight line, and then no more."""

    start: FiniteFloat = Field(alias="from", description="Its value when the training begins.")
    end: FiniteFloat = Field(alias="to", description="Its value from the end of the schedule on.")
    over: int = Field(ge=1, description="After how many steps or episodes the schedule ends.")
    by: Literal["steps", "episodes"] = Field(
        "steps",
        description="What is counted over all environments: steps that were taken, or episodes "
        "that have ended.",
    )


class EntityWeight(_Section):
    """A weight w_i of the scene descriptor for entities X that meet a condition."""

    when: str = Field(description="A rule's body about X, such as Pedestrian(X), OnRoad(X).")
    weight: FiniteFloat = Field(description="w_i of such an entity.")
    at_least: float = Field(0.5, ge=0, le=1, description="Confidence from which a literal counts.")


class Grounding(BaseModel):
    """Numbers for whoever turns observations into facts; sfol itself reads only the margin."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True, defer_build=True)

    margin: float = Field(
        DEFAULT_MARGIN,
        ge=0,
        le=1,
        description="m: a confidence c becomes [c − m c, c + m c]; without it, [c, c].",
    )


class Expectation(_Section):
    """What a test expects; what it does not name is not compared."""

    bounds: dict[str, Annotated[BoundPair, _Listed] | None] = Field(
        default_factory=dict, description="Head → bound, or null where nothing is concluded."
    )
    confidences: dict[str, float] = Field(default_factory=dict, description="Head → confidence.")
    weights: dict[str, float] = Field(default_factory=dict, description="Weight → value.")
    terms: dict[str, float] = Field(default_factory=dict, description="Term → weighted value.")
    reward: float | None = Field(None, description="The sum of all terms.")


Observed = float | list[Any] | dict[str, Any]


class CaseStep(_Section):
    """A step of an episode that a test plays, as often as it says."""

    facts: str | list[str] = Field("", description="Facts as text, or a list of such texts.")
    signals: dict[str, float] = Field(
        default_factory=dict, description="Signal → number, for those that are not the test's own."
    )
    times: int = Field(1, ge=1, le=10_000, description="How many such steps follow each other.")
    expect: Expectation = Field(
        default_factory=Expectation, description="What must come out of the last of them."
    )


class Case(_Section):
    """A test that stands in the knowledge base: facts and signals in, values out."""

    name: str = Field(description="What the test shows.")
    facts: str | list[str] = Field("", description="Facts as text, or a list of such texts.")
    observation: Observed | None = Field(
        None, description="What facts and signals are read from, in place of facts."
    )
    action: Observed | None = Field(None, description="The action, for signals that read it.")
    next: Observed | None = Field(
        None, description="The observation after the action, for signals that read it."
    )
    native: float | None = Field(
        None, description="The environment's own reward, for signals that read it."
    )
    terminated: bool | None = Field(
        None, description="Whether the step terminated the episode, for signals that read it."
    )
    truncated: bool | None = Field(None, description="Whether it was truncated there, likewise.")
    signals: dict[str, float] = Field(default_factory=dict, description="Signal → number.")
    steps: list[CaseStep] = Field(
        default_factory=list,
        description="The steps of an episode in order, in place of facts; the test's signals count "
        "in each.",
    )
    expect: Expectation = Field(
        description="What must come out, within 1e-9; of the last step where there are several."
    )


class Remove(_Section):
    """What an overlay drops from the knowledge base that it extends."""

    predicates: list[str] = Field(default_factory=list, description="Without their variables.")
    attributes: list[str] = Field(default_factory=list, description="Without their variables.")
    rules: list[str] = Field(default_factory=list, description="By name, not by head.")
    observation: list[str] = Field(default_factory=list, description="By name.")
    entities: list[str] = Field(default_factory=list, description="By name.")
    facts: list[str] = Field(default_factory=list, description="As written where they stand.")
    signals: list[str] = Field(default_factory=list, description="By name.")
    weights: list[str] = Field(default_factory=list, description="By name.")
    terms: list[str] = Field(default_factory=list, description="By name.")
    schedules: list[str] = Field(default_factory=list, description="By the name of the number.")


def _as_rule_entry(value: Any) -> Any:
    return {"rule": value} if isinstance(value, str) else value


# The input type is for the JSON Schema: a rule may be a plain text.
_Rule = Annotated[
    RuleEntry, BeforeValidator(_as_rule_entry, json_schema_input_type=str | RuleEntry)
]


def _as_fact_entry(value: Any) -> Any:
    return value if isinstance(value, dict | FactEntry) else {"formula": value}


_Fact = Annotated[
    FactEntry, BeforeValidator(_as_fact_entry, json_schema_input_type=str | float | FactEntry)
]


class KnowledgeBaseFile(_Section):
    """A knowledge base file, or an overlay that extends one."""

    version: Literal[1, 2] = Field(
        description="The version of this format: 2, or 1, which `sfol migrate` rewrites."
    )
    name: str = Field(description="The knowledge base's name.")
    description: str = Field("", description="What it is for.")
    extends: str | list[str] = Field(
        default_factory=list, description="Bundled names, or names of files in this folder."
    )
    remove: Remove = Field(default_factory=Remove, description="Names to drop from the base.")
    subject: str = Field("ego", description="The entity whose heads make the reward.")
    background: list[str] = Field(default_factory=list, description="Facts that always hold.")
    predicates: dict[str, str] = Field(
        default_factory=dict, description="Predicate with its variables → what it says."
    )
    attributes: dict[str, str] = Field(
        default_factory=dict,
        description="Attribute with its variables, such as Distance(P, X) → what number it is, and "
        "in which unit.",
    )
    rules: dict[str, _Rule] = Field(
        default_factory=dict, description="Rule name → Horn clause, or clause with settings."
    )
    semantics: Semantics = Field(default_factory=Semantics, description="Operators.")
    observation: dict[str, Source] = Field(
        default_factory=dict, description="Names for the parts of what the environment gives."
    )
    entities: dict[str, Sort] = Field(
        default_factory=dict, description="Which entities there are: sort → rows of a table."
    )
    facts: dict[str, _Fact] = Field(
        default_factory=dict,
        description="An atom with the sorts of its variables, such as Near(P in pedestrian, ego) → "
        "how true it is; or an attribute, such as Speed(P in pedestrian) → its value.",
    )
    facts_at: Literal["state", "next"] = Field(
        "state",
        description="The facts that reward a step: those of the state before the action, or of the "
        "`next` one, so that a state in which an episode ends is rewarded, too.",
    )
    time: Time | None = Field(
        None, description="The length of a step, for operators over time and smoothing."
    )
    signals: dict[str, Signal] = Field(default_factory=dict, description="Numbers of a step.")
    weights: dict[str, Weight] = Field(default_factory=dict, description="Weights from rules.")
    terms: dict[str, Term] = Field(default_factory=dict, description="Summands of the reward.")
    schedules: dict[str, Schedule] = Field(
        default_factory=dict,
        description="Numbers that change while an agent is trained, such as weights.safety.safe1, "
        "a coefficient, or terms.comfort.xi, a parameter → how. Elsewhere the file's own number "
        "counts.",
    )
    entity_weights: list[EntityWeight] = Field(
        default_factory=list, description="Weights of the descriptor; the first that holds counts."
    )
    grounding: Grounding = Field(default_factory=Grounding, description="How facts are found.")
    tests: list[Case] = Field(default_factory=list, description="Run by `sfol test`.")
