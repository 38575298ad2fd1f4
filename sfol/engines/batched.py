"""Evaluation of batches: arithmetic on the bounds of all scenes at once.

It gives what the compiled engine gives scene by scene. The groundings of a batch are known; whether
they hold, and their bounds, are left to compute.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from sfol.arrays import Array, Backend
from sfol.engines.batch import Batch, Groundings, Patterns, Stratum
from sfol.facts import TRUE, Bound
from sfol.knowledge_base import Semantics
from sfol.operators import BEST, DISJUNCTIONS, Gathering, Operator


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds of many atoms.

    Attributes:
        lower: float (n,), τ⁻.
        upper: float (n,), τ⁺.
        known: bool (n,), whether there is a bound at all; the numbers mean nothing otherwise.
    """

    lower: Array
    upper: Array
    known: Array

    def times(self, certainty: Bound) -> Bounds:
        """Return the bounds of what follows from these with a certainty."""
        if certainty == TRUE:
            return self
        return Bounds(self.lower * certainty.lower, self.upper * certainty.upper, self.known)

    def equals(self, other: Bounds, backend: Backend) -> bool:
        """Tell whether other bounds are the same to the last bit."""
        ends = (self.lower, other.lower), (self.upper, other.upper), (self.known, other.known)
        return all(np.array_equal(backend.plain(one), backend.plain(two)) for one, two in ends)


def conclude(batch: Batch, backend: Backend) -> dict[str, Bounds]:
    """Return the bounds of the subject's heads.

    Args:
        batch: B scenes.
        backend: the library of arrays to compute with.

    Returns:
        Unary head → its bounds in the B scenes.
    """
    evaluation = _Evaluation(batch, backend)
    strata = {stratum.head: stratum for stratum in batch.strata}
    heads: dict[str, Bounds] = {}
    for component in batch.program.strata:
        heads |= evaluation.component(
            [strata[head] for head in component.predicates], recursive=component.recursive
        )
    return {
        head: evaluation.by_scene(strata[head], bounds)
        for head, bounds in heads.items()
        if head in batch.program.subject_heads
    }


