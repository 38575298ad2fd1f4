"""KnowledgeBase → Program: what an engine runs.

Rules are sorted into the order in which their heads can be concluded, and each body becomes a
plan: in which order its literals are matched, so that each step has as many variables bound as
can be, and negated literals and guards come as soon as their variables are known.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from graphlib import TopologicalSorter
from typing import NamedTuple

from sfol.checking import dependencies
from sfol.facts import TRUE, Bound, Facts, Relation
from sfol.knowledge_base import EntityCondition, KnowledgeBase, Rule
from sfol.operators import negation
from sfol.syntax import Atom, Body, Literal, is_variable, variables

Constants = tuple[str, ...]
Substitution = Mapping[str, str]


class Tables:
    """The known atoms of one scene by predicate, with indices by argument made when needed."""

    def __init__(self, relations: Mapping[str, Relation]) -> None:
        self._relations: dict[str, dict[Constants, Bound]] = {
            name: dict(relation) for name, relation in relations.items()
        }
        self._indices: dict[tuple[str, int], dict[str, list[Constants]]] = {}

    @classmethod
    def of(cls, facts: Facts, background: Sequence[Atom]) -> Tables:
        """Return the tables of some facts and of the background, which facts may restate."""
        tables = cls({name: facts.relation(name) for name in facts.predicates()})
        for atom in background:
            tables._relations.setdefault(atom.predicate, {}).setdefault(atom.arguments, TRUE)
        return tables

    def bound(self, atom: Atom) -> Bound | None:
        """Return the bound of a ground atom, or None if it is unknown."""
        return self._relations.get(atom.predicate, {}).get(atom.arguments)

    def rows(self, predicate: str) -> Relation:
        """Return all known atoms of a predicate."""
        return self._relations.get(predicate, {})

    def rows_with(self, predicate: str, position: int, constant: str) -> Sequence[Constants]:
        """Return the arguments of the known atoms that have a constant at a position."""
        key = (predicate, position)
        if key not in self._indices:
            index: dict[str, list[Constants]] = {}
            for constants in self.rows(predicate):
                index.setdefault(constants[position], []).append(constants)
            self._indices[key] = index
        return self._indices[key].get(constant, ())

    def put(self, atom: Atom, bound: Bound) -> None:
        """Add a conclusion. Indices of its predicate are not made yet: strata go in order."""
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
    return Criterion(
        positive=lambda bound: bound.upper > 0.0 and bound.lower >= rule.threshold,
        negated=lambda bound: 1.0 - bound.upper >= rule.negation_threshold,
    )


def condition_criterion(condition: EntityCondition) -> Criterion:
    """Return when the literals of an entity weight's condition count: by their confidence."""
    return Criterion(
        positive=lambda bound: bound.midpoint >= condition.at_least,
        negated=lambda bound: 1.0 - bound.midpoint >= condition.at_least,
    )


@dataclass(frozen=True)
class Plan:
    """How to find the substitutions that satisfy a body.

    Attributes:
        body: the body itself.
        criterion: when its literals hold.
        order: its literals and guards in the order in which they are tried.
    """

    body: Body
    criterion: Criterion
    order: tuple[_Step, ...]

    @classmethod
    def of(cls, body: Body, criterion: Criterion, bound: Sequence[str] = ()) -> Plan:
        """Make the plan of a body.

        Args:
            body: literals and guards; every variable stands in a positive literal or in `bound`.
            criterion: when its literals hold.
            bound: variables that are given a value beforehand.
        """
        return cls(body, criterion, tuple(_ordered(body, set(bound))))

    def substitutions(
        self, tables: Tables, given: Substitution | None = None
    ) -> Iterator[dict[str, str]]:
        """Yield every substitution of variables by constants that satisfies the body."""
        yield from self._extend(0, dict(given or {}), tables)

    def literal_bound(self, literal: Literal, tables: Tables, values: Substitution) -> Bound:
        """Return the bound of a literal under a substitution that satisfies the body."""
        bound = tables.bound(ground(literal.atom, values))
        if literal.negated:
            return TRUE if bound is None else negation(bound)
        assert bound is not None
        return bound

    def _extend(
        self, step: int, values: dict[str, str], tables: Tables
    ) -> Iterator[dict[str, str]]:
        if step == len(self.order):
            yield dict(values)
            return
        for added in self.order[step](self.criterion, values, tables):
            values.update(added)
            yield from self._extend(step + 1, values, tables)
            for variable in added:
                del values[variable]


