"""What the formulas of facts and signals read: which number, of which part of an observation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

from sfol import arrays
from sfol.errors import FactError, SignalError, did_you_mean
from sfol.formula import Formula
from sfol.knowledge_base import KnowledgeBase, ObservedFact, Sort, Source
from sfol.knowledge_base.observing import ACTION, NEXT, STEP, entity_names, with_step
from sfol.knowledge_base.parts import fields_of
from sfol.syntax import Atom

Observation = Any  # mappings, sequences and arrays, nested in any way
PartName = tuple[str, str, bool]  # which whole, which part of it, and whether that is a table


@dataclass(frozen=True)
class ObservedStep:
    """What can be read of one step, or of B steps; what nothing reads may be None.

    Attributes:
        observation: before the action.
        action: itself.
        next_observation: after the action.
        native: the environment's own reward.
        terminated: whether the step terminated the episode.
        truncated: whether the episode was truncated after it.
    """

    observation: Observation
    action: Observation = None
    next_observation: Observation = None
    native: Observation = None
    terminated: Observation = None
    truncated: Observation = None

    @cached_property
    def wholes(self) -> dict[str, Observation]:
        """What is read, by what formulas call it; the observation before the action is ``""``."""
        return {
            "": self.observation,
            ACTION: self.action,
            NEXT: self.next_observation,
            "native": self.native,
            "terminated": self.terminated,
            "truncated": self.truncated,
        }


@dataclass(frozen=True)
class NameReading:
    """A name of a formula, and the number that it means.

    Attributes:
        name: as in the formula, such as ``next.ego.speed`` or ``P.x``.
        whole: which of the things that are read: ``""`` for the observation, or as in
            `ObservedStep.wholes`.
        source: a part of it.
        column: of that part.
    """

    name: str
    whole: str
    source: str
    column: int


@dataclass(frozen=True)
class Range:
    """A variable and its sort, with what is read of the sort's entities.

    Attributes:
        whole: which of the things that are read.
        name: of the sort.
        sort: as the knowledge base has it.
        entities: what they are called, row by row.
        readings: of each entity.
    """

    whole: str
    name: str
    sort: Sort
    entities: tuple[str, ...]
    readings: tuple[NameReading, ...]


@dataclass(frozen=True)
class FormulaPlan:
    """A formula, with what it reads.

    Attributes:
        formula: of a fact or a signal.
        readings: of numbers that belong to no entity.
        quantified: key of a range → the entities that a quantifier goes through.
        variables: those of the fact's own variables, in their order.
    """

    formula: Formula
    readings: tuple[NameReading, ...]
    quantified: Mapping[str, Range]
    variables: tuple[Range, ...] = ()


Error = type[FactError] | type[SignalError]
NO_CONFIDENCE = "a confidence is from 0 to 1: clip it, or use below, above, between or near"
NO_VALUE = "a value is finite: clip it, or leave the entity out where there is none"
_NO_SORTS: Mapping[str, str] = MappingProxyType({})
_WHOLES = {
    "": "the observation",
    NEXT: "the observation after the action",
    ACTION: "the action",
    "native": "the environment's own reward",
    "terminated": "whether the step terminated the episode",
    "truncated": "whether the episode was truncated",
}


class ObservationPlans(NamedTuple):
    """What is read off observations: parts by name, and the plans of facts and of signals."""

    sources: Mapping[str, Source]
    facts: Sequence[tuple[ObservedFact, FormulaPlan]]
    signals: Mapping[str, FormulaPlan]


def compared_plans_of(kb: KnowledgeBase) -> ObservationPlans:
    """Return what `plans_of` does, with the comparisons of a value in place of the value itself."""
    asked = kb.comparisons

    def read(fact: ObservedFact) -> Iterator[ObservedFact]:
        if fact.atom.predicate not in kb.attributes:
            yield fact
        for predicate in asked:
            if predicate.attribute == fact.atom.predicate:
                yield replace(fact, atom=Atom(predicate, fact.atom.arguments), exact=True)

    plans = plans_of(kb)
    return plans._replace(facts=[(own, plan) for fact, plan in plans.facts for own in read(fact)])


def plans_of(kb: KnowledgeBase) -> ObservationPlans:
    """Return what a knowledge base reads off observations."""
    return ObservationPlans(
        with_step(kb.observation),
        [(fact, plan_of(kb, fact.formula, fact.sorts)) for fact in kb.facts],
        {name: plan_of(kb, formula) for name, formula in kb.observed_signals.items()},
    )


def plan_of(
    kb: KnowledgeBase, formula: Formula, sorts: Mapping[str, str] = _NO_SORTS
) -> FormulaPlan:
    """Return what a formula of a fact or signal reads.

    Args:
        kb: the knowledge base.
        formula: of a fact or a signal.
        sorts: variable of the fact → sort.
    """
    own = {name: name.partition(".")[0] for name in sorted(formula.names)}
    return FormulaPlan(
        formula,
        tuple(_reading(kb, name) for name, first in own.items() if first not in sorts),
        {r.key: _range(kb, r.sort, sorted(r.names)) for r in formula.ranges},
        tuple(
            _range(kb, sort, [name for name, first in own.items() if first == variable])
            for variable, sort in sorts.items()
        ),
    )


def _range(kb: KnowledgeBase, name: str, names: Sequence[str]) -> Range:
    whole, _, own = name.rpartition(".")
    sort = kb.entities[own]
    fields = fields_of(kb.observation, sort)
    readings = [NameReading(used, whole, *fields[used.partition(".")[2]]) for used in names]
    return Range(whole, own, sort, entity_names(own, sort), tuple(readings))


def _reading(kb: KnowledgeBase, name: str) -> NameReading:
    first, *rest = name.split(".")
    whole = first if first in (NEXT, ACTION, *STEP) else ""
    source, *field = rest if first == NEXT else (first, *rest)
    column = with_step(kb.observation)[source].columns[field[0]] if field else 0
    return NameReading(name, whole, source, column)


def parts_of(plan: FormulaPlan) -> Iterator[PartName]:
    """Yield what a formula reads: which whole, which part of it, and whether that is a table."""
    for entities in (*plan.variables, *plan.quantified.values()):
        yield from ((entities.whole, table, True) for table in entities.sort.tables)
    yield from ((reading.whole, reading.source, False) for reading in plan.readings)


def read_for_facts(kb: KnowledgeBase, step: ObservedStep) -> Observation:
    """Return the observation of a step that facts are read off.

    Raises:
        FactError: it is the one after the action, and not given.
    """
    if kb.facts_at == "state":
        return step.observation
    if step.next_observation is None and kb.facts:
        raise FactError(
            f"{_WHOLES[NEXT]} is not given",
            name=NEXT,
            suggestion=f"facts_at of '{kb.name}' says that facts are read off it",
        )
    return step.next_observation


def width_of(source: Source) -> int:
    """Return how many numbers a part has, in a row, at least."""
    return max(source.columns.values(), default=0) + 1


def fits(source: Source, width: int) -> bool:
    """Tell whether a part may have so many numbers, in a row."""
    least = width_of(source)
    return width >= least if isinstance(source.fields, dict) else width == least


def shape_of(source: Source, before: Sequence[str]) -> str:
    """Return the shape that a part must have, as text.

    Args:
        source: the part.
        before: the sizes of the axes before its fields, such as ``n``.
    """
    width = f"{width_of(source)}{' or more' if isinstance(source.fields, dict) else ''}"
    sizes = [*before, *([width] if source.columns else [])]
    if not sizes:
        return "(), a single number"
    return f"({', '.join(sizes)}{',' if len(sizes) == 1 else ''})"


def part_at(
    whole: Observation,
    path: Sequence[str | int],
    name: str,
    error: Error,
    *,
    many: bool = False,
) -> Any:
    """Return the part of an observation that keys lead to.

    Args:
        whole: the observation, or the action.
        path: the keys, from the outside in.
        name: which whole it is, as in `NameReading`.
        error: what is raised where there is no such part.
        many: whether arrays have an axis B before those that keys are of.
    """
    if whole is None:
        raise error(
            f"{_WHOLES[name]} is not given",
            name=name or "observation",
            suggestion="give what env.step returned, in its order" if name in STEP else None,
        )
    part = whole
    for key in path:
        part = under(part, key, _WHOLES[name], error, many=many)
    return part


def under(part: Any, key: str | int, owner: str, error: Error, *, many: bool = False) -> Any:
    """Return what stands under a key; `owner` names the part in the error that it is not there."""
    try:
        return part[:, key] if many and arrays.is_array(part) else part[key]
    except (KeyError, IndexError, TypeError, ValueError):
        known = map(str, part) if isinstance(part, Mapping) else ()
        shape = getattr(part, "shape", None)
        of_shape = "" if shape is None else f" of shape {tuple(shape)}"
        raise error(
            f"{owner} has no '{key}'",
            name=str(key),
            suggestion=did_you_mean(str(key), known)
            or f"it is {type(part).__name__}{of_shape} there",
        ) from None
