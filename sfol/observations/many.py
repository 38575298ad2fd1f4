"""Facts and signals of many scenes: arrays with a leading axis B, of numpy or torch.

Numbers are turned so that scenes are along the last axis, and entities before it: a field of n
entities is (n, B). Every formula is evaluated for all scenes and entities at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from sfol import arrays
from sfol.arrays import Array, Backend
from sfol.errors import FactError, SignalError
from sfol.formula import Entities
from sfol.knowledge_base import KnowledgeBase, ObservedFact, Source
from sfol.observations.plans import (
    NO_CONFIDENCE,
    NO_VALUE,
    Error,
    FormulaPlan,
    Observation,
    ObservedStep,
    PartName,
    Range,
    compared_plans_of,
    fits,
    part_at,
    parts_of,
    plans_of,
    read_for_facts,
    shape_of,
    under,
)
from sfol.operators import least
from sfol.syntax import Compared, Comparing

_FACTS = "facts"  # the observation that facts are read off, beside the wholes of a step
Key = tuple[str, tuple[str, ...]]  # a predicate, and for each argument its sort or constant


class Block(NamedTuple):
    """The bounds of a predicate's atoms for entities of some sorts, and constants.

    Attributes:
        lower: (n, B) or (n, m, B), τ⁻; n is 1 for a constant.
        upper: the same, τ⁺.
        known: truth values: which atoms are known; what is unknown has some bound, too.
    """

    lower: Array
    upper: Array
    known: Array


class _Part(NamedTuple):
    """A part of the observation: (k, B), or (k, n, B) for a table, and which rows are there."""

    numbers: Array
    there: Array | None


@dataclass(frozen=True)
class Scenes:
    """What was read of many scenes.

    Attributes:
        size: B.
        backend: the library of the arrays.
        sizes: sort → how many rows its tables have.
        blocks: the facts.
        signals: name → (B,), or a number.
    """

    size: int
    backend: Backend
    sizes: Mapping[str, int]
    blocks: Mapping[Key, Block]
    signals: Mapping[str, Array]


class ScenesReader:
    """Reads facts and signals off observations of many scenes.

    Args:
        kb: the knowledge base that says how.
    """

    def __init__(self, kb: KnowledgeBase) -> None:
        self._kb = kb
        self._sources, self._facts, self._signals = compared_plans_of(kb)

    @property
    def keys(self) -> list[Key]:
        """The keys of the blocks that are read."""
        return [(fact.atom.predicate, fact.slots[1:]) for fact, _ in self._facts]

    def has_many(self, step: ObservedStep) -> bool:
        """Tell whether a step is of many scenes.

        The first part that is a table or has fields shows it by its number of axes. Where all parts
        are single numbers, one that is an array of several numbers does.
        """
        wholes = {**step.wholes, _FACTS: read_for_facts(self._kb, step)}
        parts = [part for part in self._parts if wholes[part[0]] is not None]
        shaped = [p for p in parts if p[2] or self._sources[p[1]].columns]
        for name, source, of_rows in shaped[:1] or parts:
            spec = self._sources[source]
            whole = "" if name == _FACTS else name
            part = part_at(wholes[name], spec.path, whole, FactError)
            by_name = isinstance(part, Mapping)
            shape = _shape(next(iter(part.values()), 0.0) if by_name else part)
            if shaped:
                return len(shape) > of_rows + (bool(spec.columns) and not by_name)
            if shape not in ((), (1,)):
                return True
        return False

    @cached_property  # asked at every step
    def _parts(self) -> list[PartName]:
        """What formulas read: first of the observation that facts are read off."""
        facts = [part for _, plan in plans_of(self._kb).facts for part in parts_of(plan)]
        signals = [part for plan in self._signals.values() for part in parts_of(plan)]
        own = [(_FACTS, source, of_rows) for _, source, of_rows in facts]
        return [*dict.fromkeys([*own, *sorted(signals, key=lambda part: part[0] != "")])]

    def read(
        self,
        step: ObservedStep,
        *,
        given: Mapping[str, Array],
        numbers: Sequence[Array] = (),
    ) -> Scenes:
        """Return the facts and signals of B steps.

        Args:
            step: arrays as the knowledge base says, with an axis B before all others.
            given: signals that are not read.
            numbers: others of the computation, whose library of arrays counts, too.

        Raises:
            FactError: an observation has another form, a number that is read is NaN, or a
                confidence is not from 0 to 1.
            SignalError: the same of what signals read, or a signal is NaN.
        """
        signals = {name: plan for name, plan in self._signals.items() if name not in given}
        observed = {"": read_for_facts(self._kb, step)}
        facts = _Scenes(self._sources, observed, FactError, [plan for _, plan in self._facts])
        others = _Scenes(self._sources, step.wholes, SignalError, [*signals.values()])
        leaves = [*facts.leaves, *others.leaves, *given.values(), *numbers]
        backend = arrays.backend_of(leaves)
        size = _size([*facts.leaves, *others.leaves])
        facts.turn(backend, size)
        others.turn(backend, size)
        margin = self._kb.grounding.margin
        return Scenes(
            size,
            backend,
            facts.sizes,
            {
                key: _block(fact, plan, facts, margin)
                for key, (fact, plan) in zip(self.keys, self._facts, strict=True)
            },
            {name: _signal(name, plan, others) for name, plan in signals.items()},
        )


def _shape(value: Any) -> tuple[int, ...]:
    """Return the shape of an array, or of lists by their first elements."""
    shape = getattr(value, "shape", None)
    if shape is not None:
        return tuple(shape)
    sizes = []
    while isinstance(value, list | tuple):
        sizes.append(len(value))
        value = value[0] if value else None
    return tuple(sizes)


def _size(leaves: Sequence[Array]) -> int:
    """Return B, the number of scenes."""
    sizes = {leaf.shape[0] for leaf in leaves if leaf.ndim}
    if len(sizes) == 1:
        return int(sizes.pop())
    raise FactError(
        f"parts of the observations have different numbers of scenes: {sorted(sizes)}",
        name="observation",
        suggestion="their first axis is the same for all",
    )


class _Scenes:
    """What is read of the observations: arrays as they were given, then turned.

    Args:
        sources: the parts of an observation, and of a step.
        wholes: the observations and the actions.
        error: what is raised where something has another form.
        plans: of the formulas.
    """

    def __init__(
        self,
        sources: Mapping[str, Source],
        wholes: Mapping[str, Observation],
        error: Error,
        plans: Sequence[FormulaPlan],
    ) -> None:
        self._sources = sources
        self._wholes = wholes
        self._error = error
        self._plans = plans
        parts = dict.fromkeys(part for plan in plans for part in parts_of(plan))
        self._given = {part: self._columns(*part) for part in parts}
        self._masks = {
            (name, source): self._array(part_at(wholes[name], mask, name, error, many=True), source)
            for name, source, of_rows in parts
            if of_rows and (mask := self._sources[source].mask) is not None
        }
        self._parts: dict[tuple[str, str], _Part] = {}
        self.sizes: dict[str, int] = {}

    @property
    def leaves(self) -> list[Array]:
        """All arrays that are read."""
        return [array for columns in self._given.values() for array in columns] + [
            *self._masks.values()
        ]

    def turn(self, backend: Backend, size: int) -> None:
        """Bring all arrays into the form in which they are computed with."""
        self.backend = backend
        self.size = size
        for (name, source, of_rows), columns in self._given.items():
            self._parts[name, source] = self._turned(name, source, columns, of_rows=of_rows)
        for plan in self._plans:
            for entities in (*plan.variables, *plan.quantified.values()):
                self._check_rows(entities)
        for (name, source), part in self._parts.items():
            if arrays.has_nan(part.numbers):
                self._parts[name, source] = self._without_nan(name, source, part)

    def values(self, plan: FormulaPlan) -> dict[str, Any]:
        """Return what a formula reads, with an axis for each of the fact's variables."""
        rank = len(plan.variables)
        values: dict[str, Any] = {
            r.name: self._parts[r.whole, r.source].numbers[r.column] for r in plan.readings
        }
        for axis, entities in enumerate(plan.variables):
            at = tuple(slice(None) if i == axis else None for i in range(rank))
            for r in entities.readings:
                values[r.name] = self._parts[r.whole, r.source].numbers[r.column][at]
        for key, entities in plan.quantified.items():
            at = (slice(None), *[None] * rank)
            numbers = {
                r.name: self._parts[r.whole, r.source].numbers[r.column][at]
                for r in entities.readings
            }
            values[key] = Entities(numbers, self.there(entities)[at])
        return values

    def there(self, entities: Range) -> Array:
        """Tell which entities of a sort are there: (n, B)."""
        masks = [self._parts[entities.whole, table].there for table in entities.sort.tables]
        known = [mask for mask in masks if mask is not None]
        if not known:
            count = self.rows(entities)
            return self.backend.broadcast(self.backend.full(1, True), (count, self.size))
        there = known[0]
        for mask in known[1:]:
            there = there & mask
        return there

    def rows(self, entities: Range) -> int:
        """Return how many rows the tables of a sort have."""
        return int(self._parts[entities.whole, entities.sort.tables[0]].numbers.shape[1])

    # -- reading ------------------------------------------------------------------------------

    def _columns(self, name: str, source: str, of_rows: bool) -> list[Array]:
        """Return the arrays of a part: one for all fields, or one for each."""
        spec = self._sources[source]
        whole = part_at(self._wholes[name], spec.path, name, self._error, many=True)
        fields = spec.fields
        if isinstance(whole, Mapping) and isinstance(fields, list):
            columns = [
                self._array(under(whole, field, source, self._error), source) for field in fields
            ]
            shapes = {tuple(column.shape) for column in columns}
            if len(shapes) > 1 or columns[0].ndim != 1 + of_rows:
                shown = ", ".join(map(str, sorted(shapes)))
                raise self._misshapen(source, shown, "(B, n)" if of_rows else "(B,)")
            return columns
        array = self._array(whole, source)
        before = ["B", "n"] if of_rows else ["B"]
        if not spec.columns and array.ndim == 1 + of_rows:
            array = array[..., None]
        if array.ndim != 2 + of_rows or not fits(spec, array.shape[-1]):
            raise self._misshapen(source, str(tuple(array.shape)), shape_of(spec, before))
        return [array]

    def _array(self, value: Any, name: str) -> Array:
        if arrays.is_array(value) and arrays.is_real(value):
            return value
        numbers = None if arrays.is_array(value) else arrays.as_reals(value)
        if numbers is None:
            raise self._error(
                f"'{name}' is {value!r:.80}", name=name, suggestion="it must be real numbers"
            )
        return numbers

    def _turned(self, name: str, source: str, columns: Sequence[Array], *, of_rows: bool) -> _Part:
        backend = self.backend
        if len(columns) == 1 and columns[0].ndim == 2 + of_rows:
            numbers = backend.turned(backend.real(columns[0]))
        else:
            numbers = backend.stacked([backend.turned(backend.real(c)) for c in columns])
        if not of_rows:
            return _Part(numbers, None)
        spec, mask = self._sources[source], self._masks.get((name, source))
        if mask is not None:
            if tuple(mask.shape) != (self.size, numbers.shape[1]):
                expected = f"({self.size}, {numbers.shape[1]})"
                raise self._misshapen(f"{source}.present", str(tuple(mask.shape)), expected)
            if arrays.has_nan(mask):
                raise self._error(f"{source}.present is NaN", name=source)
            return _Part(numbers, backend.turned(backend.array(mask)) != 0)
        if spec.present is not None:
            return _Part(numbers, numbers[spec.columns[str(spec.present)]] != 0)
        return _Part(numbers, None)

    def _check_rows(self, entities: Range) -> None:
        counts = {
            table: int(self._parts[entities.whole, table].numbers.shape[1])
            for table in entities.sort.tables
        }
        first, count = next(iter(counts.items()))
        if len({*counts.values()}) > 1:
            shown = " and ".join(f"{count} in '{table}'" for table, count in counts.items())
            raise self._error(
                f"the tables of '{entities.name}' have different numbers of rows: {shown}",
                name=entities.name,
                suggestion="a row of each is one entity",
            )
        if count > entities.sort.at_most:
            raise self._error(
                f"'{first}' has {count} rows",
                name=first,
                suggestion=f"at_most says {entities.sort.at_most}",
            )
        if not entities.whole:
            self.sizes[entities.name] = count

    def _without_nan(self, name: str, source: str, part: _Part) -> _Part:
        """Refuse NaN in what is read, and take it for 0 elsewhere."""
        backend = self.backend
        isnan = part.numbers != part.numbers
        for plan in self._plans:
            for r in plan.readings:
                if (r.whole, r.source) == (name, source):
                    self._refuse(isnan[r.column], [r.name])
            for entities in (*plan.variables, *plan.quantified.values()):
                for r in entities.readings:
                    if (r.whole, r.source) == (name, source):
                        field = r.name.partition(".")[1:]
                        names = ["".join([entity, *field]) for entity in entities.entities]
                        self._refuse(isnan[r.column] & self.there(entities), names)
        return _Part(backend.where(isnan, 0.0, part.numbers), part.there)

    def _refuse(self, wrong: Array, names: Sequence[str]) -> None:
        """Raise the error that a number is NaN, with its name and scene, if one is."""
        found = np.argwhere(arrays.plain(wrong))
        if len(found):
            *rows, scene = found[0].tolist()
            what = names[rows[0] if rows else 0]
            raise self._error(f"{what} is NaN in scene {scene}", name=what)

    def _misshapen(self, name: str, shape: str, expected: str) -> FactError | SignalError:
        return self._error(
            f"'{name}' has the shape {shape}",
            name=name,
            suggestion=f"it must have the shape {expected}",
        )


