"""The default engine: one program per knowledge base, evaluated bottom-up by indexed joins."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from sfol.errors import FactError, did_you_mean
from sfol.facts import Bound, Facts
from sfol.knowledge_base import KnowledgeBase, Rule
from sfol.operators import CONJUNCTIONS, DISJUNCTIONS, Operator
from sfol.program import Constants, Plan, Program, Tables, ground
from sfol.syntax import Atom


@dataclass(frozen=True)
class Conclusions:
    """What follows from some facts.

    Attributes:
        tables: everything known in the end: facts, background and conclusions.
        derived: the atoms that some rule concluded, with their final bounds.
    """

    tables: Tables
    derived: Mapping[Atom, Bound]


class CompiledEngine:
    """Evaluates the strata of a program in order, each to its end.

    Args:
        kb: the knowledge base; it is compiled once, here.
    """

    def __init__(self, kb: KnowledgeBase) -> None:
        self.program = Program.of(kb)
        self._background = kb.background
        self._arities = {name: predicate.arity for name, predicate in kb.predicates.items()}
        self._conjunction = CONJUNCTIONS[kb.semantics.conjunction]
        self._disjunction = DISJUNCTIONS[kb.semantics.disjunction]
        self._pools = kb.semantics.pools

    def conclude(self, facts: Facts) -> Conclusions:
        """Return everything that follows from facts.

        Args:
            facts: ground atoms with bounds; they are not changed.

        Raises:
            FactError: a fact has a predicate or a number of constants that the knowledge base
                does not know.
        """
        self._check(facts)
        tables = Tables.of(facts, self._background)
        derived: dict[Atom, Bound] = {}
        for head in self.program.strata:
            for atom, bound in self._stratum(head, tables):
                derived[atom] = bound
                tables.put(atom, bound)
        return Conclusions(tables, derived)

    def rule_bounds(self, rule: Rule, plan: Plan, tables: Tables) -> dict[Constants, Bound]:
        """Return what one rule alone concludes: arguments of its head → bound."""
        satisfying: dict[Constants, list[dict[str, str]]] = {}
        for values in plan.substitutions(tables):
            satisfying.setdefault(ground(rule.clause.head, values).arguments, []).append(values)
        combine = self._pooled if self._pools else self._best
        return {head: combine(plan, found, tables) for head, found in satisfying.items()}

    def _stratum(self, head: str, tables: Tables) -> list[tuple[Atom, Bound]]:
        disjuncts: dict[Constants, list[Bound]] = {}
        for rule, plan in self.program.rules[head]:
            for arguments, bound in self.rule_bounds(rule, plan, tables).items():
                disjuncts.setdefault(arguments, []).append(bound)
        return [
            (atom, self._disjunction([*_present(tables.bound(atom)), *bounds]))
            for arguments, bounds in disjuncts.items()
            for atom in [Atom(head, arguments)]
        ]

    def _pooled(self, plan: Plan, found: Iterable[dict[str, str]], tables: Tables) -> Bound:
        """Combine each literal's distinct ground atoms over all substitutions, all together."""
        pool = {
            (index, ground(literal.atom, values)): plan.literal_bound(literal, tables, values)
            for values in found
            for index, literal in enumerate(plan.body.literals)
        }
        return self._conjunction(list(pool.values()))

    def _best(self, plan: Plan, found: Iterable[dict[str, str]], tables: Tables) -> Bound:
        """Combine per substitution, then take the greatest of lowers and of uppers."""
        best: Operator = DISJUNCTIONS["maximum"]
        return best(
            [
                self._conjunction(
                    [plan.literal_bound(literal, tables, v) for literal in plan.body.literals]
                )
                for v in found
            ]
        )

    def _check(self, facts: Facts) -> None:
        for predicate in facts.predicates():
            arity = self._arities.get(predicate)
            given = len(next(iter(facts.relation(predicate))))
            if arity is None:
                raise FactError(
                    f"facts name the unknown predicate '{predicate}'",
                    name=predicate,
                    suggestion=did_you_mean(predicate, self._arities),
                )
            if arity != given:
                raise FactError(
                    f"facts give '{predicate}' {given} constants; it has {arity}", name=predicate
                )


def _present(bound: Bound | None) -> Iterator[Bound]:
    if bound is not None:
        yield bound
