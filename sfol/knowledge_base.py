"""What a knowledge base is: the pydantic models of a file, and the checked whole made from them.

`KnowledgeBaseFile` is what a user may write. `KnowledgeBase` is what the rest of sfol works with:
all files of a chain merged, every clause and formula parsed, every name known to exist.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat

from sfol.errors import KnowledgeBaseError, did_you_mean
from sfol.facts import DEFAULT_MARGIN, Facts
from sfol.formula import Formula
from sfol.syntax import Atom, Body, Clause

FORMAT_VERSION = 1


class _Section(BaseModel):
    # Strict: a typo is an error, and the text "0.5" is not a number.
    # Deferred: the validators are built when a file is first loaded, not at import.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, defer_build=True)


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

    conjunction: Literal["average", "minimum", "product", "lukasiewicz"] = Field(
        "average", description="Combines the bounds of a body's literals."
    )
    groundings: Literal["pooled", "best"] | None = Field(
        None,
        description="Several substitutions for one head: `pooled` averages over their distinct "
        "atoms (default for average, and defined for it only), `best` takes the best one.",
    )
    disjunction: Literal["maximum", "probabilistic_sum"] = Field(
        "maximum", description="Combines several rules with one head."
    )
    confidence: Literal["midpoint", "lower", "upper"] = Field(
        "midpoint", description="The confidence of a head from its bound."
    )

    @property
    def pools(self) -> bool:
        """Whether substitutions are pooled; the default depends on the conjunction."""
        return (self.groundings or self._default_groundings) == "pooled"

    @property
    def _default_groundings(self) -> str:
        return "pooled" if self.conjunction == "average" else "best"


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


class Term(_Section):
    """One summand of the reward: weight × formula."""

    weight: str | FiniteFloat = Field(description="A weight's name, or a constant.")
    formula: str = Field(description="Over signals and parameters, such as -xi * (v - v_next)**2.")
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


@dataclass(frozen=True)
class Predicate:
    """A declared predicate.

    Attributes:
        name: such as ``CenterOf``.
        parameters: one or two variables, such as ``("X", "Y")``.
        description: what an atom of it says; empty for heads that only rules introduce.
    """

    name: str
    parameters: tuple[str, ...]
    description: str = ""

    @property
    def arity(self) -> int:
        """The number of arguments, 1 or 2."""
        return len(self.parameters)


@dataclass(frozen=True)
class Rule:
    """A named rule of a knowledge base.

    Attributes:
        name: unique in the knowledge base; several rules may share a head.
        clause: head and body.
        description: what it says.
        threshold: least lower bound of a positive literal.
        negation_threshold: least lower bound, 1 − u, of a negated literal.
    """

    name: str
    clause: Clause
    description: str = ""
    threshold: float = 0.0
    negation_threshold: float = 0.5

    def __str__(self) -> str:
        return f"{self.name}: {self.clause}"


@dataclass(frozen=True)
class RewardTerm:
    """A term with its formula parsed.

    Attributes:
        name: unique in the knowledge base.
        weight: the name of a weight, or a constant.
        formula: of signals and parameters.
        parameters: name → number.
        description: what it rewards or punishes.
    """

    name: str
    weight: str | float
    formula: Formula
    parameters: Mapping[str, float]
    description: str = ""


@dataclass(frozen=True)
class EntityCondition:
    """An entity weight with its condition parsed; the entity is the variable X."""

    when: Body
    weight: float
    at_least: float = 0.5


_Model = TypeVar("_Model", bound=BaseModel)


@dataclass(frozen=True)
class KnowledgeBase:
    """A checked knowledge base: every clause parsed, every name known.

    Attributes:
        name: from the file.
        description: from the file.
        subject: the entity whose heads make the reward.
        background: ground atoms that always hold with [1, 1].
        predicates: by name; heads that rules introduce are among them.
        rules: by name, in the order of the file.
        semantics: the operators.
        signals: by name.
        weights: by name.
        terms: by name; their sum is the reward.
        entity_weights: in order; the first that holds counts.
        grounding: numbers for whoever turns observations into facts.
        tests: cases of the last file; inherited ones do not run for an overlay.
        files: the files that it was made from, in the order in which they were applied.

    Example:
        >>> kb = KnowledgeBase.load("aeb")
        >>> len(kb.rules)
        9
    """

    name: str
    description: str
    subject: str
    background: tuple[Atom, ...]
    predicates: Mapping[str, Predicate]
    rules: Mapping[str, Rule]
    semantics: Semantics
    signals: Mapping[str, Signal]
    weights: Mapping[str, Weight]
    terms: Mapping[str, RewardTerm]
    entity_weights: tuple[EntityCondition, ...] = ()
    grounding: Grounding = field(default_factory=Grounding)
    tests: tuple[Case, ...] = ()
    files: tuple[str, ...] = ()

    @classmethod
    def load(cls, *sources: str | Path) -> KnowledgeBase:
        """Read one knowledge base, or several applied left to right.

        Args:
            sources: paths of files, or names of bundled ones such as ``aeb``.

        Raises:
            InvalidKnowledgeBase: with every error found, each with file, line and column.
        """
        # Here, since loading imports this module, and YAML is needed by nobody but it.
        from sfol.loading import load  # noqa: PLC0415

        return load(*sources)

    @property
    def heads(self) -> tuple[str, ...]:
        """The predicates that rules conclude, each once, in the order of the rules."""
        return tuple(dict.fromkeys(rule.clause.head.predicate for rule in self.rules.values()))

    @property
    def hash(self) -> str:
        """A digest of everything that can change a reward or a descriptor, 64 hex digits.

        Names of files, descriptions, tests, and coefficients of heads that no rule concludes are
        not part of it.
        """
        heads = set(self.heads)
        meaning = {
            "subject": self.subject,
            "background": sorted(map(str, self.background)),
            "rules": {
                name: [str(rule.clause), rule.threshold, rule.negation_threshold]
                for name, rule in self.rules.items()
            },
            "semantics": [*self.semantics.model_dump().values(), self.semantics.pools],
            "signals": {name: signal.default for name, signal in self.signals.items()},
            "weights": {
                name: [
                    weight.normalizer,
                    {head: c for head, c in weight.coefficients.items() if head in heads},
                ]
                for name, weight in self.weights.items()
            },
            "terms": {
                name: [term.weight, term.formula.text, dict(term.parameters)]
                for name, term in self.terms.items()
            },
            "entity_weights": [[str(e.when), e.weight, e.at_least] for e in self.entity_weights],
            "grounding": self.grounding.model_dump(mode="json"),
        }
        text = json.dumps(meaning, sort_keys=True, ensure_ascii=False)
        return hashlib.sha256(text.encode()).hexdigest()

    def to_pyreason(self, facts: Facts) -> tuple[Any, list[Any], list[Any]]:
        """Return the PyReason program of a scene, for those who want to go on from it.

        All conclusions are among the facts, so that one run suffices: each rule then concludes its
        own bound, under a head of its own such as ``safe3.8(ego)``.

        Args:
            facts: ground atoms with bounds.

        Returns:
            A networkx graph of the entities, PyReason rules and PyReason facts. The rules name
            annotation functions: add each of `sfol.engines.pyreason_runtime.annotation_functions()`
            and set ``pyreason.settings.allow_ground_rules``.

        Raises:
            MissingExtraError: PyReason is not installed.
            FactError: a fact does not fit the knowledge base.
        """
        from sfol.engines.pyreason import PyReasonEngine  # noqa: PLC0415

        return PyReasonEngine(self).to_pyreason(facts)

    def grounding_of(self, section: str, model: type[_Model]) -> _Model:
        """Return a consumer's section of `grounding`, read by the consumer's own model.

        Args:
            section: its key, such as ``segmentation``.
            model: the pydantic model that describes it; a missing section has its defaults.

        Raises:
            KnowledgeBaseError: the section does not fit the model.
        """
        content = (self.grounding.model_extra or {}).get(section, {})
        try:
            return model.model_validate(content)
        except ValueError as error:
            raise KnowledgeBaseError(
                f"grounding.{section} of '{self.name}' is not valid: {error}", name=section
            ) from error

    def predicate(self, name: str) -> Predicate:
        """Return a declared predicate.

        Raises:
            KnowledgeBaseError: there is none of this name.
        """
        if name not in self.predicates:
            raise KnowledgeBaseError(
                f"'{name}' is no predicate of '{self.name}'",
                name=name,
                suggestion=did_you_mean(name, self.predicates),
            )
        return self.predicates[name]

    def __repr__(self) -> str:
        return (
            f"<KnowledgeBase '{self.name}': {len(self.predicates)} predicates, "
            f"{len(self.rules)} rules, {len(self.terms)} terms, {self.hash[:12]}>"
        )
