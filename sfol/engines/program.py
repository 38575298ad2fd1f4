"""KnowledgeBase → Program: what an engine runs.

Rules are sorted into the order in which their heads can be concluded, each with the plan of its
body.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from sfol.engines.matching import rule_criterion
from sfol.engines.plan import Plan
from sfol.engines.quantified import AuxiliaryRule, auxiliary_rules, without_quantified
from sfol.engines.tables import Tables
from sfol.errors import FactError, did_you_mean
from sfol.facts import Bound, Facts
from sfol.knowledge_base import KnowledgeBase, Rule
from sfol.knowledge_base.recursion import Component, components
from sfol.literals import Criterion
from sfol.literals.search import WORK_LIMIT
from sfol.operators import CONJUNCTIONS, GATHERINGS, Gathering, Operator
from sfol.syntax import Atom, Compared, variables


@dataclass(frozen=True)
class Program:
    """A knowledge base made ready to run.

    Attributes:
        knowledge_base: what it was made from.
        strata: heads in an order in which each depends on earlier ones only; those that depend on
            each other together.
        rules: head → its rules with their plans, in the order of the file; in place of counts and
            foralls they read heads of further rules.
        auxiliary: the heads of these.
        subject_heads: the heads of one argument or none → the atom that makes the reward, that of
            the subject.
        read_heads: heads that some body or condition reads, for whichever entity.
        arities: predicate → its number of arguments.
        comparisons: what bodies ask of values.
        gathers: rule → what makes one of its substitutions for one head; None where their atoms are
            pooled.
        conjunctions: rule → what combines its literals.
        work_limit: how many known atoms the search of a body may look at.
    """

    knowledge_base: KnowledgeBase
    strata: tuple[Component, ...]
    rules: Mapping[str, tuple[tuple[Rule, Plan], ...]]
    auxiliary: frozenset[str]
    subject_heads: Mapping[str, Atom]
    read_heads: frozenset[str]
    arities: Mapping[str, int]
    comparisons: tuple[Compared, ...]
    gathers: Mapping[str, Gathering | None]
    conjunctions: Mapping[str, Operator]
    work_limit: int
    _head_plans: dict[str, Plan] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(cls, kb: KnowledgeBase, work_limit: int = WORK_LIMIT) -> Program:
        """Make the program of a knowledge base."""
        auxiliary = [found for rule in kb.rules.values() for found in auxiliary_rules(rule)]
        rules = [without_quantified(rule) for rule in kb.rules.values()]
        rules += [found.rule for found in auxiliary]
        further = dict.fromkeys(found.rule.clause.head.predicate for found in auxiliary)
        heads = (*kb.heads, *further)
        return cls(
            knowledge_base=kb,
            strata=tuple(c for c in components(rules) if c.predicates[0] in heads),
            rules={
                head: tuple(
                    (rule, rule_plan(rule, work_limit))
                    for rule in rules
                    if rule.clause.head.predicate == head
                )
                for head in heads
            },
            auxiliary=frozenset(further),
            subject_heads={
                head: Atom(head, (kb.subject,)[:arity])
                for head in kb.heads
                if (arity := kb.predicates[head].arity) <= 1
            },
            read_heads=kb.read.intersection(heads).union(further),
            arities={
                **{name: predicate.arity for name, predicate in kb.predicates.items()},
                **{name: name.arity for name in (*kb.timed, *kb.comparisons)},
            },
            comparisons=kb.comparisons,
            gathers=_gathers(kb, auxiliary),
            conjunctions=_conjunctions(kb, auxiliary),
            work_limit=work_limit,
        )

    @cached_property
    def heads(self) -> tuple[str, ...]:
        """The heads in the order of `strata`."""
        return tuple(head for stratum in self.strata for head in stratum.predicates)

    @cached_property
    def recursive(self) -> Mapping[str, Component]:
        """The heads that depend on themselves → their strata."""
        return {head: s for s in self.strata if s.recursive for head in s.predicates}

    def tables(self, facts: Facts) -> Tables:
        """Return the known atoms of a scene: facts, what is said of values, and the background.

        Raises:
            FactError: see `check`; or a fact gives an atom of the background another bound.
        """
        self.check(facts)
        return Tables.of(facts, self.knowledge_base.background, self.comparisons)

    def check(self, facts: Facts) -> None:
        """Make sure that facts fit the knowledge base.

        Raises:
            FactError: a predicate, an attribute or a number of constants is not that of the
                knowledge base.
        """
        for predicate, relation in facts.relations().items():
            given = len(next(iter(relation)))
            if self.arities.get(predicate) != given:
                raise _unfit(predicate, given, self.arities, self.knowledge_base.attributes)
        for attribute, values in facts.values().items():
            _check_values(attribute, len(next(iter(values))), self.knowledge_base)

    def asserted(self, tables: Tables) -> tuple[tuple[Atom, Bound], ...]:
        """Return what is known of heads that depend on themselves, before any conclusion."""
        return tuple(
            (Atom(head, key), bound)
            for head in self.recursive
            for key, bound in tables.rows(head).items()
        )

    def plans(
        self, head: str, criterion: Criterion | None = None
    ) -> Iterator[tuple[Rule, Plan, tuple[str, ...]]]:
        """Yield how to conclude a head: for the subject alone where nothing else is needed.

        Args:
            head: the predicate.
            criterion: when literals hold; each rule's own by default.

        Yields:
            A rule, its plan, and the values that the plan is given.
        """
        for rule, values in self.needed_rules(head):
            plan = rule_plan(rule, self.work_limit, list(values), criterion)
            yield rule, plan, tuple(values.values())

    def needed_rules(self, head: str) -> Iterator[tuple[Rule, Mapping[str, str]]]:
        """Yield the rules of a head; where it is needed for the subject alone, those about it.

        Yields:
            A rule, and the values that variables of its head have then.
        """
        alone = self.for_subject_alone(head)
        for rule, _ in self.rules[head]:
            values = rule.clause.head.matched(self.subject_heads[head], {}) if alone else {}
            if values is not None:
                yield rule, values

    def head_plan(self, rule: Rule) -> Plan:
        """Return the plan of a rule's body that is given the variables of its head."""
        if rule.name not in self._head_plans:
            head = variables(*rule.clause.head.arguments)
            self._head_plans[rule.name] = rule_plan(rule, self.work_limit, head)
        return self._head_plans[rule.name]

    def for_subject_alone(self, head: str) -> bool:
        """Tell whether the reward needs a head of the subject only: no body reads it."""
        return head in self.subject_heads and head not in self.read_heads


