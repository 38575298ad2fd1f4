"""The laws of the logic, each a function that any test can call.

A law takes a reward function, facts that fit its knowledge base, and a source of randomness for
whatever it varies. It raises `AssertionError` where it is broken; where it says nothing about a
knowledge base, it does nothing.

Example:
    >>> import random, sfol
    >>> from sfol.testing.laws import LAWS
    >>> reward = sfol.RewardFunction("aeb")
    >>> facts = sfol.Facts.parse("Pedestrian(p1): 0.8. OnRoad(p1). CenterOf(p1, ego).")
    >>> for law in LAWS:
    ...     law(reward, facts, random.Random(0))
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from random import Random
from typing import cast

from sfol.clauses import Body, Clause, parse_clause, parse_rule
from sfol.engines.engine import Engine
from sfol.facts import Bound, Facts
from sfol.knowledge_base import KnowledgeBase, Rule
from sfol.knowledge_base.recursion import components
from sfol.literals import Count, ForAll, Literal, Positive
from sfol.operators import BEST, POOLED
from sfol.outcome import Outcome
from sfol.reward import RewardFunction
from sfol.syntax import Atom, is_variable

TOLERANCE = 1e-9
_TINY = 1e-200  # what is less may come to 0 where it is halved
_NO_NAMES: Mapping[str, str] = {}

Law = Callable[[RewardFunction, Facts, Random], None]
Derived = Mapping[Atom, Bound]


def bounds_are_bounds(reward: RewardFunction, facts: Facts, random: Random) -> None:
    """Every concluded bound is in [0, 1] and ordered."""
    for atom, bound in _derived(reward, facts).items():
        assert 0.0 <= bound.lower <= bound.upper <= 1.0, f"{atom} has {bound}"


def order_changes_nothing(reward: RewardFunction, facts: Facts, random: Random) -> None:
    """Facts are a set: in another order they lead to the same conclusions."""
    items = list(facts.items())
    shuffled = random.sample(items, k=len(items))
    assert_same(_derived(reward, facts), _derived(reward, _facts(facts, shuffled)))


def names_change_nothing(reward: RewardFunction, facts: Facts, random: Random) -> None:
    """An entity's name means nothing, unless the knowledge base names it."""
    free = [name for name in facts.entities() if name not in _named(reward.kb)]
    numbers = random.sample(range(len(free)), k=len(free))
    new = {name: f"renamed{number}" for name, number in zip(free, numbers, strict=True)}
    renamed = _facts(facts, ((atom.substituted(new), bound) for atom, bound in facts.items()), new)
    expected = {atom.substituted(new): b for atom, b in _derived(reward, facts).items()}
    assert_same(expected, _derived(reward, renamed))


def irrelevant_facts_change_nothing(reward: RewardFunction, facts: Facts, random: Random) -> None:
    """Facts that no rule reads change no conclusion."""
    unread = [name for name in reward.kb.predicates if name not in _read(reward.kb)]
    more = facts.copy()
    for name in unread:
        atom = _some_atom(reward.kb, name, (*facts.entities(), "stranger"), random)
        if atom not in reward.kb.background:
            more.add(name, *atom.arguments, bound=_some_bound(random), merge="replace")
    assert_same(_derived(reward, facts), _derived(reward, more))


def best_is_monotone(reward: RewardFunction, facts: Facts, random: Random) -> None:
    """Where nothing is pooled or negated, one more fact lowers no bound."""
    kb = reward.kb
    if not _is_monotone(kb) or not kb.predicates:
        return
    entities = (*facts.entities(), kb.subject, "stranger")
    atom = _some_atom(kb, random.choice(list(kb.predicates)), entities, random)
    if atom in facts or atom in kb.background:
        return
    more = facts.copy()
    more.add(atom.predicate, *atom.arguments, bound=_some_bound(random))
    _assert_no_less(reward, facts, more)


