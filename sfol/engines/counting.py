"""Counts in bodies → rules of their own, of which an engine needs to know nothing.

``count(P: A(P), R(P, X)) >= 2`` in a body becomes an atom of X. One rule concludes, for every X and
every P, what the best substitution of the literals inside comes to; another one, for every X, the
second greatest of these.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from sfol.clauses import Body, Clause
from sfol.facts import TRUE
from sfol.knowledge_base import Rule
from sfol.literals import Count, Counted, Literal, Positive
from sfol.operators import BEST, Gathering, nth_greatest
from sfol.syntax import Atom


class CountingRule(NamedTuple):
    """A rule that takes part in a count, and what makes one of its substitutions for one head."""

    rule: Rule
    gathers: Gathering


def without_counts(rule: Rule) -> Rule:
    """Return a rule that reads the atoms of its counts instead of them."""
    head, body = rule.clause.head, rule.clause.body
    if not body.counts:
        return rule
    literals = tuple(_without_count(rule, literal) for literal in body.literals)
    return replace(rule, clause=Clause(head, Body(literals)))


def counting_rules(rule: Rule) -> Iterator[CountingRule]:
    """Yield the rules that conclude the counts of a rule."""
    for count in rule.clause.body.counts:
        counted = _counted(rule, count)
        inside, ones = Body(count.literals), Body((Positive(counted.each),))
        number = count.minimum
        yield CountingRule(_rule(rule, counted.each, inside), BEST)
        # What counts has met the rule's thresholds by then.
        some = replace(_rule(rule, counted.atom, ones), threshold=0.0)
        yield CountingRule(some, BEST if number == 1 else nth_greatest(number))


def _without_count(rule: Rule, literal: Literal) -> Literal:
    return _counted(rule, literal) if isinstance(literal, Count) else literal


def _counted(rule: Rule, count: Count) -> Counted:
    """Return what stands for a count; its predicates can't be called like those of a file."""
    name = f"{rule.name}: {count}"
    atom = Atom(name, count.shared)
    return Counted(atom, count=count, each=Atom(f"{name}, each", (*count.counted, *count.shared)))


def _rule(rule: Rule, head: Atom, body: Body) -> Rule:
    return replace(
        rule,
        name=head.predicate,
        clause=Clause(head, body),
        certainty=TRUE,
        groundings=None,
        part_of=None,
    )
