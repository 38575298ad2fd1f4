"""Facts and signals, read off an observation as a knowledge base says.

The sections `observation`, `entities` and `facts` and the signals with `from` are compiled once
into readings: which number, of which part of the observation, each name of a formula means. Every
formula is then evaluated for every entity that is there.
"""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from sfol import arrays
from sfol.errors import FactError, FormulaError, SignalError, UsageError, did_you_mean
from sfol.facts import Bound, Facts
from sfol.formula import Formula
from sfol.knowledge_base import KnowledgeBase, ObservedFact, Sort, Source
from sfol.knowledge_base.observing import ACTION, NEXT, entity_names
from sfol.knowledge_base.parts import fields_of
from sfol.operators import least

_Reals = npt.NDArray[np.float64]
_Error = type[FactError] | type[SignalError]

Observation = Any  # mappings, sequences and arrays, nested in any way


@dataclass(frozen=True)
class _Reading:
    """A name of a formula, and the number that it means.

    Attributes:
        name: as in the formula, such as ``next.ego.speed`` or ``P.x``.
        whole: which of the things that are read: ``""`` for the observation, ``next``, ``action``.
        source: a part of it.
        column: of that part.
    """

    name: str
    whole: str
    source: str
    column: int


@dataclass(frozen=True)
class _Range:
    """A variable of a fact, over the entities of a sort.

    Attributes:
        sort: its name.
        fields: name in the formula → column among those of the sort that are read.
    """

    sort: str
    fields: tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class _Plan:
    """A fact, with what its formula reads.

    Attributes:
        fact: as the knowledge base has it.
        readings: of numbers that belong to no entity.
        ranges: its variables, in the order of the atom's arguments.
        known_from: the least value with which something is known.
    """

    fact: ObservedFact
    readings: tuple[_Reading, ...]
    ranges: tuple[_Range, ...]
    known_from: float


@dataclass(frozen=True)
class _Table:
    """A sort, and what is read of its entities.

    Attributes:
        name: of the sort.
        sort: as the knowledge base has it.
        entities: what they are called, row by row.
        columns: field → the part of the observation and the column in it, of what is read.
    """

    name: str
    sort: Sort
    entities: tuple[str, ...]
    columns: Mapping[str, tuple[str, int]]


_Row = tuple[str, tuple[float, ...]]  # an entity: its name, and its numbers in order


class ObservationReader:
    """Reads facts and signals off observations.

    Args:
        kb: the knowledge base that says how.
    """

    def __init__(self, kb: KnowledgeBase) -> None:
        self._kb = kb
        self._tables = {name: self._table(name) for name in kb.entities}
        self._plans = [self._plan(fact) for fact in kb.facts]
        self._signals = {
            name: (formula, [self._reading(used) for used in sorted(formula.names)])
            for name, formula in kb.observed_signals.items()
        }

    @property
    def reads_facts(self) -> bool:
        """Whether the knowledge base says how facts are read, or needs none."""
        return bool(self._kb.facts) or not self._kb.rules

    def facts(self, observation: Observation) -> Facts:
        """Return the facts of an observation.

        Raises:
            FactError: the observation has another form than the knowledge base says, a number that
                is read is NaN, or a confidence is outside of [0, 1].
            UsageError: the knowledge base does not say how facts are read.
        """
        if not self.reads_facts:
            raise UsageError(
                f"'{self._kb.name}' does not say how facts are read off an observation",
                name="facts",
                suggestion="add the sections observation and facts, or make the facts yourself",
            )
        scene = _Scene(self._kb.observation, {"": observation}, FactError)
        rows = {name: _rows(table, scene) for name, table in self._tables.items()}
        facts = Facts(margin=self._kb.grounding.margin)
        for plan in self._plans:
            _add(facts, plan, scene.values(plan.readings), rows)
        return facts

    def signals(
        self,
        observation: Observation,
        action: Observation,
        next_observation: Observation,
        *,
        but: Container[str] = (),
    ) -> dict[str, float]:
        """Return the signals that the knowledge base reads off a transition.

        Args:
            observation: before the action.
            action: may be None where no signal reads it.
            next_observation: after the action; may be None where no signal reads it.
            but: names of signals that are not to be read.

        Raises:
            SignalError: an observation or the action has another form than the knowledge base
                says, a number that is read is NaN, or a signal is.
        """
        wholes = {"": observation, ACTION: action, NEXT: next_observation}
        scene = _Scene(self._kb.observation, wholes, SignalError)
        return {
            name: _signal(name, formula, scene.values(readings))
            for name, (formula, readings) in self._signals.items()
            if name not in but
        }

    def _table(self, name: str) -> _Table:
        sort = self._kb.entities[name]
        read = {
            used.partition(".")[2]
            for fact in self._kb.facts
            for used in fact.formula.names
            if fact.sorts.get(used.partition(".")[0]) == name
        }
        fields = fields_of(self._kb.observation, sort)
        columns = {field: place for field, place in fields.items() if field in read}
        return _Table(name, sort, entity_names(name, sort), columns)

    def _plan(self, fact: ObservedFact) -> _Plan:
        names = {name: name.partition(".") for name in sorted(fact.formula.names)}
        ranges = []
        for variable, sort in fact.sorts.items():
            columns = {field: i for i, field in enumerate(self._tables[sort].columns)}
            fields = [(n, columns[f]) for n, (v, _, f) in names.items() if v == variable]
            ranges.append(_Range(sort, tuple(fields)))
        others = [name for name, (first, *_) in names.items() if first not in fact.sorts]
        readings = tuple(self._reading(name) for name in others)
        return _Plan(fact, readings, tuple(ranges), least(fact.at_least))

    def _reading(self, name: str) -> _Reading:
        first, *rest = name.split(".")
        whole = first if first in (NEXT, ACTION) else ""
        source, *field = rest if first == NEXT else (first, *rest)
        column = self._kb.observation[source].columns[field[0]] if field else 0
        return _Reading(name, whole, source, column)