def greater_bounds_lower_nothing(reward: RewardFunction, facts: Facts, random: Random) -> None:
    """Where nothing is pooled or negated, a greater bound of a fact lowers no conclusion."""
    items = list(facts.items())
    if not _is_monotone(reward.kb) or not items:
        return
    atom, bound = random.choice(items)
    upper = bound.upper + random.random() * (1.0 - bound.upper)
    lower = bound.lower + random.random() * (upper - bound.lower)
    more = facts.copy()
    more.add(atom.predicate, *atom.arguments, bound=(lower, upper), merge="replace")
    _assert_no_less(reward, facts, more)


def what_was_concluded_changes_nothing(
    reward: RewardFunction, facts: Facts, random: Random
) -> None:
    """With `disjunction: maximum`, conclusions that are asserted as well lead to themselves."""
    if reward.kb.semantics.disjunction != "maximum":
        return
    derived = _derived(reward, facts)
    more = facts.copy()
    for atom, bound in derived.items():
        if atom not in reward.kb.background:
            more.add(atom.predicate, *atom.arguments, bound=bound, merge="replace")
    assert_same(derived, _derived(reward, more))


def half_the_bounds_conclude_half(reward: RewardFunction, facts: Facts, random: Random) -> None:
    """Where nothing but minima, averages, maxima and certainties is taken, the scale is free.

    That is so where nothing is negated, no bound is asked for and nothing holds beforehand, nor by
    a value.
    """
    kb = reward.kb
    facts = facts.restricted(kb.predicates, attributes=())
    free = (
        kb.semantics.conjunction in ("minimum", "average")
        and kb.semantics.disjunction == "maximum"
        and not kb.background
        and all(kb.gathers(rule) in (POOLED, BEST.name) for rule in kb.rules.values())
        and not any(_asks(rule) for rule in kb.rules.values())
        and all(bound.upper == 0.0 or bound.upper > _TINY for _, bound in facts.items())
    )
    if free:
        halved = _facts(facts, [(atom, _half(bound)) for atom, bound in facts.items()])
        expected = {atom: _half(bound) for atom, bound in _derived(reward, facts).items()}
        assert_same(expected, _derived(reward, halved))


def of_several_rules_the_greatest_counts(
    reward: RewardFunction, facts: Facts, random: Random
) -> None:
    """With `disjunction: maximum`, rules that share a head conclude what the best of them does.

    Of a head that does not depend on itself.
    """
    kb, heads = reward.kb, _heads_once_concluded(reward.kb)
    if kb.semantics.disjunction != "maximum" or not heads:
        return
    head = random.choice(heads)
    sharing = [name for name, rule in kb.rules.items() if rule.clause.head.predicate == head]
    greatest: dict[Atom, Bound] = {}
    for name in sharing:
        rules = {n: rule for n, rule in kb.rules.items() if n == name or n not in sharing}
        alone = _like(reward.engine, dataclasses.replace(kb, rules=rules))
        for atom, bound in _of(alone.conclude(facts).derived, head).items():
            other = greatest.get(atom, bound)
            greatest[atom] = Bound(max(bound.lower, other.lower), max(bound.upper, other.upper))
    assert_same(greatest, _of(_derived(reward, facts), head))


def certainty_multiplies(reward: RewardFunction, facts: Facts, random: Random) -> None:
    """With `disjunction: maximum`, rules half as certain conclude half of what they did.

    Of a head that does not depend on itself.
    """
    kb, heads = reward.kb, _heads_once_concluded(reward.kb)
    if kb.semantics.disjunction != "maximum" or not heads:
        return
    head = random.choice(heads)
    halved = {
        name: rule
        if rule.clause.head.predicate != head
        else dataclasses.replace(rule, certainty=_half(rule.certainty))
        for name, rule in kb.rules.items()
    }
    after = _like(reward.engine, dataclasses.replace(kb, rules=halved)).conclude(facts).derived
    asserted = {*facts, *kb.background}
    before = _of(_derived(reward, facts), head)
    expected = {atom: _half(bound) for atom, bound in before.items() if atom not in asserted}
    found = {atom: b for atom, b in _of(after, head).items() if atom not in asserted}
    assert_same(expected, found)


