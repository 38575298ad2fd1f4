"""The reference engine: each scene becomes a PyReason program, and PyReason grounds its rules.

PyReason 3.8 means by a rule something else than a knowledge base does, so a rule is not handed
over as it stands, but as one or several *queries* that mean the same to both:

- Every rule has a private head, since PyReason intersects what several rules conclude; several
  rules with one head, and strata, are put together here. A rule's certainty is multiplied here,
  too: PyReason concludes what the body comes to. Rules that read what they conclude are run round
  after round until one changes nothing.
- Every clause has its threshold, since a clause without one means [1, 1]; atoms with upper bound 0
  are left out, since PyReason would let them pass at threshold 0.
- ``not P(X)`` reads the predicate ``not.P``, whose atoms are asserted with [1 − u, 1 − l], or with
  [1, 1] where P is unknown: PyReason's own negation fails on unknown atoms. ``X != Y`` reads
  ``are.different``, which takes no part in the conjunction.
- PyReason ties a body's variables to a head's variable only where they meet in one clause, so
  otherwise the head's variables are replaced by each entity that they could stand for.
- It narrows its variables pair by pair. That is exact where the pairs form no cycle; a constant
  that closes one is replaced by a variable that only this constant satisfies (``is.ego``). A rule
  whose own variables form a cycle is grounded here, and PyReason gets ground rules.
- It tells an annotation function which atoms satisfied each clause, not which of them belong
  together; for ``groundings: best`` that function joins them again.

- It splits its texts at commas and blanks, so integers and quoted texts have names of their own
  there (`sfol.engines.pyreason_names`).

A name with a dot can't be one of the knowledge base's, so none of these are ever confused.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from sfol.engines.compiled import CompiledEngine
from sfol.engines.conclusions import Conclusions
from sfol.engines.plan import Plan
from sfol.engines.program import Program
from sfol.engines.pyreason_names import (
    coded_knowledge_base,
    coded_tables,
    decoded_atom,
    decoded_row,
)
from sfol.engines.pyreason_program import Query, Script, TraceRow, joined
from sfol.engines.rounds import Round
from sfol.engines.tables import Tables
from sfol.errors import KnowledgeBaseError
from sfol.facts import TRUE, Bound, Facts
from sfol.knowledge_base import KnowledgeBase, Rule
from sfol.knowledge_base.recursion import Component
from sfol.literals import Literal, QueryClause
from sfol.literals.search import WORK_LIMIT, Constants, Rows
from sfol.operators import BEST, DISJUNCTIONS, POOLED, times
from sfol.syntax import Atom, is_variable, variables

_IS = "is."
_RESERVED = "forall"


class PyReasonEngine:
    """Draws conclusions with PyReason, and the same ones as the compiled engine.

    Args:
        kb: the knowledge base.
        work_limit: how many known atoms the search of a body may look at, here; PyReason itself
            has no limit.

    Attributes:
        program: its rules in order.
        grounded_for_pyreason: names of the rules whose variables form a cycle, so that this engine
            has to ground them for PyReason.

    Raises:
        MissingExtraError: PyReason is not installed.
        KnowledgeBaseError: a predicate has a name that PyReason takes for something else.
    """

    def __init__(self, kb: KnowledgeBase, work_limit: int = WORK_LIMIT) -> None:
        import sfol.engines.pyreason_runtime  # noqa: F401, PLC0415  (fail at once, not later)

        _check_names(kb)
        _check_rules(kb)
        self._compiled = CompiledEngine(kb, work_limit)
        self.program = self._compiled.program
        self.grounded_for_pyreason = frozenset(
            rule.name for rule in kb.rules.values() if _is_cyclic(rule)
        )
        self._kb = coded_knowledge_base(kb)
        self._levels = [
            ([self._kb.rules[rule.name] for rule in level], recursive)
            for level, recursive in _levels(self.program)
        ]
        self._readers = {
            literal.query(rule).predicate: literal
            for rule in self._kb.rules.values()
            for literal in rule.clause.body.literals
        }
        self._numbers = {name: number for number, name in enumerate(kb.rules)}

    def conclude(self, facts: Facts) -> Conclusions:
        """Return everything that follows from facts.

        Args:
            facts: ground atoms with bounds; they are not changed.

        Raises:
            FactError: a fact does not fit the knowledge base.
        """
        return self._conclude(facts, [])

    def trace(self, facts: Facts) -> list[TraceRow]:
        """Return PyReason's own trace of how it came to its conclusions: a second explanation.

        Raises:
            FactError: a fact does not fit the knowledge base.
        """
        rows: list[TraceRow] = []
        self._conclude(facts, rows, trace=True)
        return rows

    def rule_bounds(self, rule: Rule, plan: Plan, tables: Tables) -> Mapping[Constants, Bound]:
        """Return what one rule alone concludes: as the compiled engine does, for explanations."""
        return self._compiled.rule_bounds(rule, plan, tables)

    def rounds(self, stratum: Component, tables: Tables) -> Iterator[Round]:
        """Yield the rounds by which heads that depend on each other are concluded, likewise."""
        return self._compiled.rounds(stratum, tables)

    def to_pyreason(self, facts: Facts) -> tuple[Any, list[Any], list[Any]]:
        """Return the PyReason program of a scene; see `KnowledgeBase.to_pyreason`."""
        from sfol.engines import pyreason_runtime  # noqa: PLC0415

        tables = coded_tables(self.conclude(facts).tables)
        script = self._script(self._kb.rules.values(), tables)
        return (
            pyreason_runtime.graph_of(script),
            pyreason_runtime.rules_of(script),
            pyreason_runtime.facts_of(script),
        )

    def _conclude(self, facts: Facts, rows: list[TraceRow], *, trace: bool = False) -> Conclusions:
        from sfol.engines import pyreason_runtime  # noqa: PLC0415

        tables = self.program.tables(facts)
        asserted = self.program.asserted(tables)
        known = coded_tables(tables)
        derived: dict[Atom, Bound] = {}
        for rules, recursive in self._levels:
            found: dict[Atom, Bound] = {}
            changes = True
            while changes:  # in one round, where no rule reads what another one concludes
                script = self._script(rules, known)
                answer = pyreason_runtime.run(script, trace=trace)
                rows += map(decoded_row, answer.trace)
                before, found = found, dict(self._conclusions(script, answer.bounds, known))
                known.revise(found)
                changes = recursive and found != before
            derived |= {decoded_atom(atom): bound for atom, bound in found.items()}
        for atom, bound in derived.items():
            tables.put(atom, bound)
        return Conclusions(tables, derived, self.program, None, asserted)

    def _script(self, rules: Iterable[Rule], tables: Tables) -> Script:
        scene = _Scene(self._kb, tables, self._readers)
        queries = tuple(query for rule in rules for query in self._queries(rule, scene))
        read = dict.fromkeys(clause.predicate for query in queries for clause in query.body)
        # PyReason looks at its rules only once a fact has told it something, which [0, 1] does not.
        read[f"{_IS}{self._kb.subject}"] = None
        facts = {
            Atom(predicate, arguments): bound
            for predicate in read
            for arguments, bound in scene.rows(predicate).items()
        }
        return Script(scene.domain, facts, queries)

    def _queries(self, rule: Rule, scene: _Scene) -> Iterator[Query]:
        body = _query_body(rule)
        semantics = self._kb.semantics
        pools = self._kb.gathers(rule) == POOLED
        conjunction = f"{'' if pools else 'best_'}{semantics.conjunction}"
        name = f"{rule.clause.head.predicate}.{self._numbers[rule.name]}"
        for values in _head_values(rule, body, scene):
            head = Atom(name, _replaced(rule.clause.head.arguments, values))
            ground = tuple(c._replace(terms=_replaced(c.terms, values)) for c in body)
            if rule.name not in self.grounded_for_pyreason:
                yield Query(rule.name, head, _without_cycles(ground), conjunction)
                continue
            for number, found in enumerate(self._grounded(ground, scene, pools=pools)):
                part = Atom(f"{name}.{number}", head.arguments)
                yield Query(rule.name, part, found, conjunction)

    def _grounded(
        self, body: Sequence[QueryClause], scene: _Scene, *, pools: bool
    ) -> list[tuple[QueryClause, ...]]:
        """Return ground bodies: one for each substitution, or where they are pooled a single one.

        A pooled body has, for each clause, all the distinct atoms that it stands for.
        """
        relations = [(clause.terms, scene.satisfying(clause)) for clause in body]
        constants = {term: term for c in body for term in c.terms if not is_variable(term)}
        bodies = [
            tuple(clause._replace(terms=_replaced(clause.terms, values)) for clause in body)
            for values in joined(relations, constants)
        ]
        if pools and bodies:
            columns = zip(*bodies, strict=True)
            bodies = [tuple(atom for column in columns for atom in dict.fromkeys(column))]
        return [_singles_first(ground) for ground in bodies]

    def _conclusions(
        self, script: Script, found: Mapping[Atom, Bound], tables: Tables
    ) -> Iterator[tuple[Atom, Bound]]:
        """Yield the final bound of every atom that some rule concluded."""
        queries = {query.head.predicate: query for query in script.queries}
        by_head: dict[Atom, dict[str, list[Bound]]] = {}
        for private, bound in found.items():
            query = queries[private.predicate]
            head = Atom(query.predicate, private.arguments)
            by_head.setdefault(head, {}).setdefault(query.rule, []).append(bound)
        for head, by_rule in by_head.items():
            asserted = tables.bound(head)
            disjuncts = [] if asserted is None else [asserted]
            # In the order of the file. Several bounds of one rule come from its ground bodies.
            disjuncts += [
                times(DISJUNCTIONS["maximum"](by_rule[name]), rule.certainty)
                for name, rule in self._kb.rules.items()
                if name in by_rule
            ]
            yield head, DISJUNCTIONS[self._kb.semantics.disjunction](disjuncts)


class _Scene:
    """What is known, with the predicates that queries need besides the knowledge base's own.

    Args:
        kb: the knowledge base.
        tables: what is known.
        readers: predicate of a query → a literal that is put to PyReason with it.
    """

    def __init__(self, kb: KnowledgeBase, tables: Tables, readers: Mapping[str, Literal]) -> None:
        self.domain = _domain(kb, tables)
        self._tables = tables
        self._readers = readers
        self._rows: dict[str, Rows] = {}

    def rows(self, predicate: str) -> Rows:
        """Return the atoms of a predicate of a query: arguments → bound."""
        if predicate not in self._rows:
            self._rows[predicate] = self._make(predicate)
        return self._rows[predicate]

    def satisfying(self, clause: QueryClause) -> list[Constants]:
        """Return the arguments of the atoms that satisfy a clause."""
        rows = self.rows(clause.predicate).items()
        return [arguments for arguments, bound in rows if bound.lower >= clause.threshold]

    def _make(self, predicate: str) -> Rows:
        if predicate.startswith(_IS):
            return {(predicate.removeprefix(_IS),): TRUE}
        return self._readers[predicate].query_rows(self._tables, self.domain)


def _query_body(rule: Rule) -> list[QueryClause]:
    """Return the literals of a rule as clauses that PyReason understands."""
    clauses = [literal.query(rule) for literal in rule.clause.body.literals]
    pairs = {clause.terms for clause in clauses if not clause.symmetric}
    # What has no direction takes that of a literal which joins the same two terms.
    return [
        clause._replace(terms=clause.terms[::-1])
        if clause.symmetric and clause.terms not in pairs
        else clause
        for clause in clauses
    ]


def _head_values(
    rule: Rule, body: Sequence[QueryClause], scene: _Scene
) -> Iterator[Mapping[str, str]]:
    """Yield values of the head's variables: one empty mapping where a variable may stay."""
    if _is_tied(rule.clause.head, body) and not _is_cyclic(rule):
        yield {}
        return
    names = variables(*rule.clause.head.arguments)
    choices = [_possible_values(name, body, scene) for name in names]
    for constants in itertools.product(*choices):
        yield dict(zip(names, constants, strict=True))


