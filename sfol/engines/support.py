"""The atoms that support a body, without a walk through all of its substitutions.

A body such as ``Near(X, Y), Behind(X, Z)`` has as many substitutions as there are pairs of a Y and
a Z, but once X is known, Y and Z have nothing to do with each other. So the body is cut where it
falls apart: each part is searched once for each value of the variables that it shares with what
comes before it, and what was found is kept.

Source: the full reducer of acyclic joins, M. Yannakakis, "Algorithms for acyclic database schemes",
VLDB 1981.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import count
from typing import NamedTuple

from sfol.clauses import Body
from sfol.engines.matching import (
    Binder,
    Condition,
    binders,
    chained,
    conditions,
    matcher,
    next_binders,
)
from sfol.engines.tables import Tables
from sfol.facts import Bound
from sfol.literals import Criterion, Search, Step
from sfol.literals.search import Constants
from sfol.syntax import is_variable

Support = dict[tuple[int, Constants], Bound]


class _Match(NamedTuple):
    """One way in which a part holds: the values that it gives, and its own literals' atoms."""

    values: tuple[str, ...]
    atoms: tuple[tuple[tuple[int, Constants], Bound], ...]


_Key = tuple[int, tuple[str, ...]]  # a part's number, and the values that it shares


class Reduction(Search):
    """A search that remembers in which ways each part holds.

    Attributes:
        matches: of each part that was searched.
        open: part's number → the list that is being filled.
    """

    __slots__ = ("matches", "open")

    def __init__(self, tables: Tables, values: list[str], atoms: int, limit: int) -> None:
        super().__init__(tables, values, atoms, visit=lambda search: None, limit=limit)
        self.matches: dict[_Key, list[_Match]] = {}
        self.open: dict[int, list[_Match]] = {}


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a body that shares variables with the rest only by those bound before it.

    Attributes:
        number: its own within the body.
        shared: slots of the variables bound before it that it names.
        own: slots of the variables that its first literals bind.
        rest: the parts into which the remaining literals fall then.
        first: the step that finds its matches.
    """

    number: int
    shared: tuple[int, ...]
    own: tuple[int, ...]
    rest: tuple[Part, ...]
    first: Step

    @property
    def branches(self) -> bool:
        """Whether it holds in more ways than it has to be searched for."""
        before = {*self.shared, *self.own}
        apart = len(self.rest) > 1 or any(set(part.shared) < before for part in self.rest)
        return apart or any(part.branches for part in self.rest)

    def matches(self, search: Reduction) -> list[_Match]:
        """Return every way in which it holds, given the values in its shared slots."""
        key = self._key(search)
        if key not in search.matches:
            search.matches[key] = search.open[self.number] = []
            self.first(search)
        return search.matches[key]

    def collect(self, search: Reduction, support: Support, seen: set[_Key]) -> None:
        """Add the atoms of every way in which it holds."""
        key = self._key(search)
        if key in seen:
            return
        seen.add(key)
        for values, atoms in search.matches[key]:
            support.update(atoms)
            for slot, value in zip(self.own, values, strict=True):
                search.values[slot] = value
            for part in self.rest:
                part.collect(search, support, seen)

    def _key(self, search: Reduction) -> _Key:
        return self.number, tuple([search.values[slot] for slot in self.shared])


@dataclass(frozen=True, eq=False)
class Forest:
    """A body as the parts that have nothing to do with each other."""

    parts: tuple[Part, ...]

    @cached_property  # asked at every evaluation
    def branches(self) -> bool:
        """Whether the body holds in more ways than its parts have to be searched for."""
        binding = [part for part in self.parts if part.own]
        return len(binding) > 1 or any(part.branches for part in binding)

    def holds(self, search: Reduction) -> bool:
        """Tell whether some substitution satisfies the body."""
        return all(part.matches(search) for part in self.parts)

    def support(self, search: Reduction) -> Support:
        """Return every atom that stands for a literal in some substitution, with its bound."""
        support: Support = {}
        if self.holds(search):
            seen: set[_Key] = set()
            for part in self.parts:
                part.collect(search, support, seen)
        return support


def grow(
    body: Body, criterion: Criterion, slots: Mapping[str, int], given: frozenset[str]
) -> Forest:
    """Cut a body into parts.

    Args:
        body: what must hold.
        criterion: when literals hold.
        slots: where in `Search.values` each term stands.
        given: the terms that have a value beforehand, constants included.
    """
    grower = _Grower(slots, given)
    items: list[_Item] = [*binders(body, criterion), *conditions(body, criterion, slots)]
    return Forest(tuple(grower.parts(items, given)))


_Item = Binder | Condition


def _terms(item: _Item) -> frozenset[str]:
    return item.terms if isinstance(item, Condition) else frozenset(item.atom.arguments)


def _keep(
    number: int, own: Sequence[int], literals: Sequence[int], rest: Sequence[Part], search: Search
) -> None:
    """Keep a match of a part's first literals if the rest of it holds as well: the last step."""
    assert isinstance(search, Reduction)
    if all(part.matches(search) for part in rest):
        atoms = tuple([((i, search.keys[i]), search.bounds[i]) for i in literals])
        match = _Match(tuple([search.values[slot] for slot in own]), atoms)
        search.open[number].append(match)


class _Grower:
    """Numbers the parts of one body."""

    def __init__(self, slots: Mapping[str, int], given: frozenset[str]) -> None:
        self._slots = slots
        self._given = given
        self._numbers = count()

    def parts(self, items: Sequence[_Item], known: frozenset[str]) -> Iterator[Part]:
        return (self._part(group, known) for group in _components(items, known))

    def _part(self, items: Sequence[_Item], known: frozenset[str]) -> Part:
        waiting = [item for item in items if not isinstance(item, Condition)]
        pending = [item for item in items if isinstance(item, Condition)]
        varying = known - self._given
        chosen = next_binders(waiting, known, varying) if waiting else ()
        bound = known.union(term for binder in chosen for term in binder.atom.arguments)
        ready = [condition for condition in pending if condition.terms <= bound]
        seen = [b for b in waiting if b not in chosen and bound >= set(b.atom.arguments)]
        here: list[_Item] = [*chosen, *seen, *ready]
        rest = [item for item in items if item not in here]
        number, own = next(self._numbers), self._places(bound - known)
        parts = tuple(self.parts(rest, bound))
        makers = [matcher(chosen, self._slots, known)] if chosen else []
        makers += [matcher([binder], self._slots, bound) for binder in seen]
        makers += [condition.make for condition in ready]
        matched = [item.number for item in here if item.number is not None]
        named = {term for item in items for term in _terms(item)}
        return Part(
            number=number,
            shared=self._places(varying & named),
            own=own,
            rest=parts,
            first=chained(makers, partial(_keep, number, own, matched, parts)),
        )

    def _places(self, terms: Iterable[str]) -> tuple[int, ...]:
        return tuple(sorted(self._slots[term] for term in terms if is_variable(term)))


def _components(items: Sequence[_Item], known: frozenset[str]) -> list[list[_Item]]:
    """Group items that share unknown variables, directly or through others."""
    groups: list[tuple[set[str], list[_Item]]] = []
    for item in items:
        terms, members = set(_terms(item) - known), [item]
        touching = [group for group in groups if group[0] & terms]
        groups = [group for group in groups if not group[0] & terms]
        for group in touching:
            terms |= group[0]
            members = [*group[1], *members]
        groups.append((terms, members))
    return [members for _, members in groups]