def _block(fact: ObservedFact, plan: FormulaPlan, scenes: _Scenes, margin: float) -> Block:
    backend = scenes.backend
    rank = len(plan.variables)
    shape = (*(scenes.rows(entities) for entities in plan.variables), scenes.size)
    value = backend.real(fact.formula.unchecked(scenes.values(plan)))
    comparison = _comparison(fact)
    confidence = value if comparison is None else backend.real(comparison.truths(value))
    known = backend.full(1, True)
    for axis, entities in enumerate(plan.variables):
        at = tuple(slice(None) if i == axis else None for i in range(rank))
        known = known & scenes.there(entities)[at]
    is_bounded = (value >= 0.0) & (value <= 1.0)
    proper = is_bounded if comparison is None else abs(value) < math.inf
    if not bool(proper.all()):
        if not bool((proper | ~known).all()):
            raise _no_confidence(fact, plan, value, known & ~proper, shape)
        confidence = backend.where(proper, confidence, 0.0)
    if fact.at_least > 0.0:
        known = known & (confidence >= least(fact.at_least, backend.tolerance))
    spread = 0.0 if fact.exact else margin * confidence
    at = _axes(fact)
    lower = confidence - spread
    upper = backend.minimum(confidence + spread, 1.0)
    return Block(*(backend.broadcast(a, shape)[at] for a in (lower, upper, known)))


