"""What rules can never conclude, as far as a knowledge base says: rewards that stay 0 in silence.

Arguments are followed through the rules by their *kinds*: a constant is of a kind of its own, and
so are the entities of a sort. Where a file says how facts are read, an atom that neither it nor
the background nor a rule gives is never known; where a program makes the facts, any atom may be.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from sfol.knowledge_base.model import KnowledgeBase
from sfol.knowledge_base.observing import entity_names
from sfol.knowledge_base.parts import Rule
from sfol.knowledge_base.recursion import components
from sfol.strict_yaml import Keys
from sfol.syntax import Atom, is_name, is_variable, parse_facts

_Kinds = frozenset[str] | None  # of an argument; None if it may be of any
_MOST_SHOWN = 3


@dataclass(frozen=True)
class Silence:
    """Something that keeps rules from concluding anything.

    Attributes:
        cause: ``subject`` if no rule of a head is about the subject, ``constant`` if nothing else
            names a constant of a rule, ``sort`` if no entity fits a rule.
        path: the keys of the part of the knowledge base that it is about.
        message: what it is, in one sentence.
        suggestion: what to do.
    """

    cause: Literal["subject", "constant", "sort"]
    path: Keys
    message: str
    suggestion: str


def silences(kb: KnowledgeBase, known: Collection[str] = ()) -> tuple[Silence, ...]:
    """Return what keeps the rules of a knowledge base from concluding anything.

    Args:
        kb: the knowledge base.
        known: constants that the facts of a scene name.
    """
    named = _named(kb).union(known)
    return (
        *_unnamed_subject(kb, named),
        *_Kinship(kb).silences(),
        *_lonely_constants(kb, named | {kb.subject}),
    )


def _unnamed_subject(kb: KnowledgeBase, named: Collection[str]) -> Iterator[Silence]:
    background = _constants(*kb.background)
    rules = _constants(*(atom for rule in kb.rules.values() for atom in _atoms_of(rule)))
    weighed = kb.weighed.intersection(kb.heads)
    about_subject = any(kb.predicates[head].arity for head in weighed)  # propositions are not
    if background and about_subject and kb.subject not in {*named, *rules}:
        yield Silence(
            "subject",
            ("subject",),
            f"nothing names the subject '{kb.subject}'; the background is about "
            f"{_shown(background)}",
            "correct the subject: the reward is made of what is concluded about it",
        )


def _lonely_constants(kb: KnowledgeBase, named: Collection[str]) -> Iterator[Silence]:
    """Yield the constants of rules that nothing else names: probably meant as variables."""
    rules = {name: _constants(*_atoms_of(rule)) for name, rule in kb.rules.items()}
    times = Counter(constant for constants in rules.values() for constant in constants)
    for name, constants in rules.items():
        for constant in sorted(constants.difference(named)):
            if times[constant] == 1 and is_name(constant):  # no number or quoted text
                yield Silence(
                    "constant",
                    ("rules", name),
                    f"the rule '{name}' names '{constant}', which no fact, test or other rule "
                    "does: a constant stands for one entity of that name",
                    f"for any entity write {constant[0].upper()}{constant[1:]}; or let a test or "
                    "the background name it",
                )


def _named(kb: KnowledgeBase) -> frozenset[str]:
    """Return the constants that a knowledge base names outside of its rules."""
    scenes = [case.facts for case in kb.tests]
    scenes += [step.facts for case in kb.tests for step in case.steps]
    tests = [[facts] if isinstance(facts, str) else facts for facts in scenes]
    atoms = [atom for texts in tests for text in texts for atom, *_ in parse_facts(text)]
    atoms += [*kb.background, *(fact.atom for fact in kb.facts)]
    atoms += [a for c in kb.entity_weights for lit in c.when.literals for a in lit.atoms]
    return _constants(*atoms).union(_sorts_of_entities(kb))


def _atoms_of(rule: Rule) -> tuple[Atom, ...]:
    literals = rule.clause.body.literals
    return (rule.clause.head, *(atom for literal in literals for atom in literal.atoms))


def _constants(*atoms: Atom) -> frozenset[str]:
    return frozenset(term for a in atoms for term in a.arguments if not is_variable(term))


def _sorts_of_entities(kb: KnowledgeBase) -> dict[str, str]:
    return {entity: sort for sort, s in kb.entities.items() for entity in entity_names(sort, s)}


class _Kinship:
    """The kinds of every predicate's arguments.

    Args:
        kb: the knowledge base.
    """

    def __init__(self, kb: KnowledgeBase) -> None:
        self._kb = kb
        self._sorts = _sorts_of_entities(kb)
        self._kinds: dict[str, tuple[_Kinds, ...]] = {}

    def silences(self) -> Iterator[Silence]:
        """Yield rules that no entity fits, then heads that are never about the subject."""
        rules: dict[str, list[Rule]] = {}
        for rule in self._kb.rules.values():
            rules.setdefault(rule.clause.head.predicate, []).append(rule)
        # What depends on itself is taken to be of any kind where it is not known yet.
        found = components(self._kb.rules.values())
        for predicate in (name for component in found for name in component.predicates):
            fit = [self._variables(rule) for rule in rules.get(predicate, ())]
            yield from (kinds for kinds in fit if isinstance(kinds, Silence))
            heads = [
                tuple(self._of_argument(term, kinds) for term in rule.clause.head.arguments)
                for rule, kinds in zip(rules.get(predicate, ()), fit, strict=True)
                if not isinstance(kinds, Silence)
            ]
            if heads and predicate in self._kb.weighed and len(heads[0]) == 1:
                yield from self._about_others(predicate, rules[predicate][0], heads)
            self._kinds[predicate] = self._known_of(predicate, heads)

    def _about_others(
        self, head: str, rule: Rule, kinds: Sequence[tuple[_Kinds, ...]]
    ) -> Iterator[Silence]:
        subject = self._kb.subject
        if any(kind is None or self._kind(subject) in kind for (kind,) in kinds):
            return
        about = frozenset().union(*(kind for (kind,) in kinds if kind is not None))
        yield Silence(
            "subject",
            ("rules", rule.name),
            f"no rule concludes '{head}' about the subject '{subject}', but about {_shown(about)}",
            "correct the subject or the rule: the reward is made of what is concluded about the "
            "subject",
        )

    def _variables(self, rule: Rule) -> dict[str, _Kinds] | Silence:
        """Return the kinds of a rule's variables, or that one of them has none."""
        kinds: dict[str, _Kinds] = {}
        seen: dict[str, Atom] = {}
        for literal in rule.clause.body.atom_literals:
            if not literal.binds:
                continue
            atom = literal.atom
            columns = self._kinds.get(atom.predicate) or (None,) * len(atom.arguments)
            for term, column in zip(atom.arguments, columns, strict=True):
                before = self._of_argument(term, kinds)
                fit = column if before is None else before if column is None else before & column
                if fit is not None and not fit:
                    assert before is not None
                    assert column is not None
                    return _unfit(rule, term, (before, seen.get(term)), (column, atom))
                kinds[term] = fit
                seen.setdefault(term, atom)
        return kinds

    def _of_argument(self, term: str, kinds: Mapping[str, _Kinds]) -> _Kinds:
        return kinds.get(term) if is_variable(term) else frozenset([self._kind(term)])

    def _kind(self, constant: str) -> str:
        return self._sorts.get(constant, constant)

    def _known_of(self, predicate: str, heads: Sequence[tuple[_Kinds, ...]]) -> tuple[_Kinds, ...]:
        """Return the kinds of a predicate's arguments, from everything that gives it."""
        kb = self._kb
        arity = kb.predicates[predicate].arity
        if not kb.facts and kb.predicates[predicate].declared:
            return (None,) * arity  # a program may say it of anything
        given = [*heads]
        given += [
            tuple(frozenset([self._kind(term)]) for term in atom.arguments)
            for atom in kb.background
            if atom.predicate == predicate
        ]
        given += [
            tuple(frozenset([self._kind(term)]) for term in fact.slots[1:])
            for fact in kb.facts
            if fact.atom.predicate == predicate
        ]
        # Of what nothing gives another finding tells; here it fits everything.
        return tuple(map(_union, zip(*given, strict=True))) if given else (None,) * arity


def _union(kinds: Sequence[_Kinds]) -> _Kinds:
    known = [kind for kind in kinds if kind is not None]
    return frozenset().union(*known) if len(known) == len(kinds) else None


def _unfit(
    rule: Rule,
    term: str,
    before: tuple[frozenset[str], Atom | None],
    after: tuple[frozenset[str], Atom],
) -> Silence:
    kinds, earlier = before
    where = f"is {_shown(kinds)} in {earlier}, but" if earlier and is_variable(term) else "is"
    return Silence(
        "sort",
        ("rules", rule.name),
        f"no entity fits the rule '{rule.name}': {term} {where} "
        f"{'' if is_variable(term) else 'not '}{_shown(after[0])} in {after[1]}",
        "correct the argument, or read facts of the same sort for both literals",
    )


def _shown(kinds: frozenset[str]) -> str:
    names = [f"'{kind}'" for kind in sorted(kinds)]
    more = [f"{len(names) - _MOST_SHOWN} more"] if len(names) > _MOST_SHOWN else []
    *first, last = [*names[:_MOST_SHOWN], *more]
    return f"{', '.join(first)} or {last}" if first else last