class _Evaluation:
    """One evaluation of a batch; the bounds of concluded atoms are filled in stratum by stratum.

    It is what its literals see as `sfol.literals.literal.BatchBounds`.
    """

    def __init__(self, batch: Batch, backend: Backend) -> None:
        semantics: Semantics = batch.program.knowledge_base.semantics
        self._disjunction: Operator = DISJUNCTIONS[semantics.disjunction]
        self._gathers = batch.program.gathers
        self._conjunctions = batch.program.conjunctions
        self._batch = batch
        self.backend = backend
        self._lower = backend.real(batch.lower)
        self._upper = backend.real(batch.upper)
        self._known = backend.array(batch.known)
        self._possible = self._known & (self._upper > 0.0)
        self._given = Bounds(self._lower, self._upper, self._known)

    def component(self, strata: Sequence[Stratum], *, recursive: bool) -> dict[str, Bounds]:
        """Conclude heads in every scene; those that depend on each other until nothing changes."""
        found = {stratum.head: self.stratum(stratum) for stratum in strata}
        while recursive:
            before, found = found, {stratum.head: self.stratum(stratum) for stratum in strata}
            recursive = not all(found[head].equals(before[head], self.backend) for head in found)
        return found

    def stratum(self, stratum: Stratum) -> Bounds:
        """Conclude one head in every scene."""
        if stratum.patterns is not None:
            self._match(stratum.patterns)
        disjuncts = [self._asserted(stratum.rows)]
        disjuncts += [self._concluded(rule, len(stratum.rows)) for rule in stratum.rules]
        concluded = self._either(disjuncts)
        if stratum.head in self._batch.program.read_heads:
            self._put(stratum.rows, concluded)
        return concluded

    def by_scene(self, stratum: Stratum, bounds: Bounds) -> Bounds:
        """Return the bounds of the subject's atom in each scene; unknown where there is none."""
        backend, size = self.backend, self._batch.size
        chosen = stratum.scenes >= 0
        scenes = backend.array(stratum.scenes[chosen])
        numbers = backend.array(chosen.nonzero()[0])
        return Bounds(
            backend.put(backend.full(size, 0.0), scenes, backend.take(bounds.lower, numbers)),
            backend.put(backend.full(size, 0.0), scenes, backend.take(bounds.upper, numbers)),
            backend.put(backend.full(size, False), scenes, backend.take(bounds.known, numbers)),
        )

    def _match(self, patterns: Patterns) -> None:
        """Give patterns the greatest bounds of the atoms that they stand for."""
        backend, count = self.backend, len(patterns.rows)
        atoms, of = self._at(patterns.atoms), backend.array(patterns.of)
        groups = of[atoms.known]
        known = backend.count_of(groups, count) > 0.0
        lower, upper = (
            backend.where(known, backend.largest_of(end[atoms.known], groups, count), 0.0)
            for end in (atoms.lower, atoms.upper)
        )
        self._put(patterns.rows, Bounds(lower, upper, known))

    def _put(self, rows: Any, bounds: Bounds) -> None:
        rows = self.backend.array(rows)
        self._lower = self.backend.put(self._lower, rows, bounds.lower)
        self._upper = self.backend.put(self._upper, rows, bounds.upper)
        self._known = self.backend.put(self._known, rows, bounds.known)
        self._possible = self._known & (self._upper > 0.0)

    def _asserted(self, rows: Any) -> Bounds:
        """Return the bounds of some atoms before any conclusion."""
        rows, given = self.backend.array(rows), self._given
        take = self.backend.take
        return Bounds(take(given.lower, rows), take(given.upper, rows), take(given.known, rows))

    def _at(self, rows: Any) -> Bounds:
        rows = self.backend.array(rows)
        take = self.backend.take
        return Bounds(take(self._lower, rows), take(self._upper, rows), take(self._known, rows))

    def lower(self, rows: Array) -> Array:
        """Return the lower bounds of some atoms."""
        return self.backend.take(self._lower, rows)

    def upper(self, rows: Array) -> Array:
        """Return the upper bounds of some atoms."""
        return self.backend.take(self._upper, rows)

    def known(self, rows: Array) -> Array:
        """Tell which of some atoms are known."""
        return self.backend.take(self._known, rows)

    def possible(self, rows: Array) -> Array:
        """Tell which of some atoms are known and have an upper bound above 0."""
        return self.backend.take(self._possible, rows)

    def _concluded(self, rule: Groundings, heads: int) -> Bounds:
        """Return what one rule concludes."""
        # Chosen here: a bound method kept in self would be a cycle, which keeps its arrays alive
        # until the garbage collector comes by.
        gathering = self._gathers[rule.rule.name]
        if gathering is None:
            bounds = self._pooled(rule, heads)
        elif gathering is BEST:
            bounds = self._best(rule, heads)
        else:
            bounds = self._gathered(rule, heads, gathering)
        return bounds.times(rule.rule.certainty)

    def _satisfying(self, rule: Groundings) -> Array:
        """Tell which substitutions satisfy the body."""
        holds = (
            literal.batch_holds(self, self.backend.array(rows), rule.rule)
            for literal, rows in zip(rule.literals, rule.rows, strict=True)
        )
        return reduce(operator.and_, holds)

    def _pooled(self, rule: Groundings, heads: int) -> Bounds:
        """Combine each literal's distinct atoms, all together."""
        backend, pool = self.backend, self._conjunctions[rule.rule.name].pooled
        assert pool is not None  # a checked knowledge base pools only where that is defined
        satisfies = self._satisfying(rule)
        lower = upper = count = backend.full(heads, 0.0)
        for literal, pairs in zip(rule.literals, rule.pairs, strict=True):
            used = backend.any_of(satisfies, backend.array(pairs.of), len(pairs.rows))
            groups = backend.array(pairs.heads)[used]
            lowers, uppers = literal.batch_bounds(self, backend.array(pairs.rows)[used])
            lower = lower + backend.sum_of(lowers, groups, heads)
            upper = upper + backend.sum_of(uppers, groups, heads)
            count = count + backend.count_of(groups, heads)
        atoms = backend.maximum(count, 1.0)
        return Bounds(pool(lower, atoms), pool(upper, atoms), count > 0.0)

    def _best(self, rule: Groundings, heads: int) -> Bounds:
        """Combine per substitution, then take the greatest of lowers and of uppers."""
        backend, (groups, ends) = self.backend, self._combined(rule)
        known = backend.count_of(groups, heads) > 0.0
        lower, upper = (
            backend.where(known, backend.largest_of(end, groups, heads), 0.0) for end in ends
        )
        return Bounds(lower, upper, known)

    def _gathered(self, rule: Groundings, heads: int, gathering: Gathering) -> Bounds:
        """Combine per substitution, then let a gathering make one of all of a head."""
        backend, (groups, ends) = self.backend, self._combined(rule)
        known = backend.count_of(groups, heads) >= gathering.needed
        rows = (backend.rows_of(end, groups, heads, gathering.absent) for end in ends)
        lower, upper = (
            backend.where(known, gathering.along(backend, row, 1).reshape(heads), 0.0)
            for row in rows
        )
        return Bounds(lower, upper, known)

    def _combined(self, rule: Groundings) -> tuple[Array, tuple[Array, Array]]:
        """Return of the substitutions that satisfy a body their heads, and what each comes to."""
        backend, conjunction = self.backend, self._conjunctions[rule.rule.name]
        satisfies = self._satisfying(rule)
        bounds = [
            literal.batch_bounds(self, backend.array(rows)[satisfies])
            for literal, rows in zip(rule.literals, rule.rows, strict=True)
        ]
        ends = (
            conjunction.elementwise([lower for lower, _ in bounds]),
            conjunction.elementwise([upper for _, upper in bounds]),
        )
        return backend.array(rule.heads)[satisfies], ends

    def _either(self, disjuncts: Sequence[Bounds]) -> Bounds:
        """Combine rules that share a head; what is unknown is 0, which changes no disjunction."""
        known = disjuncts[0].known
        for other in disjuncts[1:]:
            known = known | other.known
        combine, where = self._disjunction.elementwise, self.backend.where
        return Bounds(
            combine([where(d.known, d.lower, 0.0) for d in disjuncts]),
            combine([where(d.known, d.upper, 0.0) for d in disjuncts]),
            known,
        )
