"""Heads that depend on themselves: round after round of inference, until one changes nothing.

After the first round only those substitutions are looked for in which something has changed.

Source: the semi-naive evaluation of F. Bancilhon and R. Ramakrishnan, "An amateur's introduction to
recursive query processing strategies", SIGMOD 1986.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

from sfol.engines.plan import Plan
from sfol.engines.program import Program, rule_plan
from sfol.engines.tables import Tables
from sfol.facts import Bound
from sfol.knowledge_base import Rule
from sfol.knowledge_base.recursion import Component
from sfol.literals import Search
from sfol.literals.search import Constants
from sfol.operators import greater
from sfol.syntax import Atom, variables

Conjunction = Callable[[Iterable[Bound]], Bound]  # of a rule: its certainty is part of it


class Round(NamedTuple):
    """One round of inference.

    Attributes:
        before: what is known before it.
        concluded: what rules conclude then, at least all that is new, and no less than what facts
            say of the same atoms.
    """

    before: Tables
    concluded: Mapping[Atom, Bound]


class _Link(NamedTuple):
    """A literal through which a head depends on itself.

    Attributes:
        rule: that it stands in.
        atom: its atom.
        plan: of the rule's body, given the variables of the atom.
        head_of: reads the arguments of the head off a search.
    """

    rule: Rule
    atom: Atom
    plan: Plan
    head_of: Callable[[Search], Constants]

    @classmethod
    def of(cls, rule: Rule, atom: Atom, limit: int) -> _Link:
        """Make the link of a literal of a rule, by its atom."""
        plan = rule_plan(rule, limit, variables(*atom.arguments))
        return cls(rule, atom, plan, plan.reader(rule.clause.head))


class Recursion:
    """How to conclude heads that depend on each other.

    Args:
        program: that they are heads of.
        stratum: the heads.
        rule_bounds: what one rule alone concludes.
        conjunctions: rule → what makes one bound of those of its literals.
    """

    def __init__(
        self,
        program: Program,
        stratum: Component,
        rule_bounds: Callable[[Rule, Plan, Tables], Mapping[Constants, Bound]],
        conjunctions: Mapping[str, Conjunction],
    ) -> None:
        self._rules = [pair for head in stratum.predicates for pair in program.rules[head]]
        self._rule_bounds = rule_bounds
        self._conjunctions = conjunctions
        self._limit = program.work_limit
        self._links: dict[str, list[_Link]] = {head: [] for head in stratum.predicates}
        for rule, _ in self._rules:
            for literal in rule.clause.body.atom_literals:
                if literal.atom.predicate in self._links:
                    link = _Link.of(rule, literal.atom, program.work_limit)
                    self._links[literal.atom.predicate].append(link)

    def rounds(self, tables: Tables) -> Iterator[Round]:
        """Yield the rounds by which the heads are concluded; the last one changes nothing.

        Args:
            tables: what is known without the heads; it is not changed.

        Raises:
            WorkLimitError: a rule has too many substitutions, in all rounds together.
        """
        left = {rule.name: self._limit for rule, _ in self._rules}
        concluded = self._first(tables)
        while True:
            yield Round(tables, concluded)
            changed = {atom: b for atom, b in concluded.items() if tables.bound(atom) != b}
            if not changed:
                return
            tables = tables.extended(changed)
            concluded = {}
            for atom in changed:
                for link in self._links[atom.predicate]:
                    self._follow(link, atom, tables, concluded, left)

    def _first(self, tables: Tables) -> dict[Atom, Bound]:
        concluded: dict[Atom, Bound] = {}
        for rule, plan in self._rules:
            for arguments, bound in self._rule_bounds(rule, plan, tables).items():
                atom = Atom(rule.clause.head.predicate, arguments)
                _add(atom, bound, concluded, tables)
        return concluded

    def _follow(
        self,
        link: _Link,
        changed: Atom,
        tables: Tables,
        concluded: dict[Atom, Bound],
        left: dict[str, int],
    ) -> None:
        """Add what a rule concludes from an atom that has changed, in the place of a literal."""
        values = link.atom.matched(changed, {})
        if values is None:
            return
        name, conjunction = link.rule.name, self._conjunctions[link.rule.name]
        head = link.rule.clause.head.predicate

        def visit(search: Search) -> None:
            left[name] -= 1
            _add(Atom(head, link.head_of(search)), conjunction(search.bounds), concluded, tables)

        link.plan.search(tables, visit, list(values.values()))
        if left[name] < 0:
            raise link.plan.too_much(tables)


def _add(atom: Atom, bound: Bound, concluded: dict[Atom, Bound], tables: Tables) -> None:
    known = concluded.get(atom) or tables.bound(atom)
    concluded[atom] = bound if known is None else greater(known, bound)