_Step = Callable[[Criterion, Substitution, Tables], Iterator[dict[str, str]]]


def ground(atom: Atom, values: Substitution) -> Atom:
    """Replace the variables of an atom by their values."""
    return Atom(atom.predicate, tuple(values.get(term, term) for term in atom.arguments))


def _ordered(body: Body, bound: set[str]) -> Iterator[_Step]:
    checks: list[tuple[set[str], _Step]] = [
        (set(variables(*lit.atom.arguments)), partial(_check_negated, lit.atom))
        for lit in body.literals
        if lit.negated
    ]
    checks += [(set(variables(*g)), partial(_check_guard, g.left, g.right)) for g in body.guards]
    waiting = [literal.atom for literal in body.literals if not literal.negated]
    while waiting or checks:
        ready = [check for check in checks if check[0] <= bound]
        checks = [check for check in checks if check not in ready]
        yield from (step for _, step in ready)
        if waiting:
            # Stable: among equals the order of the text decides.
            atom = max(waiting, key=lambda a: _selectivity(a, bound))
            waiting.remove(atom)
            yield partial(_match, atom)
            bound |= set(variables(*atom.arguments))


def _selectivity(atom: Atom, bound: set[str]) -> float:
    """Share of an atom's arguments that have a value when it is matched."""
    fixed = sum(not is_variable(term) or term in bound for term in atom.arguments)
    return fixed / len(atom.arguments)


def _match(
    atom: Atom, criterion: Criterion, values: Substitution, tables: Tables
) -> Iterator[dict[str, str]]:
    rows = tables.rows(atom.predicate)
    for constants in _candidates(ground(atom, values), rows, tables):
        if not criterion.positive(rows[constants]):
            continue
        added = _unify(atom, constants, values)
        if added is not None:
            yield added


def _candidates(atom: Atom, rows: Relation, tables: Tables) -> Sequence[Constants]:
    fixed = [i for i, term in enumerate(atom.arguments) if not is_variable(term)]
    if len(fixed) == len(atom.arguments):
        return (atom.arguments,) if atom.arguments in rows else ()
    if fixed:
        return tables.rows_with(atom.predicate, fixed[0], atom.arguments[fixed[0]])
    return tuple(rows)


def _unify(atom: Atom, constants: Constants, values: Substitution) -> dict[str, str] | None:
    added: dict[str, str] = {}
    for term, constant in zip(atom.arguments, constants, strict=True):
        if not is_variable(term):
            expected = term
        else:
            expected = values.get(term) or added.setdefault(term, constant)
        if expected != constant:
            return None
    return added


def _check_negated(
    atom: Atom, criterion: Criterion, values: Substitution, tables: Tables
) -> Iterator[dict[str, str]]:
    bound = tables.bound(ground(atom, values))
    if bound is None or criterion.negated(bound):
        yield {}


def _check_guard(
    left: str, right: str, criterion: Criterion, values: Substitution, tables: Tables
) -> Iterator[dict[str, str]]:
    if values.get(left, left) != values.get(right, right):
        yield {}


@dataclass(frozen=True)
class Program:
    """A knowledge base made ready to run.

    Attributes:
        knowledge_base: what it was made from.
        strata: heads in an order in which each depends on earlier ones only.
        rules: head → its rules with their plans, in the order of the file.
        subject_heads: the unary heads, whose atoms of the subject make the reward.
    """

    knowledge_base: KnowledgeBase
    strata: tuple[str, ...]
    rules: Mapping[str, tuple[tuple[Rule, Plan], ...]]
    subject_heads: tuple[str, ...]

    @classmethod
    def of(cls, kb: KnowledgeBase) -> Program:
        """Make the program of a knowledge base."""
        rules = list(kb.rules.values())
        heads = kb.heads
        order = TopologicalSorter(dependencies(rules)).static_order()
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
        )
