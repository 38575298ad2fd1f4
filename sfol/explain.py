"""Proof trees: why this confidence, this weight, this reward."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, islice
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text
from rich.tree import Tree

from sfol.clauses import Body
from sfol.engines.engine import Engine
from sfol.engines.matching import rule_criterion
from sfol.engines.plan import Plan
from sfol.engines.tables import Tables
from sfol.errors import expect
from sfol.facts import TRUE, Bound
from sfol.knowledge_base import KnowledgeBase, RewardTerm, Rule
from sfol.knowledge_base.recursion import Component
from sfol.literals import AtomLiteral, Counted, Literal, NoCounterexample, Ranging
from sfol.literals.search import WORK_LIMIT, Constants, Row
from sfol.outcome import Outcome
from sfol.syntax import Atom, Compared, Timed, variables

if TYPE_CHECKING:
    import networkx

_WIDTH = 110
# What a tree shows at most; people read the beginning, and a tree may grow without end.
_SHOWN_SUBSTITUTIONS = 100
_SHOWN_STATEMENTS = 5_000
_SHOWN_LEVELS = 25  # of conclusions that rest on conclusions
_TRIED_SETS = 300  # of literals that may be what a rule lacks
_STYLES = {
    "reward": "bold",
    "term": "bold cyan",
    "weight": "magenta",
    "head": "green",
    "rule": "yellow",
    "nothing": "dim",
    "miss": "dim",
    "formula": "dim",
}


@dataclass(frozen=True)
class Node:
    """One statement of a proof, and what it rests on.

    Attributes:
        kind: ``reward``, ``term``, ``formula``, ``weight``, ``head``, ``rule``, ``literal``,
            ``fact``, ``counted`` (one of those that a count counts), ``each`` (one of those of
            whom a forall speaks), ``nothing`` (a head that was not concluded) or ``miss`` (a rule
            that did not fire, with what it lacked).
        text: the statement, in one line.
        values: its numbers and names, for programs.
        children: what it rests on.
    """

    kind: str
    text: str
    values: Mapping[str, Any]
    children: tuple[Node, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the node and all below it as plain data for JSON."""
        return {
            "kind": self.kind,
            "text": self.text,
            **self.values,
            "children": [child.to_dict() for child in self.children],
        }

    def cut(self, depth: int) -> Node:
        """Return the node with at most so many levels below it."""
        if depth > 0:
            below = tuple(child.cut(depth - 1) for child in self.children)
            return Node(self.kind, self.text, self.values, below)
        more = (Node("nothing", "…", {}),) if self.children else ()
        return Node(self.kind, self.text, self.values, more)


@dataclass(frozen=True)
class Explanation:
    """A reward's proof tree; `print` shows it, a rich console in colour.

    Attributes:
        root: the reward; below it the terms, weights, heads, rules, literals and facts.
    """

    root: Node

    def to_dict(self) -> dict[str, Any]:
        """Return the tree as plain data for JSON."""
        return self.root.to_dict()

    def cut(self, depth: int) -> Explanation:
        """Return the explanation with at most so many levels below the reward.

        Raises:
            UsageError: the depth is no whole number.
        """
        expect(depth, int, "the depth", "give a whole number, such as 3")
        return Explanation(self.root.cut(depth))

    def to_networkx(self) -> networkx.DiGraph[int]:
        """Return the tree as a directed graph from each statement to what it rests on.

        Nodes are numbers in the order of the text, 0 being the reward; they have the attributes
        ``kind`` and ``text`` and those of `Node.values`.
        """
        import networkx  # noqa: PLC0415  (needed by few, and not light)

        graph: networkx.DiGraph[int] = networkx.DiGraph()
        waiting: list[tuple[Node, int | None]] = [(self.root, None)]
        while waiting:
            node, parent = waiting.pop()
            number = len(graph)
            graph.add_node(number, kind=node.kind, text=node.text, **node.values)
            if parent is not None:
                graph.add_edge(parent, number)
            waiting.extend((child, number) for child in reversed(node.children))
        return graph

    def __rich__(self) -> Tree:
        return _rich_tree(self.root)

    def __str__(self) -> str:
        text = io.StringIO()
        Console(file=text, width=_WIDTH, color_system=None, legacy_windows=False).print(self)
        return "\n".join(line.rstrip() for line in text.getvalue().splitlines())


