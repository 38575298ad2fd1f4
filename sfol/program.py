"""KnowledgeBase → Program: what an engine runs.

Rules are sorted into the order in which their heads can be concluded, and each body becomes a
plan: nested functions that match its literals one after the other, each with as many arguments
known as can be; negated literals and guards come as soon as their variables are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from graphlib import TopologicalSorter
from typing import NamedTuple

from sfol.checking import dependencies
from sfol.errors import FactError, did_you_mean
from sfol.facts import TRUE, Bound, Facts, Relation
from sfol.knowledge_base import EntityCondition, KnowledgeBase, Rule
from sfol.operators import negation
from sfol.syntax import Atom, Body, Literal, is_variable, variables

Constants = tuple[str, ...]
Row = tuple[Constants, Bound]
Substitution = Mapping[str, str]

_EMPTY: Relation = {}


class Tables:
    """The known atoms of one scene by predicate, with indices by argument made when needed."""

    __slots__ = ("_indices", "_relations")

    def __init__(self, relations: dict[str, dict[Constants, Bound]]) -> None:
        self._relations = relations
        self._indices: dict[tuple[str, int], dict[str, list[Row]]] = {}

    @classmethod
    def of(cls, facts: Facts, background: Sequence[Atom] = ()) -> Tables:
        """Return the tables of some facts and of the background, which always holds.

        The facts are copied, so that conclusions do not change when the facts do.

        Raises:
            FactError: a fact gives an atom of the background another bound.
        """
        tables = cls({name: dict(facts.relation(name)) for name in facts.predicates()})
        for atom in background:
            bound = tables._relations.setdefault(atom.predicate, {}).setdefault(
                atom.arguments, TRUE
            )
            if bound != TRUE:
                raise FactError(
                    f"facts give {atom} the bound {bound}, but it always holds",
                    name=str(atom),
                    suggestion="leave it out: it stands in the knowledge base's background",
                )
        return tables

    def bound(self, atom: Atom) -> Bound | None:
        """Return the bound of a ground atom, or None if it is unknown."""
        return self._relations.get(atom.predicate, _EMPTY).get(atom.arguments)

    def has_all(self, predicates: frozenset[str]) -> bool:
        """Tell whether something is known of every one of these predicates."""
        return predicates <= self._relations.keys()

    def rows(self, predicate: str) -> Relation:
        """Return all known atoms of a predicate: arguments → bound."""
        return self._relations.get(predicate, _EMPTY)

    def rows_with(self, predicate: str, position: int, constant: str) -> Iterable[Row]:
        """Return the known atoms that have a constant at a position."""
        index = self._indices.get((predicate, position))
        if index is None:
            index = self._indices[predicate, position] = {}
            for row in self.rows(predicate).items():
                index.setdefault(row[0][position], []).append(row)
        return index.get(constant, ())

    def items(self) -> Iterator[tuple[Atom, Bound]]:
        """Yield every known atom with its bound."""
        for predicate, relation in self._relations.items():
            for arguments, bound in relation.items():
                yield Atom(predicate, arguments), bound

    def put(self, atom: Atom, bound: Bound) -> None:
        """Add a conclusion. No index of its predicate exists yet: strata go in order."""
        self._relations.setdefault(atom.predicate, {})[atom.arguments] = bound


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


_Step = Callable[[Search], None]


@dataclass(frozen=True)
class Plan:
    """How to find the substitutions that satisfy a body.

    The body is compiled once into nested functions, one for each literal and guard, of which each
    calls the next for every way in which it can hold.

    Attributes:
        body: the body itself.
        variables: its variables; those that are given beforehand come first.
        given: how many are.
    """

    body: Body
    variables: tuple[str, ...]
    given: int
    _constants: tuple[str, ...]
    _needed: frozenset[str]
    _first: _Step

    @classmethod
    def of(cls, body: Body, criterion: Criterion, given: Sequence[str] = ()) -> Plan:
        """Make the plan of a body.

        Args:
            body: literals and guards; every variable stands in a positive literal or in `given`.
            criterion: when its literals hold.
            given: variables that have a value beforehand.
        """
        terms = [term for literal in body.literals for term in literal.atom.arguments]
        terms += [term for guard in body.guards for term in guard]
        names = tuple(dict.fromkeys([*given, *variables(*terms)]))
        constants = tuple(dict.fromkeys(term for term in terms if not is_variable(term)))
        slots = {term: slot for slot, term in enumerate((*names, *constants))}
        step: _Step = _visit
        for make in reversed(list(_steps(body, criterion, slots, {*given, *constants}))):
            step = make(step)
        needed = frozenset(lit.atom.predicate for lit in body.literals if not lit.negated)
        return cls(body, names, len(given), constants, needed, step)

    def search(
        self, tables: Tables, visit: Callable[[Search], None], given: Sequence[str] = ()
    ) -> None:
        """Visit every substitution that satisfies the body.

        Args:
            tables: the scene.
            visit: is called with the search, whose values, keys and bounds are those of the
                substitution and change after the call.
            given: values of the variables that are given.
        """
        if not tables.has_all(self._needed):
            return
        free = len(self.variables) - self.given
        values = [*given, *("",) * free, *self._constants]
        self._first(Search(tables, values, len(self.body.literals), visit))

    def reader(self, atom: Atom) -> Callable[[Search], Constants]:
        """Return the function that reads an atom's ground arguments off a search.

        Args:
            atom: its variables are the plan's; any other term is a constant.
        """
        slots = {term: slot for slot, term in enumerate(self.variables)}
        places = [(slots.get(term), term) for term in atom.arguments]
        return lambda search: tuple(
            [term if slot is None else search.values[slot] for slot, term in places]
        )

    def substitutions(self, tables: Tables, given: Sequence[str] = ()) -> list[dict[str, str]]:
        """Return every substitution of variables by constants that satisfies the body."""
        found: list[dict[str, str]] = []
        names = self.variables
        self.search(tables, lambda s: found.append(dict(zip(names, s.values, strict=False))), given)
        return found

    def literal_bound(self, literal: Literal, tables: Tables, values: Substitution) -> Bound:
        """Return the bound of a literal under a substitution that satisfies the body."""
        bound = tables.bound(ground(literal.atom, values))
        if literal.negated:
            return TRUE if bound is None else negation(bound)
        assert bound is not None
        return bound


def ground(atom: Atom, values: Substitution) -> Atom:
    """Replace the variables of an atom by their values."""
    return Atom(atom.predicate, tuple(values.get(term, term) for term in atom.arguments))


# -- compiling a body -----------------------------------------------------------------------------

_Make = Callable[[_Step], _Step]
_Indexed = tuple[int, Atom]  # a literal's atom, after its index in the body


def _steps(
    body: Body, criterion: Criterion, slots: Mapping[str, int], given: set[str]
) -> Iterator[_Make]:
    """Yield the makers of the steps in the order in which they are tried.

    What is wholly known is looked up at once. Then variables are bound one by one: beside a
    variable that takes many values by an index, since that happens once for each of them;
    otherwise by the shortest of the unary relations that hold it.
    """
    known = set(given)
    waiting = [(i, literal.atom) for i, literal in enumerate(body.literals) if not literal.negated]
    checks = list(_checks(body, criterion, slots))
    while waiting or checks:
        ready = [check for check in checks if check[0] <= known]
        checks = [check for check in checks if check not in ready]
        yield from (make for _, make in ready)
        if waiting:
            chosen = _next(waiting, known, known - given)
            waiting = [literal for literal in waiting if literal not in chosen]
            yield _matcher(chosen, criterion, slots, known)
            known.update(term for _, atom in chosen for term in atom.arguments)


def _checks(
    body: Body, criterion: Criterion, slots: Mapping[str, int]
) -> Iterator[tuple[set[str], _Make]]:
    for i, (atom, negated) in enumerate(body.literals):
        if negated:
            yield set(atom.arguments), partial(_refute, i, atom, criterion, slots)
    for left, right in body.guards:
        yield {left, right}, partial(_differ, slots[left], slots[right])


def _next(waiting: Sequence[_Indexed], known: set[str], varying: set[str]) -> Sequence[_Indexed]:
    """Return the literals to match next: one, or all unary ones that share a variable."""

    def half(terms: set[str]) -> list[_Indexed]:
        return [lit for lit in waiting if len(terms.intersection(lit[1].arguments)) == 1]

    looked_up = [lit for lit in waiting if known.issuperset(lit[1].arguments)]
    if looked_up or half(varying):
        return (looked_up or half(varying))[:1]
    unary = [lit for lit in waiting if len(lit[1].arguments) == 1]
    if unary:
        beside_known = {term for _, atom in half(known) for term in atom.arguments}
        first = next((lit for lit in unary if beside_known.issuperset(lit[1].arguments)), unary[0])
        return [lit for lit in unary if lit[1].arguments == first[1].arguments]
    return (half(known) or waiting)[:1]


def _matcher(
    chosen: Sequence[_Indexed], criterion: Criterion, slots: Mapping[str, int], known: set[str]
) -> _Make:
    i, atom = chosen[0]
    if known.issuperset(atom.arguments):
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


def _visit(search: Search) -> None:
    search.visit(search)


def _key_maker(atom: Atom, slots: Mapping[str, int]) -> Callable[[list[str]], Constants]:
    """Return the function that reads an atom's ground arguments off the slots."""
    if len(atom.arguments) == 1:
        only = slots[atom.arguments[0]]
        return lambda values: (values[only],)
    left, right = (slots[term] for term in atom.arguments)
    return lambda values: (values[left], values[right])


