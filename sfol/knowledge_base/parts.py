"""The parsed parts of a knowledge base: predicates, rules, terms, conditions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from sfol.clauses import Body, Clause, WrittenRule
from sfol.facts import TRUE, Bound
from sfol.formula import Formula
from sfol.knowledge_base.format import (
    FORMAT_VERSION,
    Case,
    Grounding,
    Semantics,
    Signal,
    Sort,
    Source,
    Time,
    Weight,
)
from sfol.syntax import Atom


@dataclass(frozen=True)
class Attribute:
    """A number that entities have, such as ``Distance(P, X)``.

    Attributes:
        name: such as ``Distance``.
        parameters: four variables at most, such as ``("P", "X")``.
        description: what number it is.
    """

    name: str
    parameters: tuple[str, ...]
    description: str = ""

    @property
    def arity(self) -> int:
        """The number of arguments, from 0 to 4."""
        return len(self.parameters)

    @property
    def signature(self) -> str:
        """The name with its parameters, as a file declares it."""
        return str(Atom(self.name, self.parameters))


@dataclass(frozen=True)
class Predicate(Attribute):
    """What is more or less true of entities, such as ``CenterOf(X, Y)``; its parts are alike.

    Attributes:
        declared: whether the file declares it; otherwise it is written like the head of its first
            rule and described like that rule.
    """

    declared: bool = True


@dataclass(frozen=True)
class Rule:
    """A named rule of a knowledge base.

    Attributes:
        name: unique in the knowledge base; several rules may share a head.
        clause: head and body.
        description: what it says.
        threshold: least lower bound of a positive literal.
        negation_threshold: least lower bound, 1 − u, of a negated literal.
        certainty: what the bound of the body is multiplied by, lower with lower, upper with upper.
        groundings: what several substitutions come to; None stands for what `semantics` says.
        part_of: the rule as it is written, if its body has ``or`` or ``implies``: each way in which
            that can hold is a rule, a part, called ``safe2.1``, ``safe2.2`` and so on.
    """

    name: str
    clause: Clause
    description: str = ""
    threshold: float = 0.0
    negation_threshold: float = 0.5
    certainty: Bound = TRUE
    groundings: str | None = None
    part_of: WrittenRule | None = None

    @property
    def entry(self) -> str:
        """What the rule as it is written is called: ``safe2`` for ``safe2.1``, a part of it."""
        return self.name if self.part_of is None else self.name.rpartition(".")[0]

    @property
    def called(self) -> str:
        """Its name for messages, and that of the rule as it is written."""
        return f"'{self.name}'" + ("" if self.part_of is None else f" (a part of '{self.entry}')")

    @property
    def certainty_entry(self) -> float | list[float]:
        """The certainty as a file has it: one number where both ends are the same."""
        lower, upper = self.certainty
        return lower if lower == upper else [lower, upper]

    def __str__(self) -> str:
        return f"{self.name}: {self.clause}"


@dataclass(frozen=True)
class RewardTerm:
    """A term with its formula parsed.

    Attributes:
        name: unique in the knowledge base.
        weight: the name of a weight, or a constant.
        formula: of signals, parameters and heads.
        parameters: name → number.
        description: what it rewards or punishes.
        heads: those that the formula reads: the subject's confidences.
    """

    name: str
    weight: str | float
    formula: Formula
    parameters: Mapping[str, float]
    description: str = ""
    heads: tuple[str, ...] = ()


@dataclass(frozen=True)
class ObservedFact:
    """How an atom's truth is read off an observation, for all entities of some sorts.

    Attributes:
        text: the atom as written, with the sorts of its variables.
        atom: of variables and constants.
        sorts: variable → sort.
        formula: over fields, of the variables' entities and of other parts of the observation.
        exact: whether its value is a bound by itself, without the margin.
        at_least: the least value with which something is known.
    """

    text: str
    atom: Atom
    sorts: Mapping[str, str]
    formula: Formula
    exact: bool = False
    at_least: float = 0.0

    @property
    def slots(self) -> tuple[str, ...]:
        """What tells it from other facts: the predicate, then a sort or constant each."""
        return (self.atom.predicate, *(self.sorts.get(a, a) for a in self.atom.arguments))


@dataclass(frozen=True)
class ScheduledNumber:
    """A number of the reward that changes while an agent is trained.

    Attributes:
        section: whether it is a coefficient of a weight or a parameter of a term.
        group: the name of the weight or the term.
        name: of the head or the parameter.
        start: its value when the training begins.
        end: its value from the end of the schedule on.
        over: after how many steps or episodes the schedule ends.
        by: which of the two are counted.
    """

    section: Literal["weights", "terms"]
    group: str
    name: str
    start: float
    end: float
    over: int
    by: Literal["steps", "episodes"] = "steps"

    def value_at(self, done: int) -> float:
        """Return its value after so many steps or episodes."""
        if done >= self.over:
            return self.end
        return self.start + (self.end - self.start) * (done / self.over)


@dataclass(frozen=True)
class EntityCondition:
    """An entity weight with its condition parsed; the entity is the variable X."""

    when: Body
    weight: float
    at_least: float = 0.5


@dataclass(frozen=True)
class Parts:
    """Everything that a checked knowledge base consists of; `KnowledgeBase` says what each is."""

    name: str
    description: str
    subject: str
    background: tuple[Atom, ...]
    predicates: Mapping[str, Predicate]
    attributes: Mapping[str, Attribute]
    rules: Mapping[str, Rule]
    semantics: Semantics
    signals: Mapping[str, Signal]
    weights: Mapping[str, Weight]
    terms: Mapping[str, RewardTerm]
    schedules: Mapping[str, ScheduledNumber] = field(default_factory=dict)
    entity_weights: tuple[EntityCondition, ...] = ()
    grounding: Grounding = field(default_factory=Grounding)
    observation: Mapping[str, Source] = field(default_factory=dict)
    entities: Mapping[str, Sort] = field(default_factory=dict)
    facts: tuple[ObservedFact, ...] = ()
    facts_at: Literal["state", "next"] = "state"
    time: Time | None = None
    observed_signals: Mapping[str, Formula] = field(default_factory=dict)
    tests: tuple[Case, ...] = ()
    files: tuple[str, ...] = ()
    version: int = FORMAT_VERSION


def fields_of(observation: Mapping[str, Source], sort: Sort) -> dict[str, tuple[str, int]]:
    """Return the fields of a sort's entities: name → the table, and the column in it.

    Of a table without fields, its one column has the name "".
    """
    return {
        name: (table, column)
        for table in sort.tables
        for name, column in (observation[table].columns or {"": 0}).items()
    }
