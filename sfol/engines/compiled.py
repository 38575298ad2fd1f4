"""The default engine: one program per knowledge base, evaluated bottom-up by indexed joins."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cached_property, partial

from sfol.clauses import Body
from sfol.engines.conclusions import Conclusions
from sfol.engines.plan import Plan
from sfol.engines.program import Program
from sfol.engines.rounds import Conjunction, Recursion, Round
from sfol.engines.tables import Tables
from sfol.facts import Bound, Facts
from sfol.knowledge_base import KnowledgeBase, Rule
from sfol.knowledge_base.recursion import Component
from sfol.literals import Search
from sfol.literals.search import WORK_LIMIT, Constants
from sfol.operators import (
    BEST,
    DISJUNCTIONS,
    Gathering,
    Operator,
    greater,
    times,
    with_certainty,
)
from sfol.syntax import Atom, variables


class CompiledEngine:
    """Evaluates the strata of a program in order, each to its end.

    A head that no body reads is concluded for the subject alone, since nothing else enters the
    reward; for other entities it is concluded when `Conclusions.derived` is first looked at.

    Args:
        kb: the knowledge base; it is compiled once, here.
        work_limit: how many known atoms the search of a body may look at.
    """

    def __init__(self, kb: KnowledgeBase, work_limit: int = WORK_LIMIT) -> None:
        self.program = Program.of(kb, work_limit)
        self._disjunction = DISJUNCTIONS[kb.semantics.disjunction]
        rules = [rule for rules in self.program.rules.values() for rule, _ in rules]
        plain, gathers = self.program.conjunctions, self.program.gathers
        self._conjunctions = {
            rule.name: with_certainty(plain[rule.name], rule.certainty) for rule in rules
        }
        self._gatherers: dict[str, _Gatherer] = {
            rule.name: _gatherer(gathers[rule.name], plain[rule.name], rule.certainty)
            for rule in rules
        }
        # To try all values of more than two variables takes longer than a search, which has a
        # limit.
        self._tried = frozenset(
            rule.name
            for rule in rules
            if gathers[rule.name] is None and len(variables(*rule.clause.head.arguments)) <= 2
        )
        self._recursions = {
            stratum: Recursion(self.program, stratum, self.rule_bounds, self._conjunctions)
            for stratum in self.program.strata
            if stratum.recursive
        }
        self._strata = tuple(map(self._stratum_of, self.program.strata))

    def conclude(self, facts: Facts) -> Conclusions:
        """Return everything that follows from facts.

        Args:
            facts: ground atoms with bounds; they are not changed.

        Raises:
            FactError: a fact has a predicate or a number of constants that the knowledge base
                does not know.
            WorkLimitError: a rule has too many substitutions.
        """
        tables = self.program.tables(facts)
        asserted = self.program.asserted(tables) if self._recursions else ()
        derived: dict[Atom, Bound] = {}
        for conclude in self._strata:
            for atom, bound in conclude(tables):
                derived[atom] = bound
                tables.put(atom, bound)
        if further := self.program.auxiliary:
            derived = {atom: b for atom, b in derived.items() if atom.predicate not in further}
        everything = _Derived(derived, lambda: self._others(tables))
        return Conclusions(tables, everything, self.program, None, asserted)

    def rule_bounds(self, rule: Rule, plan: Plan, tables: Tables) -> dict[Constants, Bound]:
        """Return what one rule alone concludes: arguments of its head → bound."""
        if plan.branches and rule.name in self._tried:
            return dict(self._pooled_bounds(rule, tables))
        gathered: dict[Constants, _Pool | _Best | _Gathered] = {}
        head_of = plan.reader(rule.clause.head)
        gatherer = self._gatherers[rule.name]

        def visit(search: Search) -> None:
            head = head_of(search)
            if head not in gathered:
                gathered[head] = gatherer()
            gathered[head].add(search)

        plan.search(tables, visit)
        return {head: found.bound() for head, found in gathered.items() if found}

    def rounds(self, stratum: Component, tables: Tables) -> Iterator[Round]:
        """Yield the rounds by which heads that depend on each other are concluded.

        Args:
            stratum: the heads.
            tables: what is known without them; it is not changed.
        """
        return self._recursions[stratum].rounds(tables)

    def _pooled_bounds(self, rule: Rule, tables: Tables) -> Iterator[tuple[Constants, Bound]]:
        """Yield what `rule_bounds` returns, without a walk through all substitutions."""
        plan, head = self.program.head_plan(rule), rule.clause.head
        names, conjunction = variables(*head.arguments), self._conjunctions[rule.name]
        for values in _candidates(rule.clause.body, names, tables):
            support = plan.support(tables, values)
            if support:
                arguments = head.substituted(dict(zip(names, values, strict=True))).arguments
                yield arguments, conjunction(support.values())

    def _stratum_of(self, stratum: Component) -> Callable[[Tables], list[tuple[Atom, Bound]]]:
        if stratum.recursive:
            return lambda tables: self._recursive(stratum, tables)
        (head,) = stratum.predicates
        if not self.program.for_subject_alone(head):
            return lambda tables: list(self._all(head, tables))
        atom = self.program.subject_heads[head]
        plans = [
            (plan, given, self._gatherers[rule.name])
            for rule, plan, given in self.program.plans(head)
        ]
        return lambda tables: self._subjects(atom, plans, tables)

    def _recursive(self, stratum: Component, tables: Tables) -> list[tuple[Atom, Bound]]:
        derived: dict[Atom, Bound] = {}
        for one in self.rounds(stratum, tables):
            derived.update(one.concluded)
        tables.revise(derived)
        return list(derived.items())

    def _subjects(
        self,
        atom: Atom,
        plans: Sequence[tuple[Plan, Sequence[str], _Gatherer]],
        tables: Tables,
    ) -> list[tuple[Atom, Bound]]:
        disjuncts = []
        for plan, given, gatherer in plans:
            gathered = gatherer()
            gathered.search(plan, tables, given)
            if gathered:
                disjuncts.append(gathered.bound())
        return [(atom, self._either(atom, disjuncts, tables))] if disjuncts else []

    def _all(self, head: str, tables: Tables) -> Iterator[tuple[Atom, Bound]]:
        disjuncts: dict[Constants, list[Bound]] = {}
        for rule, plan in self.program.rules[head]:
            for arguments, bound in self.rule_bounds(rule, plan, tables).items():
                disjuncts.setdefault(arguments, []).append(bound)
        for arguments, bounds in disjuncts.items():
            atom = Atom(head, arguments)
            yield atom, self._either(atom, bounds, tables)

    def _others(self, tables: Tables) -> Iterator[tuple[Atom, Bound]]:
        """Yield the conclusions that concern neither the subject nor any body."""
        for head in self.program.heads:
            if self.program.for_subject_alone(head):
                for atom, bound in self._all(head, tables):
                    if atom != self.program.subject_heads[head]:
                        yield atom, bound

    def _either(self, atom: Atom, disjuncts: list[Bound], tables: Tables) -> Bound:
        """Combine several rules' bounds; an asserted bound is one more disjunct."""
        asserted = tables.bound(atom)
        if asserted is not None:
            disjuncts = [asserted, *disjuncts]
        return disjuncts[0] if len(disjuncts) == 1 else self._disjunction(disjuncts)