def the_more_the_surer(reward: RewardFunction, facts: Facts, random: Random) -> None:
    """The best of several substitutions says no more than their probabilistic sum, it than the sum.

    Of a head that nothing reads, with `disjunction: maximum`: more may lower what reads it.
    """
    kb = reward.kb
    unread = [head for head in kb.heads if head not in kb.read]
    if kb.semantics.disjunction != "maximum" or not unread:
        return
    head = random.choice(unread)
    found = []
    for groundings in ("best", "probabilistic_sum", "sum"):
        rules = {
            name: rule
            if rule.clause.head.predicate != head
            else dataclasses.replace(rule, groundings=groundings)
            for name, rule in kb.rules.items()
        }
        engine = _like(reward.engine, dataclasses.replace(kb, rules=rules))
        found.append(_of(engine.conclude(facts).derived, head))
    for fewer, more in pairwise(found):
        assert fewer.keys() == more.keys()
        for atom, bound in fewer.items():
            assert bound.lower <= more[atom].lower + TOLERANCE, atom
            assert bound.upper <= more[atom].upper + TOLERANCE, atom


def fewer_are_found_more_easily(reward: RewardFunction, facts: Facts, random: Random) -> None:
    """Counts that ask for one less, and foralls that speak of fewer, lower no bound.

    Where nothing is pooled, that is.

    Of a head that nothing reads: more may lower what reads it.
    """
    kb = reward.kb
    fewer = {name: _asking_for_less(kb, rule) for name, rule in kb.rules.items()}
    after = _like(reward.engine, dataclasses.replace(kb, rules=fewer)).conclude(facts).derived
    for atom, bound in _derived(reward, facts).items():
        pools = any(
            kb.gathers(rule) == POOLED
            for rule in kb.rules.values()
            if rule.clause.head.predicate == atom.predicate
        )
        if not pools and atom.predicate not in kb.read:
            assert after[atom].lower >= bound.lower - TOLERANCE, atom
            assert after[atom].upper >= bound.upper - TOLERANCE, atom


def nearer_to_holding_is_no_less_true(reward: RewardFunction, facts: Facts, random: Random) -> None:
    """Where nothing is pooled or negated, a value moved towards all its limits lowers no bound.

    Of attributes whose comparisons all ask for less, or all for more.
    """
    kb = reward.kb
    known = [atom for atom in facts if facts.value(atom.predicate, *atom.arguments) is not None]
    if not _is_monotone(kb) or not known:
        return
    atom = random.choice(known)
    names = {c.operator.name for c in kb.comparisons if c.attribute == atom.predicate}
    step = random.random() * 3
    if names <= {"<", "<=", "below"}:
        step = -step
    elif not names <= {">", ">=", "above"}:
        return
    moved = facts.copy()
    value = facts.value(atom.predicate, *atom.arguments)
    assert value is not None
    moved.add(atom.predicate, *atom.arguments, value=value + step, merge="replace")
    _assert_no_less(reward, facts, moved)


def heads_that_did_not_fire_are_zero(reward: RewardFunction, facts: Facts, random: Random) -> None:
    """The confidence of a head of which nothing is known is 0."""
    outcome = _evaluated(reward, facts)
    for head, bound in outcome.bounds.items():
        assert bound is not None or outcome.confidences[head] == 0.0, head


def printed_rules_are_the_rules(reward: RewardFunction, facts: Facts, random: Random) -> None:
    """To print and to parse are each other's inverse, for rules and for facts."""
    for rule in reward.kb.rules.values():
        values = reward.kb.attributes
        assert parse_clause(str(rule.clause), values) == rule.clause, rule
        assert rule.part_of is None or parse_rule(str(rule.part_of), values) == rule.part_of, rule
    assert Facts.parse(str(facts), margin=facts.margin) == facts