# -- formulas, entity by entity -----------------------------------------------------------------


def _signal(name: str, formula: Formula, values: Mapping[str, float]) -> float:
    try:
        return formula.maybe_infinite(values)
    except FormulaError as error:
        raise SignalError(
            f"the signal '{name}': {error.message}", name=name, suggestion=error.suggestion
        ) from None


def _add(
    facts: Facts,
    plan: _Plan,
    values: dict[str, float],
    rows: Mapping[str, Sequence[_Row]],
) -> None:
    """Add the atoms of a fact for all entities."""
    fact, margin = plan.fact, 0.0 if plan.fact.exact else facts.margin
    for chosen in product(*(rows[variable.sort] for variable in plan.ranges)):
        for variable, (_, numbers) in zip(plan.ranges, chosen, strict=True):
            for name, column in variable.fields:
                values[name] = numbers[column]
        entities = dict(zip(fact.sorts, (entity for entity, _ in chosen), strict=True))
        confidence = _confidence(fact, entities, values)
        if confidence >= plan.known_from:
            atom = fact.atom.substituted(entities)
            facts.add(atom.predicate, *atom.arguments, bound=Bound.around(confidence, margin))


def _confidence(
    fact: ObservedFact, entities: Mapping[str, str], values: Mapping[str, float]
) -> float:
    try:
        confidence = fact.formula(values)
    except FormulaError as error:
        raise FactError(
            f"{fact.atom.substituted(entities)}: {error.message}",
            name=fact.atom.predicate,
            suggestion=error.suggestion,
        ) from None
    if 0.0 <= confidence <= 1.0:
        return confidence
    raise FactError(
        f"{fact.atom.substituted(entities)}: '{fact.formula}' is {confidence:.6g}",
        name=fact.atom.predicate,
        suggestion="a confidence is from 0 to 1: clip it, or use below, above, between or near",
    )


def _rows(table: _Table, scene: _Scene) -> list[_Row]:
    """Return the entities of a sort that are there."""
    parts = {name: scene.table(name, table.sort.at_most) for name in table.sort.tables}
    counts = {name: len(numbers) for name, (numbers, _) in parts.items()}
    if len({*counts.values()}) > 1:
        shown = " and ".join(f"{count} in '{name}'" for name, count in counts.items())
        raise FactError(
            f"the tables of '{table.name}' have different numbers of rows: {shown}",
            name=table.name,
            suggestion="a row of each is one entity",
        )
    there = np.flatnonzero(np.logical_and.reduce([present for _, present in parts.values()]))
    columns = {
        field: parts[name][0][there, column] for field, (name, column) in table.columns.items()
    }
    for field, numbers in columns.items():
        for row in np.flatnonzero(np.isnan(numbers)):
            scene.refuse_nan(f"{table.entities[there[row]]}.{field}".removesuffix("."))
    numbers = zip(*(column.tolist() for column in columns.values()), strict=True)
    return [(table.entities[row], next(numbers, ())) for row in there.tolist()]


# -- the parts of an observation ----------------------------------------------------------------

_WHOLES = {"": "the observation", NEXT: "the observation after the action", ACTION: "the action"}


