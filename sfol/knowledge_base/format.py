"""What a user may write: the pydantic models of a knowledge base file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
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
from sfol.operators import CONFIDENCES, CONJUNCTIONS, DISJUNCTIONS

FORMAT_VERSION = 1


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


class RuleEntry(_Section):
    """One rule; a plain text stands for a rule without a description."""

    rule: str = Field(description="A Horn clause: head(X) :- Body(X), not Other(X), X != Y.")
    description: str = Field("", description="What it says, in one sentence.")
    threshold: float = Field(
        0.0, ge=0, le=1, description="A positive literal's lower bound must reach this."
    )
    negation_threshold: float = Field(
        0.5, ge=0, le=1, description="A negated literal's lower bound, 1 − u, must reach this."
    )


class Semantics(_Section):
    """Which operators give rules their meaning."""

    conjunction: Annotated[str, _OneOf(CONJUNCTIONS)] = Field(
        "average", description="Combines the bounds of a body's literals."
    )
    groundings: Literal["pooled", "best"] | None = Field(
        None,
        description="Several substitutions for one head: `pooled` averages over their distinct "
        "atoms (default for average, and defined for it only), `best` takes the best one.",
    )
    disjunction: Annotated[str, _OneOf(DISJUNCTIONS)] = Field(
        "maximum", description="Combines several rules with one head."
    )
    confidence: Annotated[str, _OneOf(CONFIDENCES)] = Field(
        "midpoint", description="The confidence of a head from its bound."
    )

    @property
    def pools(self) -> bool:
        """Whether substitutions are pooled; the default depends on the conjunction."""
        if self.groundings is None:
            return CONJUNCTIONS[self.conjunction].pooled is not None
        return self.groundings == "pooled"


class Signal(_Section):
    """A number that the environment gives at every step."""

    unit: str = Field(description="Its unit, such as m/s; 1 for a plain number.")
    description: str = Field("", description="What it is.")
    default: float | None = Field(None, description="Used where the caller gives none.")


class Weight(_Section):
    """w = (1 / normalizer) Σ coefficient × confidence."""

    normalizer: FiniteFloat = Field(gt=0, description="Stays the same when rules are removed.")
    coefficients: dict[str, FiniteFloat] = Field(
        description="Head → coefficient (the paper's α, β)."
    )
    description: str = Field("", description="What it weighs.")


def _as_text(value: Any) -> Any:
    return repr(value) if isinstance(value, int | float) and not isinstance(value, bool) else value


# YAML reads -10 as a number; as a formula it is one as well.
_Formula = Annotated[str, BeforeValidator(_as_text, json_schema_input_type=str | float)]


class Term(_Section):
    """One summand of the reward: weight × formula."""

    weight: str | FiniteFloat = Field(description="A weight's name, or a constant.")
    formula: _Formula = Field(
        description="Over signals and parameters, such as -xi * (v - v_next)**2."
    )
    parameters: dict[str, FiniteFloat] = Field(default_factory=dict, description="Name → number.")
    description: str = Field("", description="What it rewards or punishes.")


class EntityWeight(_Section):
    """A weight w_i of the scene descriptor for entities X that meet a condition."""

    when: str = Field(description="A rule's body about X, such as Pedestrian(X), OnRoad(X).")
    weight: FiniteFloat = Field(description="w_i of such an entity.")
    at_least: float = Field(0.5, ge=0, le=1, description="Confidence from which a literal counts.")


class Grounding(BaseModel):
    """Numbers for whoever turns observations into facts; sfol itself reads only the margin."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True, defer_build=True)

    margin: float = Field(
        DEFAULT_MARGIN, ge=0, le=1, description="m: a confidence c becomes [c − m c, c + m c]."
    )


BoundPair = tuple[float, float]
_Listed = BeforeValidator(lambda pair: tuple(pair) if isinstance(pair, list) else pair)


class Expectation(_Section):
    """What a test expects; what it does not name is not compared."""

    bounds: dict[str, Annotated[BoundPair, _Listed] | None] = Field(
        default_factory=dict, description="Head → bound, or null where nothing is concluded."
    )
    confidences: dict[str, float] = Field(default_factory=dict, description="Head → confidence.")
    weights: dict[str, float] = Field(default_factory=dict, description="Weight → value.")
    terms: dict[str, float] = Field(default_factory=dict, description="Term → weighted value.")
    reward: float | None = Field(None, description="The sum of all terms.")


class Case(_Section):
    """A test that stands in the knowledge base: facts and signals in, values out."""

    name: str = Field(description="What the test shows.")
    facts: str | list[str] = Field("", description="Facts as text, or a list of such texts.")
    signals: dict[str, float] = Field(default_factory=dict, description="Signal → number.")
    expect: Expectation = Field(description="What must come out, within 1e-9.")


class Remove(_Section):
    """What an overlay drops from the knowledge base that it extends."""

    predicates: list[str] = Field(default_factory=list, description="Without their variables.")
    rules: list[str] = Field(default_factory=list, description="By name, not by head.")
    signals: list[str] = Field(default_factory=list, description="By name.")
    weights: list[str] = Field(default_factory=list, description="By name.")
    terms: list[str] = Field(default_factory=list, description="By name.")


def _as_rule_entry(value: Any) -> Any:
    return {"rule": value} if isinstance(value, str) else value


# The input type is for the JSON Schema: a rule may be a plain text.
_Rule = Annotated[
    RuleEntry, BeforeValidator(_as_rule_entry, json_schema_input_type=str | RuleEntry)
]


class KnowledgeBaseFile(_Section):
    """A knowledge base file, or an overlay that extends one."""

    version: Literal[1] = Field(description="The version of this format.")
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
    rules: dict[str, _Rule] = Field(
        default_factory=dict, description="Rule name → Horn clause, or clause with settings."
    )
    semantics: Semantics = Field(default_factory=Semantics, description="Operators.")
    signals: dict[str, Signal] = Field(default_factory=dict, description="Numbers of a step.")
    weights: dict[str, Weight] = Field(default_factory=dict, description="Weights from rules.")
    terms: dict[str, Term] = Field(default_factory=dict, description="Summands of the reward.")
    entity_weights: list[EntityWeight] = Field(
        default_factory=list, description="Weights of the descriptor; the first that holds counts."
    )
    grounding: Grounding = Field(default_factory=Grounding, description="How facts are found.")
    tests: list[Case] = Field(default_factory=list, description="Run by `sfol test`.")
