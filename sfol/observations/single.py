"""Facts and signals of one scene.

Every formula is evaluated for every entity that is there, one after the other.
"""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from itertools import product
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from sfol import arrays
from sfol.errors import FactError, FormulaError, SignalError, UsageError
from sfol.facts import Bound, Facts
from sfol.formula import Formula
from sfol.knowledge_base import KnowledgeBase, ObservedFact, Sort, Source
from sfol.observations.plans import (
    NO_CONFIDENCE,
    Error,
    FormulaPlan,
    NameReading,
    Observation,
    ObservedStep,
    Range,
    fits,
    part_at,
    plans_of,
    shape_of,
    under,
    width_of,
)
from sfol.operators import least

_Reals = npt.NDArray[np.float64]

# Of a sort's tables: which rows are there, and the numbers of those, part by part.
_Table = tuple[list[int], dict[str, list[list[float]]]]
_Row = tuple[str, dict[str, float]]  # an entity: its name, and its numbers by name in a formula


class ObservationReader:
    """Reads facts and signals off observations.

    Args:
        kb: the knowledge base that says how.
    """

    def __init__(self, kb: KnowledgeBase) -> None:
        self._kb = kb
        self._sources, self._facts, self._signals = plans_of(kb)

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
        scene = _Scene(self._sources, {"": observation}, FactError)
        facts = Facts(margin=self._kb.grounding.margin)
        for fact, plan in self._facts:
            is_value = fact.atom.predicate in self._kb.attributes
            _add(facts, fact, plan, scene, is_value=is_value)
        return facts

    def signals(
        self,
        step: ObservedStep,
        *,
        but: Container[str] = (),
    ) -> dict[str, float]:
        """Return the signals that the knowledge base reads off a step.

        Args:
            step: what is read.
            but: names of signals that are not to be read.

        Raises:
            SignalError: something is not given or has another form than the knowledge base says, a
                number that is read is NaN, or a signal is.
        """
        scene = _Scene(self._sources, step.wholes, SignalError)
        return {
            name: _signal(name, plan.formula, scene.values(plan))
            for name, plan in self._signals.items()
            if name not in but
        }


# -- formulas, entity by entity -----------------------------------------------------------------


def _signal(name: str, formula: Formula, values: Mapping[str, Any]) -> float:
    try:
        return formula.maybe_infinite(values)
    except FormulaError as error:
        raise SignalError(
            f"the signal '{name}': {error.message}", name=name, suggestion=error.suggestion
        ) from None


def _add(
    facts: Facts, fact: ObservedFact, plan: FormulaPlan, scene: _Scene, *, is_value: bool
) -> None:
    """Add the atoms of a fact, or the values of an attribute, for all entities."""
    shared = scene.values(plan)
    margin = 0.0 if fact.exact else facts.margin
    known_from = least(fact.at_least)
    for chosen in product(*map(scene.rows, plan.variables)):
        values = dict(shared)
        for _, numbers in chosen:
            values.update(numbers)
        entities = dict(zip(fact.sorts, (entity for entity, _ in chosen), strict=True))
        number = _number(fact, entities, values)
        constants = [entities.get(argument, argument) for argument in fact.atom.arguments]
        if is_value:
            facts.add(fact.atom.predicate, *constants, value=number)
        elif _confidence(fact, entities, number) >= known_from:
            bound = Bound.around(number, margin)
            facts.add(fact.atom.predicate, *constants, bound=bound)


def _number(fact: ObservedFact, entities: Mapping[str, str], values: Mapping[str, Any]) -> float:
    try:
        return fact.formula(values)
    except FormulaError as error:
        raise FactError(
            f"{fact.atom.substituted(entities)}: {error.message}",
            name=fact.atom.predicate,
            suggestion=error.suggestion,
        ) from None


def _confidence(fact: ObservedFact, entities: Mapping[str, str], number: float) -> float:
    if 0.0 <= number <= 1.0:
        return number
    raise FactError(
        f"{fact.atom.substituted(entities)}: '{fact.formula}' is {number:.6g}",
        name=fact.atom.predicate,
        suggestion=NO_CONFIDENCE,
    )


# -- the parts of an observation ----------------------------------------------------------------