class _Scene:
    """What is read at one step.

    Args:
        sources: the parts that it has.
        wholes: the observations and the action that they are parts of.
        error: what is raised where something has another form.
    """

    def __init__(
        self, sources: Mapping[str, Source], wholes: Mapping[str, Observation], error: _Error
    ) -> None:
        self._sources = sources
        self._wholes = wholes
        self._error = error
        self._records: dict[tuple[str, str], list[float]] = {}

    def values(self, readings: Sequence[_Reading]) -> dict[str, float]:
        """Return name → number."""
        values = {}
        for reading in readings:
            values[reading.name] = self._record(reading)[reading.column]
            if math.isnan(values[reading.name]):
                self.refuse_nan(reading.name)
        return values

    def table(self, name: str, at_most: int) -> tuple[_Reals, npt.NDArray[np.bool_]]:
        """Return a table's numbers (n, k), and which of its n rows are there."""
        numbers = self._block("", name, of_rows=True)
        if len(numbers) > at_most:
            message = f"'{name}' has {len(numbers)} rows"
            raise self._error(message, name=name, suggestion=f"at_most says {at_most}")
        return numbers, self._present(name, numbers)

    def refuse_nan(self, what: str) -> NoReturn:
        """Raise the error that a number is NaN."""
        raise self._error(f"{what} is NaN in the observation", name=what)

    def _record(self, reading: _Reading) -> list[float]:
        key = (reading.whole, reading.source)
        if key not in self._records:
            self._records[key] = self._block(*key).tolist()
        return self._records[key]

    def _present(self, name: str, numbers: _Reals) -> npt.NDArray[np.bool_]:
        source = self._sources[name]
        if source.present is None:
            return np.ones(len(numbers), dtype=np.bool_)
        if source.mask is None:
            mask = numbers[:, source.columns[str(source.present)]]
        else:
            mask = self._reals(f"{name}.present", self._at("", source.mask))
        if mask.shape != (len(numbers),):
            raise self._misshapen(f"{name}.present", mask, f"({len(numbers)},)")
        if np.isnan(mask).any():
            self.refuse_nan(f"{name}.present")
        return np.not_equal(mask, 0)

    def _block(self, whole: str, name: str, *, of_rows: bool = False) -> _Reals:
        """Return the numbers of a part of the observation, fields along the last axis."""
        source = self._sources[name]
        part = self._at(whole, source.path)
        if isinstance(part, Mapping):
            numbers = self._by_name(name, part)
        else:
            numbers = self._reals(name, part)
        if not source.columns and numbers.ndim == of_rows:
            numbers = numbers[..., None]
        if numbers.ndim != 1 + of_rows or not _fits(source, numbers.shape[-1]):
            raise self._misshapen(name, numbers, _shape_of(source, of_rows=of_rows))
        return numbers

    def _by_name(self, name: str, part: Mapping[Any, Any]) -> _Reals:
        """Return the numbers of a part whose fields are keys."""
        fields = self._sources[name].fields
        if not isinstance(fields, list):
            keys = ", ".join(map(str, part))
            raise self._error(
                f"'{name}' has the keys {keys:.80}",
                name=name,
                suggestion="one of them may be its key, or some of them its fields",
            )
        columns = [self._reals(f"{name}.{f}", self._under(part, f, name)) for f in fields]
        if len({column.shape for column in columns}) > 1:
            shown = ", ".join(f"{f} {c.shape}" for f, c in zip(fields, columns, strict=True))
            raise self._error(f"the fields of '{name}' have different shapes: {shown}", name=name)
        return np.stack(columns, axis=-1)

    def _at(self, whole: str, path: Sequence[str | int]) -> Any:
        part = self._wholes[whole]
        if part is None:
            raise self._error(f"{_WHOLES[whole]} is not given", name=whole or "observation")
        for key in path:
            part = self._under(part, key, _WHOLES[whole])
        return part

    def _under(self, part: Any, key: str | int, owner: str) -> Any:
        try:
            return part[key]
        except (KeyError, IndexError, TypeError, ValueError):
            known = map(str, part) if isinstance(part, Mapping) else ()
            shape = getattr(part, "shape", None)
            of_shape = "" if shape is None else f" of shape {tuple(shape)}"
            raise self._error(
                f"{owner} has no '{key}'",
                name=str(key),
                suggestion=did_you_mean(str(key), known)
                or f"it is {type(part).__name__}{of_shape} there",
            ) from None

    def _reals(self, name: str, value: object) -> _Reals:
        numbers = arrays.as_reals(value)
        if numbers is None:
            raise self._error(
                f"'{name}' is {value!r:.80}", name=name, suggestion="it must be real numbers"
            )
        return numbers

    def _misshapen(self, name: str, numbers: _Reals, expected: str) -> FactError | SignalError:
        return self._error(
            f"'{name}' has the shape {numbers.shape}",
            name=name,
            suggestion=f"it must have the shape {expected}",
        )


def _fits(source: Source, width: int) -> bool:
    """Tell whether a part may have so many numbers, in a row."""
    if isinstance(source.fields, dict):
        return width > max(source.fields.values())
    return width == max(len(source.columns), 1)


def _shape_of(source: Source, *, of_rows: bool) -> str:
    """Return the shape that a part must have, as text."""
    if not source.columns:
        return "(n,)" if of_rows else "(), a single number"
    width = str(len(source.columns))
    if isinstance(source.fields, dict):
        width = f"{max(source.fields.values()) + 1} or more"
    return f"(n, {width})" if of_rows else f"({width},)"