def _comparison(fact: ObservedFact) -> Comparing | None:
    """Return what is asked of the value that is read; None where it is a confidence itself."""
    predicate = fact.atom.predicate
    return predicate.operator if isinstance(predicate, Compared) else None


def _axes(fact: ObservedFact) -> tuple[slice | None, ...]:
    """Return the index that gives constants an axis of their own."""
    return tuple(slice(None) if a in fact.sorts else None for a in fact.atom.arguments)


def _no_confidence(
    fact: ObservedFact, plan: FormulaPlan, value: Array, wrong: Array, shape: tuple[int, ...]
) -> FactError:
    values = np.broadcast_to(arrays.plain(value), shape)
    *rows, scene = np.argwhere(np.broadcast_to(arrays.plain(wrong), shape))[0].tolist()
    entities = {
        variable: entities.entities[row]
        for variable, entities, row in zip(fact.sorts, plan.variables, rows, strict=True)
    }
    found = float(values[(*rows, scene)])
    atom, suggestion = fact.atom.substituted(entities), NO_CONFIDENCE
    if isinstance(atom.predicate, Compared):
        atom, suggestion = atom.predicate.of(atom.arguments), NO_VALUE
    return FactError(
        f"{atom} in scene {scene}: '{fact.formula}' is {found:.6g}",
        name=atom.predicate,
        suggestion=suggestion,
    )


def _signal(name: str, plan: FormulaPlan, scenes: _Scenes) -> Array:
    value = scenes.backend.real(plan.formula.unchecked(scenes.values(plan)))
    if arrays.has_nan(value):
        raise SignalError(f"the signal '{name}' is NaN: '{plan.formula}'", name=name)
    return scenes.backend.broadcast(value, (scenes.size,))
