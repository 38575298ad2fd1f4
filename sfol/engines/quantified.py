"""Counts and foralls in bodies → rules of their own, of which an engine needs to know nothing.

``count(P: A(P), R(P, X)) >= 2`` in a body becomes an atom of X. One rule concludes, for every X and
every P, what the best substitution of the literals inside comes to; another one, for every X, the
second greatest of these.

``forall(P: A(P))(R(P, X))`` becomes ``not c(_, X)``, where c(P, X) says how far P is a
counterexample: as far as A(P) is so and R(P, X) is not, by the minimum. So all engines take the
greatest counterexample and negate it, as they do for ``_`` elsewhere. Further rules conclude what
the guard and what the body come to. What they must be told besides, over which values variables
range, they read off the rest of the rule.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from sfol.clauses import Body, Clause
from sfol.facts import TRUE
from sfol.knowledge_base import Rule
from sfol.literals import Count, Counted, ForAll, Literal, NoCounterexample, Positive, Ranging
from sfol.literals.negated import Negated
from sfol.literals.quantified import bound_inside
from sfol.operators import BEST, CONJUNCTIONS, Gathering, Operator, nth_greatest
from sfol.syntax import ANONYMOUS, Atom

_MINIMUM = CONJUNCTIONS["minimum"]


class AuxiliaryRule(NamedTuple):
    """A rule that stands for part of a literal.

    Attributes:
        rule: itself.
        gathers: what makes one of its substitutions for one head.
        conjunction: combines its literals; None for that of the knowledge base.
    """

    rule: Rule
    gathers: Gathering = BEST
    conjunction: Operator | None = None


def without_quantified(rule: Rule) -> Rule:
    """Return a rule that reads atoms in place of its counts and foralls."""
    head, body = rule.clause.head, rule.clause.body
    if not body.quantified:
        return rule
    literals = tuple(_atom_for(rule, literal) for literal in body.literals)
    return replace(rule, clause=Clause(head, Body(literals)))


def auxiliary_rules(rule: Rule) -> Iterator[AuxiliaryRule]:
    """Yield the rules that conclude these atoms."""
    for literal in rule.clause.body.quantified:
        match literal:
            case Count():
                yield from _counting(rule, literal)
            case ForAll():
                yield from _searching_counterexamples(rule, literal)


def _atom_for(rule: Rule, literal: Literal) -> Literal:
    match literal:
        case Count():
            return _counted(rule, literal)
        case ForAll():
            return _no_counterexample(rule, literal)
    return literal


def _counted(rule: Rule, count: Count) -> Counted:
    """Return what stands for a count; its predicates can't be called like those of a file."""
    name = f"{rule.name}: {count}"
    each = Atom(f"{name}, each", (*count.quantified, *count.shared))
    return Counted(Atom(name, count.shared), count=count, each=each)


def _counting(rule: Rule, count: Count) -> Iterator[AuxiliaryRule]:
    counted = _counted(rule, count)
    inside, ones = Body(count.literals), Body((Positive(counted.each),))
    number = count.minimum
    yield AuxiliaryRule(_rule(rule, counted.each, inside))
    # What counts has met the rule's thresholds by then.
    some = replace(_rule(rule, counted.atom, ones), threshold=0.0)
    yield AuxiliaryRule(some, BEST if number == 1 else nth_greatest(number))


def _no_counterexample(rule: Rule, forall: ForAll) -> NoCounterexample:
    anyone = (ANONYMOUS,) * len(forall.quantified)
    name = f"{rule.name}: {forall}"
    atom = Atom(f"{name}, counterexample", (*anyone, *forall.shared))
    return NoCounterexample(atom, forall=forall, holding=f"{name}, body")


def _searching_counterexamples(rule: Rule, forall: ForAll) -> Iterator[AuxiliaryRule]:
    literal = _no_counterexample(rule, forall)
    arguments = (*forall.quantified, *forall.shared)
    guard = Atom(f"{rule.name}: {forall}, guard", arguments)
    body = Atom(literal.holding, arguments)
    counterexample = Atom(literal.atom.predicate, arguments)
    speaks = Body((*_ranges(rule, forall), *forall.guard))
    holds = Body((Ranging(guard), *forall.body))
    lacks = Body((Positive(guard), Negated(body)))
    yield AuxiliaryRule(_rule(rule, guard, speaks), conjunction=_MINIMUM)
    yield AuxiliaryRule(_rule(rule, body, holds), conjunction=_MINIMUM)
    # However little somebody is a counterexample, it is the literal that has a threshold.
    every = replace(_rule(rule, counterexample, lacks), threshold=0.0, negation_threshold=0.0)
    yield AuxiliaryRule(every, conjunction=_MINIMUM)


def _ranges(rule: Rule, forall: ForAll) -> Iterator[Ranging]:
    """Yield the literals beside a forall that bind what its guard does not."""
    needed = set(forall.shared) - bound_inside(forall.guard)
    for literal in rule.clause.body.atom_literals:
        if literal.binds and not needed.isdisjoint(literal.terms):
            yield Ranging(literal.atom)


def _rule(rule: Rule, head: Atom, body: Body) -> Rule:
    return replace(
        rule,
        name=head.predicate,
        clause=Clause(head, body),
        certainty=TRUE,
        groundings=None,
        part_of=None,
    )
