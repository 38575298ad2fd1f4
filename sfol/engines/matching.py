"""Matching the literals of a body one after the other.

Every literal becomes a step: a function that calls the next one for every way in which it can
hold. Literals that bind are joined here, by the known atoms of their predicates; the others make
their own steps. Steps are chosen so that each has as many arguments known as can be.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence, Set
from functools import partial
from typing import NamedTuple

from sfol.clauses import Body
from sfol.knowledge_base import EntityCondition, Rule
from sfol.literals import Criterion, Reading, Search, Step
from sfol.literals.search import Constants, ExhaustedError, Make, Row
from sfol.syntax import Atom


def rule_criterion(rule: Rule) -> Criterion:
    """Return when the literals of a rule hold: by its thresholds."""
    return lambda literal: literal.holds(rule)


def condition_criterion(condition: EntityCondition) -> Criterion:
    """Return when the literals of an entity weight's condition count: by their confidence."""
    return lambda literal: literal.reaches(condition.at_least)


class Binder(NamedTuple):
    """A literal that is matched by looking through the known atoms of its predicate.

    Attributes:
        number: the literal's own among those of the body that stand for atoms.
        atom: its atom.
        reading: its bound from that of a known atom, if it holds.
    """

    number: int
    atom: Atom
    reading: Reading


class Condition(NamedTuple):
    """A literal that binds nothing, to be tested as soon as its terms are known.

    Attributes:
        terms: its variables and constants.
        number: the literal's own, as for a `Binder`; None for a guard.
        make: makes its step.
    """

    terms: frozenset[str]
    number: int | None
    make: Make


def binders(body: Body, criterion: Criterion) -> list[Binder]:
    """Return the literals that bind variables."""
    return [
        Binder(i, literal.atom, criterion(literal))
        for i, literal in enumerate(body.atom_literals)
        if literal.binds
    ]


def conditions(body: Body, criterion: Criterion, slots: Mapping[str, int]) -> list[Condition]:
    """Return the literals that are tested: negated ones, and guards."""
    atoms = len(body.atom_literals)
    return [
        Condition(
            frozenset(literal.terms),
            i if i < atoms else None,
            partial(literal.step, i, slots, criterion),
        )
        for i, literal in enumerate(body.literals)
        if not literal.binds
    ]


def makers(
    body: Body, criterion: Criterion, slots: Mapping[str, int], given: frozenset[str]
) -> Iterator[Make]:
    """Yield the makers of a body's steps in the order in which they are tried.

    Args:
        body: what must hold.
        criterion: when literals hold.
        slots: where in `Search.values` each term stands.
        given: the terms that have a value beforehand, constants included.
    """
    known = set(given)
    waiting, pending = binders(body, criterion), conditions(body, criterion, slots)
    while waiting or pending:
        yield from (condition.make for condition in pending if condition.terms <= known)
        pending = [condition for condition in pending if not condition.terms <= known]
        if waiting:
            chosen = next_binders(waiting, known, known - given)
            waiting = [binder for binder in waiting if binder not in chosen]
            yield matcher(chosen, slots, known)
            known.update(term for binder in chosen for term in binder.atom.arguments)


def next_binders(waiting: Sequence[Binder], known: Set[str], varying: Set[str]) -> Sequence[Binder]:
    """Return the literals to match next: one, or all unary ones that share a variable.

    What is wholly known is looked up at once. Then variables are bound one by one: beside a
    variable that takes many values by an index, since that happens once for each of them;
    otherwise by the shortest of the unary relations that hold it.

    Args:
        waiting: the literals that are left.
        known: the terms that have a value.
        varying: those among them that take many.
    """

    def half(terms: Set[str]) -> list[Binder]:
        return [binder for binder in waiting if terms & set(binder.atom.arguments)]

    looked_up = [binder for binder in waiting if known >= set(binder.atom.arguments)]
    if looked_up or half(varying):
        return (looked_up or half(varying))[:1]
    unary = [binder for binder in waiting if len(binder.atom.arguments) == 1]
    if unary:
        beside_known = {term for binder in half(known) for term in binder.atom.arguments}
        first = next((b for b in unary if beside_known.issuperset(b.atom.arguments)), unary[0])
        return [binder for binder in unary if binder.atom.arguments == first.atom.arguments]
    return (half(known) or waiting)[:1]