def _look_up(
    i: int, atom: Atom, criterion: Criterion, slots: Mapping[str, int], then: _Step
) -> _Step:
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


def _meet(
    literals: Sequence[tuple[int, str]], criterion: Criterion, slot: int, then: _Step
) -> _Step:
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
    i: int, predicate: str, criterion: Criterion, places: Sequence[_Place], then: _Step
) -> _Step:
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


def _refute(
    i: int, atom: Atom, criterion: Criterion, slots: Mapping[str, int], then: _Step
) -> _Step:
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


def _differ(left: int, right: int, then: _Step) -> _Step:
    """Check a guard."""

    def step(search: Search) -> None:
        if search.values[left] != search.values[right]:
            then(search)

    return step


@dataclass(frozen=True)
class Program:
    """A knowledge base made ready to run.

    Attributes:
        knowledge_base: what it was made from.
        strata: heads in an order in which each depends on earlier ones only.
        rules: head → its rules with their plans, in the order of the file.
        subject_heads: the unary heads, whose atoms of the subject make the reward.
        read_heads: heads that some body or condition reads, for whichever entity.
        arities: predicate → its number of arguments.
    """

    knowledge_base: KnowledgeBase
    strata: tuple[str, ...]
    rules: Mapping[str, tuple[tuple[Rule, Plan], ...]]
    subject_heads: tuple[str, ...]
    read_heads: frozenset[str]
    arities: Mapping[str, int]

    @classmethod
    def of(cls, kb: KnowledgeBase) -> Program:
        """Make the program of a knowledge base."""
        rules = list(kb.rules.values())
        heads = kb.heads
        order = TopologicalSorter(dependencies(rules)).static_order()
        bodies = [rule.clause.body for rule in rules] + [c.when for c in kb.entity_weights]
        read = {literal.atom.predicate for body in bodies for literal in body.literals}
        return cls(
            knowledge_base=kb,
            strata=tuple(name for name in order if name in heads),
            rules={
                head: tuple(
                    (rule, Plan.of(rule.clause.body, rule_criterion(rule)))
                    for rule in rules
                    if rule.clause.head.predicate == head
                )
                for head in heads
            },
            subject_heads=tuple(head for head in heads if kb.predicates[head].arity == 1),
            read_heads=frozenset(read.intersection(heads)),
            arities={name: predicate.arity for name, predicate in kb.predicates.items()},
        )

    def check(self, facts: Facts) -> None:
        """Make sure that facts fit the knowledge base.

        Raises:
            FactError: a predicate or a number of constants is not that of the knowledge base.
        """
        for predicate in facts.predicates():
            given = len(next(iter(facts.relation(predicate))))
            if self.arities.get(predicate) != given:
                raise _unfit(predicate, given, self.arities)

    def plans(
        self, head: str, subject: str, criterion: Criterion | None = None
    ) -> Iterator[tuple[Rule, Plan, tuple[str, ...]]]:
        """Yield how to conclude a head: for the subject alone where nothing else is needed.

        Args:
            head: the predicate.
            subject: the entity whose heads make the reward.
            criterion: when literals hold; each rule's own by default.

        Yields:
            A rule, its plan, and the values that the plan is given.
        """
        for rule, _ in self.rules[head]:
            holds = criterion or rule_criterion(rule)
            body, term = rule.clause.body, rule.clause.head.arguments[0]
            if not self.for_subject_alone(head):
                yield rule, Plan.of(body, holds), ()
            elif is_variable(term):
                yield rule, Plan.of(body, holds, given=[term]), (subject,)
            elif term == subject:
                yield rule, Plan.of(body, holds), ()

    def for_subject_alone(self, head: str) -> bool:
        """Tell whether the reward needs a head of the subject only: no body reads it."""
        return head in self.subject_heads and head not in self.read_heads


def _unfit(predicate: str, given: int, arities: Mapping[str, int]) -> FactError:
    if predicate not in arities:
        return FactError(
            f"facts name the unknown predicate '{predicate}'",
            name=predicate,
            suggestion=did_you_mean(predicate, arities),
        )
    return FactError(
        f"facts give '{predicate}' {given} constants; it has {arities[predicate]}", name=predicate
    )
