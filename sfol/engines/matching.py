"""Matching the literals of a body one after the other.

Every literal and guard becomes a step: a function that calls the next one for every way in which it
can hold. Steps are chosen so that each has as many arguments known as can be.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from functools import partial
from typing import NamedTuple

from sfol.engines.tables import Constants, Row, Tables
from sfol.facts import TRUE, Bound
from sfol.knowledge_base import EntityCondition, Rule
from sfol.operators import negation
from sfol.syntax import Atom, Body


class Criterion(NamedTuple):
    """When literals hold."""

    positive: Callable[[Bound], bool]
    negated: Callable[[Bound], bool]


def rule_criterion(rule: Rule) -> Criterion:
    """Return when the literals of a rule hold.

    A positive literal holds if its upper bound is above 0 and its lower bound reaches the rule's
    threshold; a negated one, with the bound [1 − u, 1 − l], if that lower bound reaches the
    negation threshold.
    """
    threshold, negation_threshold = rule.threshold, rule.negation_threshold
    return Criterion(
        positive=lambda bound: bound[1] > 0.0 and bound[0] >= threshold,
        negated=lambda bound: 1.0 - bound[1] >= negation_threshold,
    )


def condition_criterion(condition: EntityCondition) -> Criterion:
    """Return when the literals of an entity weight's condition count: by their confidence."""
    return Criterion(
        positive=lambda bound: bound.midpoint >= condition.at_least,
        negated=lambda bound: 1.0 - bound.midpoint >= condition.at_least,
    )


class Search:
    """One run of a plan over the tables of a scene.

    Attributes:
        tables: the scene.
        values: the constant in each slot of the plan; variables first, then the rule's constants.
        keys: the ground arguments of each literal, where it is matched.
        bounds: the bound of each literal, where it is matched.
        visit: called for every substitution that satisfies the body.
    """

    __slots__ = ("bounds", "keys", "tables", "values", "visit")

    def __init__(
        self, tables: Tables, values: list[str], literals: int, visit: Callable[[Search], None]
    ) -> None:
        self.tables = tables
        self.values = values
        self.keys: list[Constants] = [()] * literals
        self.bounds: list[Bound] = [TRUE] * literals
        self.visit = visit


Step = Callable[[Search], None]

Make = Callable[[Step], Step]
Indexed = tuple[int, Atom]  # a literal's atom, after its index in the body


class Condition(NamedTuple):
    """A negated literal or a guard, to be checked as soon as its terms are known.

    Attributes:
        terms: its variables and constants.
        literal: the literal's index in the body; None for a guard.
        make: makes its step.
    """

    terms: frozenset[str]
    literal: int | None
    make: Make


def positive_literals(body: Body) -> list[Indexed]:
    """Return the literals that bind variables."""
    return [(i, literal.atom) for i, literal in enumerate(body.literals) if not literal.negated]


def conditions(body: Body, criterion: Criterion, slots: Mapping[str, int]) -> list[Condition]:
    """Return the negated literals and the guards."""
    negated = [
        Condition(frozenset(atom.arguments), i, partial(_refute, i, atom, criterion, slots))
        for i, (atom, is_negated) in enumerate(body.literals)
        if is_negated
    ]
    guards = [
        Condition(frozenset((left, right)), None, partial(_differ, slots[left], slots[right]))
        for left, right in body.guards
    ]
    return [*negated, *guards]


def makers(
    body: Body, criterion: Criterion, slots: Mapping[str, int], given: frozenset[str]
) -> Iterator[Make]:
    """Yield the makers of a body's steps in the order in which they are tried.

    Args:
        body: literals and guards.
        criterion: when literals hold.
        slots: where in `Search.values` each term stands.
        given: the terms that have a value beforehand, constants included.
    """
    known = set(given)
    waiting, pending = positive_literals(body), conditions(body, criterion, slots)
    while waiting or pending:
        yield from (condition.make for condition in pending if condition.terms <= known)
        pending = [condition for condition in pending if not condition.terms <= known]
        if waiting:
            chosen = next_literals(waiting, known, known - given)
            waiting = [literal for literal in waiting if literal not in chosen]
            yield matcher(chosen, criterion, slots, known)
            known.update(term for _, atom in chosen for term in atom.arguments)


def next_literals(
    waiting: Sequence[Indexed], known: Set[str], varying: Set[str]
) -> Sequence[Indexed]:
    """Return the literals to match next: one, or all unary ones that share a variable.

    What is wholly known is looked up at once. Then variables are bound one by one: beside a
    variable that takes many values by an index, since that happens once for each of them;
    otherwise by the shortest of the unary relations that hold it.

    Args:
        waiting: the literals that are left.
        known: the terms that have a value.
        varying: those among them that take many.
    """

    def half(terms: Set[str]) -> list[Indexed]:
        return [lit for lit in waiting if len(terms & set(lit[1].arguments)) == 1]

    looked_up = [lit for lit in waiting if known >= set(lit[1].arguments)]
    if looked_up or half(varying):
        return (looked_up or half(varying))[:1]
    unary = [lit for lit in waiting if len(lit[1].arguments) == 1]
    if unary:
        beside_known = {term for _, atom in half(known) for term in atom.arguments}
        first = next((lit for lit in unary if beside_known.issuperset(lit[1].arguments)), unary[0])
        return [lit for lit in unary if lit[1].arguments == first[1].arguments]
    return (half(known) or waiting)[:1]