def matcher(chosen: Sequence[Binder], slots: Mapping[str, int], known: Set[str]) -> Make:
    """Return the maker of the step that matches what `next_binders` chose."""
    first = chosen[0]
    arguments = first.atom.arguments
    if known >= set(arguments):
        return partial(_look_up, first, slots)
    if len(arguments) == 1:
        return partial(_meet, chosen, slots[arguments[0]])
    places = [_Place(at, slots[term], term in known) for at, term in enumerate(arguments)]
    return partial(_scan, first, places)


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


def _look_up(binder: Binder, slots: Mapping[str, int], then: Step) -> Step:
    """Match a literal all of whose arguments are known."""
    i, atom, reading = binder
    predicate, key_of = atom.predicate, atom.key(slots)

    def step(search: Search) -> None:
        key = key_of(search.values)
        known = search.scene.rows(predicate).get(key)
        if known is not None and (bound := reading(known)) is not None:
            search.keys[i] = key
            search.bounds[i] = bound
            then(search)

    return step


def _meet(binders: Sequence[Binder], slot: int, then: Step) -> Step:
    """Match unary literals of one free variable: walk through the shortest, look up the others."""
    met = [(i, atom.predicate, reading) for i, atom, reading in binders]

    def step(search: Search) -> None:
        values, keys, bounds, rows_of = search.values, search.keys, search.bounds, search.scene.rows
        relations = [(i, rows_of(predicate), reading) for i, predicate, reading in met]
        shortest = min([rows for _, rows, _ in relations], key=len)
        search.left -= len(shortest)
        if search.left < 0:
            raise ExhaustedError
        for key in shortest:
            for i, rows, reading in relations:
                known = rows.get(key)
                if known is None or (bound := reading(known)) is None:
                    break
                keys[i] = key
                bounds[i] = bound
            else:
                values[slot] = key[0]
                then(search)

    return step


def _scan(binder: Binder, places: Sequence[_Place], then: Step) -> Step:
    """Match a literal in every way that its known arguments, if any, leave open."""
    i, atom, reading = binder
    predicate = atom.predicate
    fixed = [(place.position, place.slot) for place in places if place.known][:1]
    free = [(place.position, place.slot) for place in places if not place.known]
    agrees = _agreement(places)

    def step(search: Search) -> None:
        scene, values, keys, bounds = search.scene, search.values, search.keys, search.bounds
        rows: Collection[Row] = scene.rows(predicate).items()
        for position, slot in fixed:
            rows = scene.rows_with(predicate, position, values[slot])
        search.left -= len(rows)
        if search.left < 0:
            raise ExhaustedError
        for key, known in rows:
            bound = reading(known)
            if bound is None or (agrees is not None and not agrees(key, values)):
                continue
            for position, slot in free:
                values[slot] = key[position]
            keys[i] = key
            bounds[i] = bound
            then(search)

    return step


def _agreement(places: Sequence[_Place]) -> Callable[[Constants, Sequence[str]], bool] | None:
    """Return what has to be compared in a row that an index of one known argument has found.

    Returns:
        Whether a row's arguments and the values in the slots agree; None if they always do.
    """
    others = [(place.position, place.slot) for place in places if place.known][1:]
    first: dict[int, int] = {}
    pairs = [(first.setdefault(p.slot, p.position), p.position) for p in places if not p.known]
    twins = [(one, other) for one, other in pairs if one != other]  # P(X, X)
    if not others and not twins:
        return None
    return lambda key, values: (
        all(key[i] == values[slot] for i, slot in others)
        and all(key[one] == key[other] for one, other in twins)
    )