def the_reward_is_the_sum_of_its_terms(
    reward: RewardFunction, facts: Facts, random: Random
) -> None:
    """R = Σ terms, to the last digit."""
    outcome = _evaluated(reward, facts)
    assert outcome.reward == sum(outcome.terms.values())


def terms_are_weights_times_formulas(reward: RewardFunction, facts: Facts, random: Random) -> None:
    """A term is its weight times its formula, which may read the subject's confidences."""
    outcome, signals = _evaluated(reward, facts), _signals(reward)
    given = {name: signals.get(name, signal.default) for name, signal in reward.kb.signals.items()}
    for name, term in reward.kb.terms.items():
        values = {**term.parameters, **{n: v for n, v in given.items() if v is not None}}
        values |= {head: outcome.confidences.get(head, 0.0) for head in term.heads}
        weight = term.weight if not isinstance(term.weight, str) else outcome.weights[term.weight]
        assert _near(weight * term.formula(values), outcome.terms[name]), name


def a_batch_is_its_scenes(reward: RewardFunction, facts: Facts, random: Random) -> None:
    """A batch gives what its scenes give one by one."""
    some = [pair for pair in facts.items() if random.random() < 0.5]
    scenes = [facts, Facts(), _facts(facts, some)]
    outcomes = reward.evaluate(reward.batch(scenes), **_signals(reward))
    for i, scene in enumerate(scenes):
        outcome = _evaluated(reward, scene)
        assert _near(float(outcomes.reward[i]), outcome.reward)
        for head, bound in outcome.bounds.items():
            found = outcomes.bounds[head]
            assert bool(found.known[i]) == (bound is not None), head
            assert bound is None or _near(float(found.lower[i]), bound.lower), head
            assert bound is None or _near(float(found.upper[i]), bound.upper), head


LAWS: Sequence[Law] = (
    bounds_are_bounds,
    order_changes_nothing,
    names_change_nothing,
    irrelevant_facts_change_nothing,
    best_is_monotone,
    greater_bounds_lower_nothing,
    what_was_concluded_changes_nothing,
    half_the_bounds_conclude_half,
    of_several_rules_the_greatest_counts,
    certainty_multiplies,
    the_more_the_surer,
    fewer_are_found_more_easily,
    nearer_to_holding_is_no_less_true,
    heads_that_did_not_fire_are_zero,
    printed_rules_are_the_rules,
    the_reward_is_the_sum_of_its_terms,
    terms_are_weights_times_formulas,
    a_batch_is_its_scenes,
)


def assert_same(expected: Derived, found: Derived) -> None:
    """Assert that two engines, or two runs of one, concluded the same atoms and bounds.

    Raises:
        AssertionError: with the first atom that differs.
    """
    for atom in {**expected, **found}:
        assert atom in found, f"{atom} {expected[atom]} was not concluded"
        assert atom in expected, f"{atom} {found[atom]} was concluded"
        one, other = expected[atom], found[atom]
        same = _near(one.lower, other.lower) and _near(one.upper, other.upper)
        assert same, f"{atom} has {tuple(other)}, not {tuple(one)}"


def _assert_no_less(reward: RewardFunction, fewer: Facts, more: Facts) -> None:
    after = _derived(reward, more)
    for atom, bound in _derived(reward, fewer).items():
        assert after[atom].lower >= bound.lower - TOLERANCE, f"{atom} was lowered"
        assert after[atom].upper >= bound.upper - TOLERANCE, f"{atom} was lowered"


def _is_monotone(kb: KnowledgeBase) -> bool:
    """Tell whether nothing is negated and nothing pooled."""
    rules = kb.rules.values()
    return all(lit.monotone for rule in rules for lit in rule.clause.body.all_literals) and not any(
        kb.gathers(rule) == POOLED for rule in rules
    )