def _is_tied(head: Atom, body: Sequence[QueryClause]) -> bool:
    """Tell whether PyReason ties everything in a body that must be tied to the head's variable.

    It does where the head has one variable, and the clauses with that variable share no other.
    """
    (term, *others) = head.arguments
    if others or not is_variable(term):
        return False
    uses = Counter(name for clause in body for name in clause.terms if is_variable(name))
    beside = [name for clause in body if term in clause.terms for name in clause.terms]
    return all(uses[name] == 1 for name in beside if name != term and is_variable(name)) and (
        (term, term) not in [clause.terms for clause in body]
    )


def _possible_values(variable: str, body: Sequence[QueryClause], scene: _Scene) -> list[str]:
    """Return the constants that stand wherever the variable does."""
    columns = [
        {row[position] for row in scene.rows(clause.predicate)}
        for clause in body
        for position, term in enumerate(clause.terms)
        if term == variable
    ]
    return sorted(set.intersection(*columns))


def _is_cyclic(rule: Rule) -> bool:
    """Tell whether the variables of a body form a cycle once the head's have values."""
    head = variables(*rule.clause.head.arguments)
    pairs = {clause.terms for clause in _query_body(rule) if len(clause.terms) == 2}
    trees = _Trees()
    return any(
        not trees.connect(*pair)
        for pair in pairs
        if all(is_variable(term) and term not in head for term in pair)
    )