def explain(
    engine: Engine, kb: KnowledgeBase, outcome: Outcome, signals: Mapping[str, float]
) -> Explanation:
    """Return the proof tree of an outcome.

    Args:
        engine: what drew its conclusions.
        kb: the knowledge base, with the coefficients and parameters that it was computed with.
        outcome: the outcome itself.
        signals: the signals that it was given, defaults filled in.
    """
    return Explanation(_Prover(engine, kb, outcome, signals).reward())


class _Prover:
    """Builds the nodes of one explanation."""

    def __init__(
        self, engine: Engine, kb: KnowledgeBase, outcome: Outcome, signals: Mapping[str, float]
    ) -> None:
        self._engine = engine
        self._kb = kb
        self._tables = outcome.conclusions.tables
        self._outcome = outcome
        self._signals = signals
        self._before: dict[Component, list[Tables]] = {}
        self._left = _SHOWN_STATEMENTS
        self._levels = 0

    def reward(self) -> Node:
        total = self._outcome.reward
        terms = tuple(self._term(term) for term in self._kb.terms.values())
        return Node("reward", f"reward {_number(total)}", {"value": total}, terms)

    def _term(self, term: RewardTerm) -> Node:
        value = self._outcome.terms[term.name]
        weight = self._outcome.weights[term.weight] if isinstance(term.weight, str) else term.weight
        confidences = self._outcome.confidences
        read = {head: confidences.get(head, 0.0) for head in term.heads}
        names = {**term.parameters, **self._signals, **read}
        component = term.formula(names)
        size = sum(abs(other) for other in self._outcome.terms.values())
        share = abs(value) / size if size else 0.0
        given = ", ".join(
            f"{name} = {_number(names[name])}{self._unit(name)}"
            for name in sorted(term.formula.names, key=list(names).index)
        )
        formula = Node(
            "formula",
            f"{term.formula} = {_number(component)}  with {given}",
            {"formula": term.formula.text, "value": component, "names": names},
        )
        below = [self._weight(term.weight)] if isinstance(term.weight, str) else []
        below += [self._head(head) for head in term.heads]
        text = (
            f"{term.name} {_number(value)} = {_number(weight)} × {_number(component)}"
            f"  ({share:.0%} of all terms)"
        )
        values = {"name": term.name, "value": value, "weight": weight, "share": share}
        return Node("term", text, values, (formula, *below))

    def _unit(self, name: str) -> str:
        unit = self._kb.signals[name].unit if name in self._kb.signals else "1"
        return "" if unit == "1" else f" {unit}"

    def _weight(self, name: str) -> Node:
        value = self._outcome.weights[name]
        weight = self._kb.weights[name]
        heads = tuple(self._head(head, factor) for head, factor in weight.coefficients.items())
        made = f"1/{weight.normalizer:g} of the sum below"
        if weight.smoothing is None:
            text = f"weight {name} {_number(value)} = {made}"
        else:
            text = f"weight {name} {_number(value)}, smoothed, follows {made}"
        return Node("weight", text, {"name": name, "value": value}, heads)

    def _head(self, head: str, coefficient: float | None = None) -> Node:
        """Return the node of a head, which a weight names with a coefficient, or a formula."""
        of_subject = Atom(head, (self._kb.subject,))  # of a head that an overlay removed, too
        atom = self._engine.program.subject_heads.get(head, of_subject)
        bound = self._tables.bound(atom)
        values: dict[str, Any] = {"atom": str(atom)}
        times = ""
        if coefficient is not None:
            values["coefficient"] = coefficient
            times = f"{_number(coefficient)} × "
        if bound is None:
            text = f"{times}0      {atom}: nothing concluded"
            misses = tuple(self._misses(head))
            return Node("nothing", text, {**values, "bound": None, "confidence": 0.0}, misses)
        confidence = self._outcome.confidences[head]
        text = f"{times}{_number(confidence)}  {atom} {bound}"
        return Node(
            "head",
            text,
            {**values, "bound": list(bound), "confidence": confidence},
            self._proofs(atom),
        )

    def _misses(self, head: str) -> Iterator[Node]:
        """Yield for every rule of a head why it did not conclude it for the subject."""
        for rule, plan in self._engine.program.rules.get(head, ()):
            miss = nearest_miss(rule, self._tables, self._kb.subject, plan.limit)
            if miss is not None:
                yield _miss_node(rule, miss, self._tables)

    def _proofs(self, atom: Atom) -> tuple[Node, ...]:
        """Return one node for every rule that concludes an atom.

        An atom that depends on itself is proved from what was known before it was first concluded
        with its bound, so that no proof rests on what it proves.
        """
        now, before = self._tables, self._known_before(atom)
        if before is None:
            return ()
        self._tables = before
        proofs = tuple(
            self._rule(rule, atom, bound)
            for rule, plan in self._engine.program.rules.get(atom.predicate, ())
            if (bound := self._bound_of(rule, plan, atom)) is not None
        )
        self._tables = now
        return proofs

    def _bound_of(self, rule: Rule, plan: Plan, atom: Atom) -> Bound | None:
        """Return the bound with which a rule concludes an atom, if it does."""
        return self._engine.rule_bounds(rule, plan, self._tables).get(atom.arguments)

    def _known_before(self, atom: Atom) -> Tables | None:
        """Return what was known when an atom was first concluded with the bound that it has now.

        Of an atom that depends on itself and has this bound without any rule there is nothing.
        """
        stratum = self._engine.program.recursive.get(atom.predicate)
        if stratum is None:
            return self._tables
        before = self._rounds(stratum)
        now = next((i for i, tables in enumerate(before) if tables is self._tables), -1)
        bound = before[now].bound(atom)
        first = next(i for i, tables in enumerate(before) if tables.bound(atom) == bound)
        return before[first - 1] if first else None

    def _rounds(self, stratum: Component) -> list[Tables]:
        """Return what was known before each round in which heads of a stratum were concluded."""
        if stratum not in self._before:
            conclusions = self._outcome.conclusions
            asserted = {a: b for a, b in conclusions.asserted if a.predicate in stratum.predicates}
            start = conclusions.tables.without(stratum.predicates).extended(asserted)
            rounds = self._engine.rounds(stratum, start)
            self._before[stratum] = [one.before for one in rounds]
        return self._before[stratum]

    def _rule(self, rule: Rule, atom: Atom, bound: Bound) -> Node:
        plan = self._engine.program.head_plan(rule)
        values_of = rule.clause.head.matched(atom, {}) or {}
        given = [values_of[name] for name in plan.variables[: plan.given]]
        found = plan.substitutions(self._tables, given, most=_SHOWN_SUBSTITUTIONS)
        literals = self._literals(rule, given)
        certain = rule.certainty == TRUE
        weakened = "" if certain else f" with certainty {rule.certainty_entry}"
        part = "" if rule.part_of is None else f", a part of {rule.entry}"
        text = f"{rule.clause}  {bound}{weakened}{part}"
        values = {
            "name": rule.name,
            "clause": str(rule.clause),
            "bound": list(bound),
            "substitutions": found,
            **({} if certain else {"certainty": list(rule.certainty)}),
            **({} if rule.part_of is None else {"part_of": rule.entry}),
        }
        return Node("rule", text, values, (_substitutions(rule, found), *literals))

    def _literals(self, rule: Rule, given: Sequence[str]) -> Iterator[Node]:
        """Yield a node for each literal of a rule, given the variables of its head."""
        plan = self._engine.program.head_plan(rule)
        support = plan.support(self._tables, given)
        for index, literal in enumerate(plan.body.atom_literals):
            if isinstance(literal, Ranging):
                continue
            yield self._literal(literal, [key for number, key in support if number == index])

    def _literal(self, literal: AtomLiteral, keys: Sequence[Constants]) -> Node:
        """Return a node for a literal, with every distinct ground atom that it stands for."""
        shown = keys[: max(self._left, 1)]
        self._left -= len(shown)
        grounded = (
            literal.substituted(dict(zip(literal.atom.arguments, key, strict=True)))
            for key in shown
        )
        facts = tuple(self._fact(ground) for ground in grounded)
        if len(keys) == 1:
            return facts[0]
        text = f"{literal}: {len(keys)} atoms"
        more = (_left_out(),) if len(shown) < len(keys) else ()
        return Node("literal", text, {"literal": str(literal)}, (*facts, *more))

    def _fact(self, literal: AtomLiteral) -> Node:
        atom = literal.atom
        bound = literal.bound(literal.known(self._tables))
        assert bound is not None, f"{literal} holds"
        if isinstance(literal, Counted):
            return self._count(literal, bound)
        if isinstance(literal, NoCounterexample):
            return self._of_all(literal, bound)
        derived = self._is_derived(literal)
        source = self._how_derived(atom, bound) if derived else self._origin(literal)
        values: dict[str, Any] = {"literal": str(literal), "bound": list(bound), "source": source}
        if (value := self._tables.value(atom)) is not None:
            values["value"] = value
        proofs = self._proofs_below(atom) if derived else ()
        return Node("fact", f"{literal} {bound}  {source}", values, proofs)

    def _is_derived(self, literal: AtomLiteral) -> bool:
        """Tell whether rules conclude what is known of a literal's atom."""
        derived = literal.monotone and literal.atom in self._outcome.derived
        return derived and self._known_before(literal.atom) is not None

    def _how_derived(self, atom: Atom, bound: Bound) -> str:
        last = self._outcome.derived[atom]
        return "derived" if bound == last else f"derived, and in the end {last}"

    def _count(self, literal: Counted, bound: Bound) -> Node:
        """Return a node for a count, with all that count, the best of them first."""
        ones = sorted(literal.ones(self._tables), key=lambda one: one[1], reverse=True)
        names, each = literal.count.quantified, literal.each.predicate
        below = self._each("counted", names, ones, lambda key: self._inside(each, key))
        values = {"literal": str(literal), "bound": list(bound), "counted": len(ones)}
        return Node("literal", f"{literal} {bound}  {len(ones)} counted", values, below)

    def _of_all(self, literal: NoCounterexample, bound: Bound) -> Node:
        """Return a node for a forall, with all of whom it speaks, the worst of them first."""
        found = [(key, literal.bound(c)) for key, c in literal.counterexamples(self._tables)]
        names = literal.forall.quantified
        below = self._each("each", names, found, lambda key: self._inside(literal.holding, key))
        values = {"literal": str(literal), "bound": list(bound), "each": len(found)}
        return Node("literal", f"{literal} {bound}  of {len(found)}", values, below)

    def _each(
        self,
        kind: str,
        names: Sequence[str],
        ones: Sequence[Row],
        inside: Callable[[Constants], Iterator[Node]],
    ) -> tuple[Node, ...]:
        """Return a node for each of those of whom a literal speaks."""
        shown = ones[: max(self._left, 1)]
        self._left -= len(shown)
        nodes = []
        for key, bound in shown:
            values = dict(zip(names, key, strict=False))
            text = f"{', '.join(f'{name} = {value}' for name, value in values.items())}  {bound}"
            below = tuple(inside(key)) if self._left > 0 else (_left_out(),)
            nodes.append(Node(kind, text, {"values": values, "bound": list(bound)}, below))
        return (*nodes, *([_left_out()] if len(shown) < len(ones) else []))

    def _inside(self, head: str, key: Constants) -> Iterator[Node]:
        """Yield the literals that one of those satisfies; none if it does not."""
        if self._tables.bound(Atom(head, key)) is not None:
            (rule, _), *_ = self._engine.program.rules[head]
            yield from self._literals(rule, list(key))

    def _proofs_below(self, atom: Atom) -> tuple[Node, ...]:
        if self._left <= 0 or self._levels >= _SHOWN_LEVELS:
            return (_left_out(),)
        self._levels += 1
        proofs = self._proofs(atom)
        self._levels -= 1
        return proofs

    def _origin(self, literal: AtomLiteral) -> str:
        if literal.known(self._tables) is None:
            return "unknown"
        predicate, arguments = literal.atom
        if isinstance(predicate, Timed):
            return self._when(predicate, arguments)
        if isinstance(predicate, Compared):
            return f"{predicate.of(arguments)} = {self._tables.value(literal.atom):.6g}"
        return "background" if literal.atom in self._kb.background else "asserted"

    def _when(self, predicate: Timed, arguments: Constants) -> str:
        """Return when what an operator over time says was so."""
        memory = self._outcome.conclusions.memory
        assert memory is not None, "only an episode knows what an operator over time says"
        remembered = memory.atoms[predicate].get(arguments)
        return predicate.operator.when(remembered, memory.step - 1, self._duration)

    def _duration(self, steps: int) -> str:
        if self._kb.time is None:
            return f"{steps} steps"
        return f"{steps * self._kb.time.step:.4g} {self._kb.time.unit}"