def _candidates(body: Body, names: Sequence[str], tables: Tables) -> Iterator[tuple[str, ...]]:
    """Yield the values that variables may have in a body, and perhaps more."""
    binding = [literal.atom for literal in body.atom_literals if literal.binds]
    together = [atom for atom in binding if len(names) > 1 and {*names} <= {*atom.arguments}]
    if together:
        atom = together[0]
        places = [atom.arguments.index(name) for name in names]
        yield from {tuple(key[at] for at in places): None for key in tables.rows(atom.predicate)}
        return
    columns = []
    for name in names:
        atoms = [atom for atom in binding if name in atom.arguments]
        atom = min(atoms, key=lambda atom: len(tables.rows(atom.predicate)))
        at = atom.arguments.index(name)
        columns.append(dict.fromkeys(key[at] for key in tables.rows(atom.predicate)))
    yield from itertools.product(*columns)


class _Pool:
    """Each literal's distinct ground atoms over all substitutions, combined all together."""

    __slots__ = ("_atoms", "_bounds", "_conjunction")

    def __init__(self, conjunction: Conjunction) -> None:
        self._conjunction = conjunction
        self._atoms: dict[tuple[int, Constants], Bound] = {}
        self._bounds: Collection[Bound] = self._atoms.values()

    def search(self, plan: Plan, tables: Tables, given: Sequence[str]) -> None:
        if plan.is_flat:
            self._bounds = plan.bounds(tables, given)
        elif plan.branches:
            self._bounds = plan.support(tables, given).values()
        else:  # then it is as good, and faster
            plan.search(tables, self.add, given)

    def add(self, search: Search) -> None:
        self._atoms.update(zip(enumerate(search.keys), search.bounds, strict=True))

    def __bool__(self) -> bool:
        return bool(self._bounds)

    def bound(self) -> Bound:
        return self._conjunction(self._bounds)