def _asks(rule: Rule) -> bool:
    """Tell whether a rule asks for a bound, or denies anything."""
    literals = rule.clause.body.all_literals
    return rule.threshold > 0.0 or any(
        not lit.monotone or (isinstance(lit, Positive) and lit.minimum > 0.0) for lit in literals
    )


def _heads_once_concluded(kb: KnowledgeBase) -> list[str]:
    """Return the heads that do not depend on themselves."""
    once = [c.predicates[0] for c in components(kb.rules.values()) if not c.recursive]
    return [head for head in kb.heads if head in once]


def _near(one: float, other: float) -> bool:
    return math.isclose(one, other, rel_tol=TOLERANCE, abs_tol=TOLERANCE)


def _derived(reward: RewardFunction, facts: Facts) -> Derived:
    return reward.conclude(facts).derived


def _signals(reward: RewardFunction) -> dict[str, float]:
    """Return a number for every signal that has none."""
    return {name: 2.0 for name, signal in reward.kb.signals.items() if signal.default is None}


def _evaluated(reward: RewardFunction, facts: Facts) -> Outcome:
    return reward.evaluate(facts, **_signals(reward))


def _like(engine: Engine, kb: KnowledgeBase) -> Engine:
    """Return an engine of the same kind for another knowledge base."""
    return cast(Callable[[KnowledgeBase], Engine], type(engine))(kb)


def _of(derived: Derived, head: str) -> dict[Atom, Bound]:
    return {atom: bound for atom, bound in derived.items() if atom.predicate == head}


def _facts(
    like: Facts, items: Iterable[tuple[Atom, Bound]], names: Mapping[str, str] = _NO_NAMES
) -> Facts:
    """Return facts with the values of others, of entities with other names."""
    facts = Facts(margin=like.margin)
    for atom, bound in items:
        facts.add(atom.predicate, *atom.arguments, bound=bound)
    for attribute, known in like.values().items():
        for constants, value in known.items():
            facts.add(attribute, *(names.get(name, name) for name in constants), value=value)
    return facts


def _asking_for_less(kb: KnowledgeBase, rule: Rule) -> Rule:
    """Return a rule whose counts ask for one less, and whose foralls speak of fewer.

    Of a head that is read, the rule itself.
    """
    head, body = rule.clause.head, rule.clause.body
    if head.predicate in kb.read:
        return rule
    literals = tuple(map(_easier, body.literals))
    return dataclasses.replace(rule, clause=Clause(head, Body(literals)))


def _easier(literal: Literal) -> Literal:
    match literal:
        case Count(minimum=minimum):
            return dataclasses.replace(literal, minimum=max(minimum - 1, 1))
        case ForAll(guard=guard):
            return dataclasses.replace(literal, guard=tuple(map(_surely, guard)))
    return literal


def _surely(literal: Literal) -> Literal:
    if not isinstance(literal, Positive):
        return literal
    return dataclasses.replace(literal, minimum=max(literal.minimum, 0.5))


def _half(bound: Bound) -> Bound:
    return Bound(bound.lower / 2, bound.upper / 2)


def _named(kb: KnowledgeBase) -> set[str]:
    """Return the entities that the knowledge base itself names."""
    terms = {kb.subject, *(term for atom in kb.background for term in atom.arguments)}
    for rule in kb.rules.values():
        terms.update(rule.clause.head.arguments, rule.clause.body.terms)
    return {term for term in terms if not is_variable(term)}


def _read(kb: KnowledgeBase) -> set[str]:
    """Return the predicates on which conclusions can depend: of bodies, and of heads."""
    return set(kb.heads).union(*(rule.clause.body.predicates for rule in kb.rules.values()))


def _some_atom(kb: KnowledgeBase, name: str, entities: Sequence[str], random: Random) -> Atom:
    return Atom(name, tuple(random.choices(entities, k=kb.predicates[name].arity)))


def _some_bound(random: Random) -> Bound:
    lower, upper = sorted((random.random(), random.random()))
    return Bound(lower, upper)