@dataclass(frozen=True)
class Miss:
    """How near a rule came to concluding something.

    Attributes:
        failed: the fewest literals without which the rest of the body holds; for a long body,
            literals of which none could be left out.
        values: the constants of the variables in the rest of the body.
    """

    failed: tuple[Literal, ...]
    values: Mapping[str, str]


def nearest_miss(rule: Rule, tables: Tables, subject: str, limit: int = WORK_LIMIT) -> Miss | None:
    """Return how near a rule came to concluding its head for the subject.

    Args:
        rule: a rule that did not conclude its head, which has one argument or none.
        tables: the scene.
        subject: the entity.
        limit: how many known atoms the search of a body may look at.

    Returns:
        The nearest miss; the first in the order of the body where several are as near. None if
        the rule's head is about another constant.
    """
    body, head = rule.clause.body, rule.clause.head
    given = head.matched(Atom(head.predicate, (subject,)[: len(head.arguments)]), {})
    if given is None:
        return None

    def without(failed: Sequence[Literal]) -> Miss | None:
        kept = Body(tuple(literal for literal in body.literals if literal not in failed))
        if not kept.bound_variables.union(given).issuperset(variables(*kept.terms)):
            return None
        owner = f"the rule '{rule.name}'"
        plan = Plan.of(kept, rule_criterion(rule), list(given), owner=owner, limit=limit)
        values = list(given.values())
        if not plan.holds(tables, values):
            return None
        return Miss(tuple(failed), next(iter(plan.substitutions(tables, values, most=1)), {}))

    sets = (
        failed
        for count in range(len(body.literals) + 1)
        for failed in combinations(body.literals, count)
    )
    tried = (miss for failed in islice(sets, _TRIED_SETS) if (miss := without(failed)))
    return next(tried, None) or _irreducible(body, without)