def _without_cycles(body: Sequence[QueryClause]) -> tuple[QueryClause, ...]:
    """Return a body whose variables form no cycle such that its constants close none either."""
    trees = _Trees()
    connected: set[Constants] = set()
    clauses: list[QueryClause] = []
    # Variables first: where a clause closes a cycle, it then has a constant to take out.
    for clause in sorted(body, key=lambda c: len(variables(*c.terms)), reverse=True):
        if len(clause.terms) == 1 or clause.terms in connected or trees.connect(*clause.terms):
            connected.add(clause.terms)
            clauses.append(clause)
            continue
        constant = next(term for term in reversed(clause.terms) if not is_variable(term))
        name = f"{constant}.{len(clauses)}"
        at = len(clause.terms) - 1 - clause.terms[::-1].index(constant)
        terms = (*clause.terms[:at], name, *clause.terms[at + 1 :])
        clauses += [
            clause._replace(terms=terms),
            QueryClause(f"{_IS}{constant}", (name,), 1.0, counts=False),
        ]
    return _singles_first(clauses)


class _Trees:
    """A union-find structure over terms."""

    def __init__(self) -> None:
        self._parents: dict[str, str] = {}

    def connect(self, left: str, right: str) -> bool:
        """Connect two terms; False if they were connected, so that this closes a cycle."""
        one, other = self._root(left), self._root(right)
        self._parents[one] = other
        return one != other

    def _root(self, term: str) -> str:
        parent = self._parents.get(term, term)
        return term if parent == term else self._root(parent)