def matcher(
    chosen: Sequence[Indexed], criterion: Criterion, slots: Mapping[str, int], known: Set[str]
) -> Make:
    """Return the maker of the step that matches what `next_literals` chose."""
    i, atom = chosen[0]
    if known >= set(atom.arguments):
        return partial(_look_up, i, atom, criterion, slots)
    if len(atom.arguments) == 1:
        predicates = [(j, other.predicate) for j, other in chosen]
        return partial(_meet, predicates, criterion, slots[atom.arguments[0]])
    places = [_Place(at, slots[term], term in known) for at, term in enumerate(atom.arguments)]
    return partial(_scan, i, atom.predicate, criterion, places)


class _Place(NamedTuple):
    """An argument's position in its atom, its slot, and whether it has a value by then."""

    position: int
    slot: int
    known: bool


def visit(search: Search) -> None:
    """Call the visitor: the last step."""
    search.visit(search)


def chained(makers_in_order: Iterable[Make], last: Step) -> Step:
    """Return the first of a chain of steps, of which each calls the next."""
    step = last
    for make in reversed(list(makers_in_order)):
        step = make(step)
    return step


def _key_maker(atom: Atom, slots: Mapping[str, int]) -> Callable[[list[str]], Constants]:
    """Return the function that reads an atom's ground arguments off the slots."""
    if len(atom.arguments) == 1:
        only = slots[atom.arguments[0]]
        return lambda values: (values[only],)
    left, right = (slots[term] for term in atom.arguments)
    return lambda values: (values[left], values[right])


def _look_up(
    i: int, atom: Atom, criterion: Criterion, slots: Mapping[str, int], then: Step
) -> Step:
    """Match a positive literal all of whose arguments are known."""
    predicate, holds, key_of = atom.predicate, criterion.positive, _key_maker(atom, slots)

    def step(search: Search) -> None:
        key = key_of(search.values)
        bound = search.tables.rows(predicate).get(key)
        if bound is not None and holds(bound):
            search.keys[i] = key
            search.bounds[i] = bound
            then(search)

    return step


def _meet(literals: Sequence[tuple[int, str]], criterion: Criterion, slot: int, then: Step) -> Step:
    """Match unary literals of one free variable: walk through the shortest, look up the others."""
    holds = criterion.positive

    def step(search: Search) -> None:
        values, keys, bounds = search.values, search.keys, search.bounds
        relations = [(i, search.tables.rows(predicate)) for i, predicate in literals]
        for key in min([rows for _, rows in relations], key=len):
            for i, rows in relations:
                bound = rows.get(key)
                if bound is None or not holds(bound):
                    break
                keys[i] = key
                bounds[i] = bound
            else:
                values[slot] = key[0]
                then(search)

    return step


def _scan(
    i: int, predicate: str, criterion: Criterion, places: Sequence[_Place], then: Step
) -> Step:
    """Match a binary literal in every way that its known argument, if any, leaves open."""
    holds = criterion.positive
    fixed = [(place.position, place.slot) for place in places if place.known]
    free = [(place.position, place.slot) for place in places if not place.known]
    same = places[0].slot == places[1].slot  # P(X, X)

    def step(search: Search) -> None:
        tables, values, keys, bounds = search.tables, search.values, search.keys, search.bounds
        rows: Iterable[Row] = tables.rows(predicate).items()
        for position, slot in fixed:
            rows = tables.rows_with(predicate, position, values[slot])
        for key, bound in rows:
            if not holds(bound) or (same and key[0] != key[1]):
                continue
            for position, slot in free:
                values[slot] = key[position]
            keys[i] = key
            bounds[i] = bound
            then(search)

    return step


def _refute(i: int, atom: Atom, criterion: Criterion, slots: Mapping[str, int], then: Step) -> Step:
    """Match a negated literal: its atom is unknown, or false enough."""
    predicate, holds, key_of = atom.predicate, criterion.negated, _key_maker(atom, slots)

    def step(search: Search) -> None:
        key = key_of(search.values)
        bound = search.tables.rows(predicate).get(key)
        if bound is None or holds(bound):
            search.keys[i] = key
            search.bounds[i] = TRUE if bound is None else negation(bound)
            then(search)

    return step


def _differ(left: int, right: int, then: Step) -> Step:
    """Check a guard."""

    def step(search: Search) -> None:
        if search.values[left] != search.values[right]:
            then(search)

    return step