def _gathers(kb: KnowledgeBase, auxiliary: Iterable[AuxiliaryRule]) -> dict[str, Gathering | None]:
    gathers = {name: GATHERINGS.get(kb.gathers(rule)) for name, rule in kb.rules.items()}
    return gathers | {found.rule.name: found.gathers for found in auxiliary}


def _conjunctions(kb: KnowledgeBase, auxiliary: Iterable[AuxiliaryRule]) -> dict[str, Operator]:
    usual = CONJUNCTIONS[kb.semantics.conjunction]
    own = {found.rule.name: found.conjunction or usual for found in auxiliary}
    return dict.fromkeys(kb.rules, usual) | own


def rule_plan(
    rule: Rule, limit: int, given: Sequence[str] = (), criterion: Criterion | None = None
) -> Plan:
    """Return the plan of a rule's body.

    Args:
        rule: the rule.
        limit: how many known atoms a search may look at.
        given: variables that have a value beforehand.
        criterion: when literals hold; the rule's own by default.
    """
    holds = criterion or rule_criterion(rule)
    owner = f"the rule '{rule.name}'"
    return Plan.of(rule.clause.body, holds, given, owner=owner, limit=limit)


def _check_values(name: str, given: int, kb: KnowledgeBase) -> None:
    if name in kb.predicates:
        raise FactError(
            f"facts give the predicate '{name}' a value",
            name=name,
            suggestion="give it a bound; numbers are declared under attributes",
        )
    if name not in kb.attributes:
        raise FactError(
            f"facts name the unknown attribute '{name}'",
            name=name,
            suggestion=did_you_mean(name, kb.attributes),
        )
    if kb.attributes[name].arity != given:
        raise FactError(
            f"facts give '{name}' {given} constants; it has {kb.attributes[name].arity}", name=name
        )


def _unfit(
    predicate: str, given: int, arities: Mapping[str, int], attributes: Container[str]
) -> FactError:
    if predicate in attributes:
        return FactError(
            f"facts give the attribute '{predicate}' a bound",
            name=predicate,
            suggestion=f"give it a value: as text {predicate}(…) = 7.5, in Python value=7.5",
        )
    if predicate not in arities:
        return FactError(
            f"facts name the unknown predicate '{predicate}'",
            name=predicate,
            suggestion=did_you_mean(predicate, arities),
        )
    return FactError(
        f"facts give '{predicate}' {given} constants; it has {arities[predicate]}", name=predicate
    )