def _singles_first(body: Iterable[QueryClause]) -> tuple[QueryClause, ...]:
    return tuple(sorted(body, key=lambda clause: len(clause.terms)))


def _replaced(terms: Constants, values: Mapping[str, str]) -> Constants:
    return tuple(values.get(term, term) for term in terms)


def _levels(program: Program) -> list[tuple[list[Rule], bool]]:
    """Return the rules in groups, each of which reads conclusions of earlier ones alone.

    With each group stands whether it reads its own conclusions as well.
    """
    depths: dict[str, int] = {}
    levels: dict[tuple[int, bool], list[Rule]] = {}
    for stratum in program.strata:
        rules = [rule for head in stratum.predicates for rule, _ in program.rules[head]]
        read = {name for rule in rules for name in rule.clause.body.predicates}
        depth = 1 + max((depths.get(name, 0) for name in read), default=0)
        depths |= dict.fromkeys(stratum.predicates, depth)
        levels.setdefault((depth, stratum.recursive), []).extend(rules)
    return [(rules, recursive) for (_, recursive), rules in sorted(levels.items())]


def _domain(kb: KnowledgeBase, tables: Tables) -> Constants:
    """Return every constant: those of facts, the subject and those that only rules name."""
    terms = {kb.subject, *(term for atom, _ in tables.items() for term in atom.arguments)}
    for rule in kb.rules.values():
        terms.update(rule.clause.head.arguments, rule.clause.body.terms)
    return tuple(sorted(term for term in terms if not is_variable(term)))


def _check_names(kb: KnowledgeBase) -> None:
    for name in sorted(kb.read.union(kb.heads)):
        arity = kb.predicates[name].arity
        if arity not in (1, 2):
            raise KnowledgeBaseError(
                f"PyReason can't express the predicate '{name}' with {arity} arguments: its atoms "
                "are of one node or of one edge",
                name=name,
                suggestion="use engine='compiled'",
            )
    for name in kb.predicates:
        if name.endswith(_RESERVED):
            raise KnowledgeBaseError(
                f"PyReason can't express the predicate '{name}': it reads '{_RESERVED}(' as a "
                "quantifier",
                name=name,
                suggestion="rename it, or use engine='compiled'",
            )


def _check_rules(kb: KnowledgeBase) -> None:
    for rule in kb.rules.values():
        for literal in rule.clause.body.literals:
            literal.query(rule)
        if (gathers := kb.gathers(rule)) not in (POOLED, BEST.name):
            raise KnowledgeBaseError(
                f"PyReason can't express the groundings '{gathers}' of the rule '{rule.entry}'",
                name=gathers,
                suggestion="use engine='compiled'",
            )