class _Scene:
    """What is read at one step.

    Args:
        sources: the parts that it has.
        wholes: the observations and the action that they are parts of.
        error: what is raised where something has another form.
    """

    def __init__(
        self, sources: Mapping[str, Source], wholes: Mapping[str, Observation], error: Error
    ) -> None:
        self._sources = sources
        self._wholes = wholes
        self._error = error
        self._records: dict[tuple[str, str], list[float]] = {}
        self._tables: dict[tuple[str, str], _Table] = {}

    def values(self, plan: FormulaPlan) -> dict[str, Any]:
        """Return what a formula reads that has no variable of a fact."""
        values: dict[str, Any] = {}
        for reading in plan.readings:
            values[reading.name] = self._record(reading)[reading.column]
            if math.isnan(values[reading.name]):
                self.refuse_nan(reading.name)
        for key, entities in plan.quantified.items():
            values[key] = [numbers for _, numbers in self.rows(entities)]
        return values

    def rows(self, entities: Range) -> list[_Row]:
        """Return the entities of a range that are there."""
        there, blocks = self._table(entities)
        rows = []
        for index, row in enumerate(there):
            name = entities.entities[row]
            numbers = {r.name: blocks[r.source][index][r.column] for r in entities.readings}
            for used, number in numbers.items():
                if math.isnan(number):
                    self.refuse_nan("".join([name, *used.partition(".")[1:]]))
            rows.append((name, numbers))
        return rows

    def refuse_nan(self, what: str) -> NoReturn:
        """Raise the error that a number is NaN."""
        raise self._error(f"{what} is NaN in the observation", name=what)

    def _record(self, reading: NameReading) -> list[float]:
        key = (reading.whole, reading.source)
        if key not in self._records:
            self._records[key] = self._block(*key).tolist()
        return self._records[key]

    def _table(self, entities: Range) -> _Table:
        """Return which rows of a sort's tables are there, and the numbers of those."""
        key = (entities.whole, entities.name)
        if key not in self._tables:
            self._tables[key] = self._read_table(*key, entities.sort)
        return self._tables[key]

    def _read_table(self, whole: str, name: str, sort: Sort) -> _Table:
        blocks = {part: self._block(whole, part, of_rows=True) for part in sort.tables}
        counts = {part: len(block) for part, block in blocks.items()}
        if len({*counts.values()}) > 1:
            shown = " and ".join(f"{count} in '{part}'" for part, count in counts.items())
            raise self._error(
                f"the tables of '{name}' have different numbers of rows: {shown}",
                name=name,
                suggestion="a row of each is one entity",
            )
        first, count = next(iter(counts.items()))
        if count > sort.at_most:
            raise self._error(
                f"'{first}' has {count} rows", name=first, suggestion=f"at_most says {sort.at_most}"
            )
        masks = [self._present(whole, part, block) for part, block in blocks.items()]
        there = np.flatnonzero(np.logical_and.reduce(masks))
        return there.tolist(), {part: block[there].tolist() for part, block in blocks.items()}

    def _present(self, whole: str, name: str, numbers: _Reals) -> npt.NDArray[np.bool_]:
        source = self._sources[name]
        if source.present is None:
            return np.ones(len(numbers), dtype=np.bool_)
        if source.mask is None:
            mask = numbers[:, source.columns[str(source.present)]]
        else:
            mask = self._reals(f"{name}.present", self._at(whole, source.mask))
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
        if of_rows and numbers.shape == (0,):  # a list of nobody
            numbers = np.zeros((0, width_of(source)))
        elif not source.columns and numbers.ndim == of_rows:
            numbers = numbers[..., None]
        if numbers.ndim != 1 + of_rows or not fits(source, numbers.shape[-1]):
            raise self._misshapen(name, numbers, shape_of(source, ["n"] if of_rows else []))
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
        columns = [self._reals(f"{name}.{f}", under(part, f, name, self._error)) for f in fields]
        if len({column.shape for column in columns}) > 1:
            shown = ", ".join(f"{f} {c.shape}" for f, c in zip(fields, columns, strict=True))
            raise self._error(f"the fields of '{name}' have different shapes: {shown}", name=name)
        return np.stack(columns, axis=-1)

    def _at(self, whole: str, path: Sequence[str | int]) -> Any:
        return part_at(self._wholes[whole], path, whole, self._error)

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
