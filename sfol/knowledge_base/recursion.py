"""Which heads depend on themselves, and whether that has a meaning.

A cycle of rules has one where every bound can only grow with the bounds that it is taken from, and
is no greater than the least of them: then rounds of inference, beginning with nothing, come to rest
after finitely many, at the least bounds that fit all rules.

Source: M. Kifer and V. S. Subrahmanian, "Theory of generalized annotated logic programming and its
applications", Journal of Logic Programming 12, 1992; M. H. van Emden, "Quantitative deduction and
its fixpoint theory", Journal of Logic Programming 3, 1986.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from sfol.knowledge_base.format import Semantics
from sfol.knowledge_base.parts import Rule
from sfol.knowledge_base.reporting import Reporter
from sfol.literals import AtomLiteral, Literal, Positive, Quantified
from sfol.operators import BEST
from sfol.syntax import Timed

_CONJUNCTION, _DISJUNCTION = "minimum", "maximum"
_Graph = Mapping[str, Collection[str]]
_MOST_SHOWN = 10  # of a circle


class Component(NamedTuple):
    """Predicates that depend on each other, or one that does not.

    Attributes:
        predicates: all of them.
        recursive: whether they depend on themselves.
    """

    predicates: tuple[str, ...]
    recursive: bool


def components(rules: Iterable[Rule]) -> tuple[Component, ...]:
    """Return all predicates of rules, those that depend on each other together.

    They are the strongly connected components of the dependency graph, each after those that it
    depends on.

    Source: the algorithm of S. R. Kosaraju, in A. V. Aho, J. E. Hopcroft and J. D. Ullman, "Data
    structures and algorithms", 1983.
    """
    reads = _dependencies(rules)
    read_by: dict[str, list[str]] = {}
    for head, read in reads.items():
        for name in read:
            read_by.setdefault(name, []).append(head)
    found: list[Component] = []
    seen: set[str] = set()
    # What is left last comes first; so those that do not depend on each other stay in order.
    backwards = reversed({**read_by, **reads})
    for name in reversed(_left_in_order(read_by, backwards, set())):
        together = tuple(_left_in_order(reads, [name], seen))
        if together:
            recursive = len(together) > 1 or name in reads.get(name, ())
            found.append(Component(together, recursive))
    return tuple(found)


def check_recursion(rules: Mapping[str, Rule], semantics: Semantics, reporter: Reporter) -> None:
    """Report the cycles of rules that have no meaning: where, which, why and what to do.

    Args:
        rules: by name.
        semantics: the operators with which they are read.
        reporter: is told.
    """
    circle_of = {
        name: number
        for number, component in enumerate(components(rules.values()))
        for name in component.predicates
        if component.recursive
    }
    closing: dict[int, list[_Closing]] = {}
    for rule in rules.values():
        number = circle_of.get(rule.clause.head.predicate, -1)
        for literal in rule.clause.body.literals:
            read = tuple(name for name in _present(literal) if circle_of.get(name) == number)
            if read:
                closing.setdefault(number, []).append(_Closing(rule, literal, read))
    for literals in closing.values():
        for closes, why, instead in _faults(literals, semantics):
            rule = closes.rule
            reporter.report(
                ("rules", rule.entry, "rule"),
                f"rules depend on each other in a circle: {_circle(literals, closes)}; {why}",
                rule.clause.head.predicate,
                f"{instead} leave '{closes.literal}' out of the rule '{rule.entry}'",
            )


class _Closing(NamedTuple):
    """A literal that closes a circle: the rule's head depends on itself through what it reads."""

    rule: Rule
    literal: Literal
    read: tuple[str, ...]


def _faults(
    closing: Sequence[_Closing], semantics: Semantics
) -> Iterator[tuple[_Closing, str, str]]:
    """Yield what closes a circle that has no meaning, with why, and what to do instead."""
    denied = [(closes, why) for closes in closing if (why := _why_not(closes.literal))]
    for closes, why in denied:
        yield closes, why, "a head may take part in its own derivation only as P(X) does:"
    if denied:
        return
    asked = {"conjunction": _CONJUNCTION, "disjunction": _DISJUNCTION}
    wrong = {key: value for key, value in asked.items() if getattr(semantics, key) != value}
    if wrong:
        has = " and ".join(f"{key}: {getattr(semantics, key)}" for key in wrong)
        needs = ", ".join(f"{key}: {value}" for key, value in wrong.items())
        yield (
            closing[0],
            f"a bound would be taken from itself, which has no meaning with {has}",
            f"write semantics: {{{needs}}}, or",
        )
        return
    for closes in closing:
        gathers = closes.rule.groundings or semantics.gathers
        if gathers != BEST.name:
            yield (
                closes,
                f"a bound would be taken from itself, which has no meaning with groundings: "
                f"{gathers}",
                f"write groundings: {BEST.name}, or",
            )


def _why_not(literal: Literal) -> str | None:
    """Return why a literal can't close a circle; None if it can."""
    if isinstance(literal, Quantified):
        return f"'{literal}' would speak of all of what follows from it"
    if not isinstance(literal, Positive):
        return f"'{literal}' would deny what follows from it"
    if isinstance(literal.atom.predicate, Timed):
        return f"'{literal}' would look back at what follows from it"
    return None


def _present(literal: Literal) -> list[str]:
    """Return the predicates whose atoms of the same step a literal depends on."""
    inside = literal.literals if isinstance(literal, Quantified) else (literal,)
    atoms = (lit.atom for lit in inside if isinstance(lit, AtomLiteral))
    return sorted({present.predicate for atom in atoms for present in atom.present})


def _circle(closing: Iterable[_Closing], closes: _Closing) -> str:
    """Return the shortest circle through a literal: each predicate before a head that reads it."""
    readers: dict[str, list[str]] = {}
    for other in closing:
        for name in other.read:
            readers.setdefault(name, []).append(other.rule.clause.head.predicate)
    head = closes.rule.clause.head.predicate
    came_from = {head: head}
    waiting = deque([head])
    while not (reached := [name for name in closes.read if name in came_from]):
        name = waiting.popleft()
        new = dict.fromkeys(reader for reader in readers[name] if reader not in came_from)
        came_from |= dict.fromkeys(new, name)
        waiting.extend(new)
    names = reached[:1]
    while names[-1] != head:
        names.append(came_from[names[-1]])
    names = [*reversed(names), head]
    if len(names) > _MOST_SHOWN:
        names = [*names[: _MOST_SHOWN - 2], "…", names[-1]]
    return " → ".join(names)


def _dependencies(rules: Iterable[Rule]) -> _Graph:
    """Return for every head the predicates whose atoms of the same step its rules depend on."""
    graph: dict[str, dict[str, None]] = {}
    for rule in rules:
        read = dict.fromkeys(sorted(rule.clause.body.present))
        graph.setdefault(rule.clause.head.predicate, {}).update(read)
    return graph


def _left_in_order(graph: _Graph, roots: Iterable[str], seen: set[str]) -> list[str]:
    """Return what a depth-first search leaves, in this order; it adds to what is seen."""
    left: list[str] = []
    for root in roots:
        path = [] if root in seen else [(root, iter(graph.get(root, ())))]
        seen.add(root)
        while path:
            name, rest = path[-1]
            new = next((other for other in rest if other not in seen), None)
            if new is None:
                left.append(name)
                path.pop()
            else:
                seen.add(new)
                path.append((new, iter(graph.get(new, ()))))
    return left