class _Best:
    """Each substitution's literals combined, then the greatest of lowers and of uppers."""

    __slots__ = ("_best", "_conjunction")

    def __init__(self, conjunction: Conjunction) -> None:
        self._conjunction = conjunction
        self._best: Bound | None = None

    def search(self, plan: Plan, tables: Tables, given: Sequence[str]) -> None:
        plan.search(tables, self.add, given)

    def add(self, search: Search) -> None:
        bound = self._conjunction(search.bounds)
        self._best = bound if self._best is None else greater(self._best, bound)

    def __bool__(self) -> bool:
        return self._best is not None

    def bound(self) -> Bound:
        assert self._best is not None, "asked only where something was found"
        return self._best


class _Gathered:
    """Each substitution's literals combined, then what a gathering makes of all of these."""

    __slots__ = ("_bounds", "_certainty", "_conjunction", "_gathering")

    def __init__(self, conjunction: Operator, gathering: Gathering, certainty: Bound) -> None:
        self._conjunction = conjunction
        self._gathering = gathering
        self._certainty = certainty
        self._bounds: list[Bound] = []

    def search(self, plan: Plan, tables: Tables, given: Sequence[str]) -> None:
        plan.search(tables, self.add, given)

    def add(self, search: Search) -> None:
        self._bounds.append(self._conjunction(search.bounds))

    def __bool__(self) -> bool:
        return len(self._bounds) >= self._gathering.needed

    def bound(self) -> Bound:
        return times(self._gathering(self._bounds), self._certainty)


_Gatherer = Callable[[], _Pool | _Best | _Gathered]


def _gatherer(gathering: Gathering | None, plain: Operator, certainty: Bound) -> _Gatherer:
    """Return what makes the gatherer of a rule's substitutions.

    Args:
        gathering: what makes one of all of them; None where their atoms are pooled.
        plain: the conjunction.
        certainty: the rule's own.
    """
    conjunction = with_certainty(plain, certainty)
    if gathering is None:
        return partial(_Pool, conjunction)
    if gathering is BEST:
        return partial(_Best, conjunction)
    return partial(_Gathered, plain, gathering, certainty)


class _Derived(Mapping[Atom, Bound]):
    """All conclusions; those that the reward does not need are drawn when first looked at."""

    def __init__(
        self, needed: Mapping[Atom, Bound], others: Callable[[], Iterator[tuple[Atom, Bound]]]
    ) -> None:
        self._needed = needed
        self._others = others

    @cached_property
    def _all(self) -> dict[Atom, Bound]:
        return {**self._needed, **dict(self._others())}

    def __getitem__(self, atom: Atom) -> Bound:
        return self._all[atom]

    def __iter__(self) -> Iterator[Atom]:
        return iter(self._all)

    def __len__(self) -> int:
        return len(self._all)

    def __repr__(self) -> str:
        return repr(self._all)

    def __reduce__(self) -> tuple[object, ...]:
        return dict, (self._all,)