def _irreducible(body: Body, without: Callable[[Sequence[Literal]], Miss | None]) -> Miss:
    """Return a miss of which no literal can be taken back, the first ones of the body kept."""
    # What binds goes first, so that every literal finds its variables bound if they can be.
    waiting = sorted(body.literals, key=lambda literal: not literal.binds)
    failed = list(waiting)
    miss = without(failed)
    for literal in waiting:
        fewer = [other for other in failed if other is not literal]
        nearer = without(fewer)
        if nearer is not None:
            failed, miss = fewer, nearer
    assert miss is not None, "the empty body always holds"
    return miss


def _miss_node(rule: Rule, miss: Miss, tables: Tables) -> Node:
    reasons = [lit.substituted(miss.values).refutation(tables, rule) for lit in miss.failed]
    shown = ", ".join(f"{name} = {value}" for name, value in miss.values.items())
    text = f"rule {rule.name} lacks {' and '.join(reasons)}" + (f", with {shown}" if shown else "")
    failed = [str(literal) for literal in miss.failed]
    return Node("miss", text, {"name": rule.name, "failed": failed, "with": dict(miss.values)})


def _substitutions(rule: Rule, found: list[dict[str, str]]) -> Node:
    shown = "; ".join(", ".join(f"{k} = {v}" for k, v in values.items()) for values in found[:4])
    several = "more" if len(found) == _SHOWN_SUBSTITUTIONS else f"{len(found) - 4} more"
    more = f"; and {several}" if len(found) > 4 else ""
    return Node("formula", f"rule {rule.name} with {shown}{more}", {})


def _left_out() -> Node:
    return Node("nothing", "… and more, which is left out", {})


def _number(value: float) -> str:
    return f"{value + 0.0:.4g}"  # adding 0.0 turns -0.0 into 0.0


def _rich_tree(node: Node) -> Tree:
    style = _STYLES.get(node.kind, "")
    tree = Tree(Text(node.text, style), guide_style="dim")
    for child in node.children:
        tree.add(_rich_tree(child))
    return tree
