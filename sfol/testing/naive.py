"""The naive reference: what a knowledge base means, sentence by sentence, and very slowly.

Nothing here is shared with the engines, but for the data that goes in and comes out, so that an
error of theirs can't hide here as well.
"""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import reduce

from sfol.clauses import Body
from sfol.connectives import Joined, Tree
from sfol.facts import Bound, Facts
from sfol.knowledge_base import KnowledgeBase, Rule
from sfol.literals import Count, ForAll, Literal, Negated, NotEqual, Positive
from sfol.syntax import Atom, is_variable
from sfol.testing.naive_time import needed_now, said_of
from sfol.testing.naive_values import said_of_values

Known = Mapping[Atom, Bound]
Substitution = Mapping[str, str]


def naive_conclusions(kb: KnowledgeBase, facts: Facts) -> dict[Atom, Bound]:
    """Return what follows from facts, by the letter of the definition and very slowly.

    Args:
        kb: the knowledge base.
        facts: they must fit the knowledge base; nothing is checked.

    Returns:
        Every atom that some rule concludes, with its final bound.
    """
    return _naive_step(kb, facts, [])


def naive_episode(kb: KnowledgeBase, steps: Sequence[Facts]) -> list[dict[Atom, Bound]]:
    """Return what follows from the facts of every step of an episode, by the letter as well.

    Args:
        kb: the knowledge base, perhaps with operators over time.
        steps: the facts of each step; they must fit the knowledge base.
    """
    history: list[Known] = []  # all that was known at every step
    derived = []
    for facts in steps:
        derived.append(_naive_step(kb, facts, history))
        history.append({**_given(kb, facts), **derived[-1]})
    return derived


def _naive_step(kb: KnowledgeBase, facts: Facts, history: Sequence[Known]) -> dict[Atom, Bound]:
    known = _given(kb, facts)
    derived: dict[Atom, Bound] = {}
    # Strata are evaluated in order, each to the end. A stratum is a head, or heads that depend on
    # each other.
    waiting = list(kb.heads)
    while waiting:
        stratum = next(
            heads
            for name in waiting
            if not _read_by(kb, heads := _together(kb, name)) & set(waiting) - heads
        )
        waiting = [name for name in waiting if name not in stratum]
        # What operators over time say is known to a stratum like facts.
        rules = [rule for head in stratum for rule in _rules_of(kb, head)]
        said = said_of(kb, rules, [*history, known])
        # From nothing, all heads of a stratum are concluded from what the round before concluded,
        # until a round changes nothing.
        conclusions: dict[Atom, Bound] = {}
        last: dict[Atom, Bound] | None = None
        while conclusions != last:
            last = conclusions
            # Entities are the constants that occur in facts, plus the subject. To a later stratum,
            # and to the next round, conclusions are facts as well.
            read = {**known, **said, **last}
            entities = sorted({kb.subject}.union(*(atom.arguments for atom in read)))
            conclusions = {
                atom: bound
                for head in stratum
                for atom, bound in _naive_stratum(kb, head, read, known, entities).items()
            }
        derived.update(conclusions)
        known.update(conclusions)
    return derived


def _together(kb: KnowledgeBase, head: str) -> set[str]:
    """Return a head with all heads that it depends on and that depend on it."""
    return {head} | {name for name in _depends_on(kb, head) if head in _depends_on(kb, name)}


def _depends_on(kb: KnowledgeBase, head: str) -> set[str]:
    found: set[str] = set()
    while more := (_read_by(kb, found) | _reads(kb, head)) - found:
        found |= more
    return found


def _read_by(kb: KnowledgeBase, heads: set[str]) -> set[str]:
    return set().union(*(_reads(kb, head) for head in heads))


def _given(kb: KnowledgeBase, facts: Facts) -> dict[Atom, Bound]:
    # Facts map ground atoms to bounds; the background always holds, with [1, 1].
    background = {atom: Bound(1.0, 1.0) for atom in kb.background}
    return {**background, **dict(facts.items()), **said_of_values(kb, facts)}


def _rules_of(kb: KnowledgeBase, head: str) -> list[Rule]:
    return [rule for rule in kb.rules.values() if rule.clause.head.predicate == head]


def _literals(rule: Rule) -> Sequence[Literal]:
    # A body with connectives stands for several rules, one for each way in which it can hold.
    if rule.part_of is None:
        return rule.clause.body.literals
    number = int(rule.name.rpartition(".")[2])
    return Body(tuple(_ways(rule.part_of.body)[number - 1])).literals


def _ways(body: Tree) -> list[list[Literal]]:
    if isinstance(body, Literal):
        return [[body]]
    first, *others = body.parts
    rest = others[0] if len(others) == 1 else Joined(body.connective, tuple(others))
    match body.connective:
        case ",":  # every way of the first part with every way of the rest
            return [left + right for left in _ways(first) for right in _ways(rest)]
        case "or":  # the ways of the first part, and those of the rest
            return _ways(first) + _ways(rest)
        case "implies":  # the condition fails, or the consequence holds
            return _failing(first) + _ways(rest)
    raise NotImplementedError(f"what '{body.connective}' means is not defined")


def _failing(body: Tree) -> list[list[Literal]]:
    match body:
        case Positive(atom, 0.0):
            return [[Negated(atom)]]
        case Negated(atom):
            return [[Positive(atom)]]
        case Joined("implies", (condition, consequence)):
            return [a + b for a in _ways(condition) for b in _failing(consequence)]
        case Joined("or", (first, *others)):
            rest = others[0] if len(others) == 1 else Joined("or", tuple(others))
            return [a + b for a in _failing(first) for b in _failing(rest)]
        case Joined(",", parts):
            return [way for part in parts for way in _failing(part)]
    raise NotImplementedError(f"where '{body}' fails is not defined")


def _reads(kb: KnowledgeBase, head: str) -> set[str]:
    literals = [literal for rule in _rules_of(kb, head) for literal in _literals(rule)]
    literals += [inner for literal in literals for inner in _inside(literal)]
    atoms = [atom for literal in literals if (atom := _atom(literal)) is not None]
    return {name for atom in atoms for name in needed_now(atom)}


def _naive_stratum(
    kb: KnowledgeBase, head: str, read: Known, known: Known, entities: Sequence[str]
) -> dict[Atom, Bound]:
    disjuncts: dict[Atom, list[Bound]] = {}
    for rule in _rules_of(kb, head):
        for atom, bound in _naive_rule(kb, rule, read, entities).items():
            # An atom that is both asserted and derived: the asserted bound is one more disjunct.
            asserted = [known[atom]] if atom in known else []
            disjuncts.setdefault(atom, asserted).append(bound)
    return {atom: _disjunction(kb, bounds) for atom, bounds in disjuncts.items()}


def _naive_rule(
    kb: KnowledgeBase, rule: Rule, known: Known, entities: Sequence[str]
) -> dict[Atom, Bound]:
    # S(h): the satisfying substitutions whose head is h; no substitution, no conclusion.
    satisfying: dict[Atom, list[Substitution]] = {}
    for substitution in _substitutions(rule, entities):
        if _satisfies(kb, rule, substitution, known):
            head = _grounded(rule.clause.head, substitution)
            satisfying.setdefault(head, []).append(substitution)
    groundings = rule.groundings or kb.semantics.groundings
    if groundings is None:
        groundings = "pooled" if kb.semantics.conjunction == "average" else "best"
    bounds = {
        head: _naive_pooled(kb, rule, found, known)
        if groundings == "pooled"
        else _combined(_GATHERINGS[groundings], _naive_single(kb, rule, found, known))
        for head, found in satisfying.items()
    }
    # The certainty of a rule multiplies what its body comes to.
    lower, upper = rule.certainty
    return {head: Bound(lower * b.lower, upper * b.upper) for head, b in bounds.items()}


def _substitutions(rule: Rule, entities: Sequence[str]) -> Iterator[Substitution]:
    names = sorted({*_variables_of(_literals(rule)), *_variables(*rule.clause.head.arguments)})
    for values in itertools.product(entities, repeat=len(names)):
        yield dict(zip(names, values, strict=True))


def _inside(literal: Literal) -> Sequence[Literal]:
    match literal:
        case Count(counted=counted):
            return counted
        case ForAll(guard=guard, body=body):
            return (*guard, *body)
    return ()


def _constants(known: Known) -> Sequence[str]:
    return sorted({argument for atom in known for argument in atom.arguments})


def _variables(*terms: str) -> set[str]:
    return {term for term in terms if is_variable(term)}


def _variables_of(literals: Sequence[Literal]) -> set[str]:
    # Those inside of counts and foralls are their own, unless other literals have them as well.
    atoms = [_atom(literal) for literal in literals]
    return {v for atom in atoms if atom is not None for v in _variables(*atom.arguments)}


def _satisfies(kb: KnowledgeBase, rule: Rule, substitution: Substitution, known: Known) -> bool:
    # s satisfies the body iff every literal and guard holds.
    return _all_hold(kb, rule, _literals(rule), substitution, known)


def _all_hold(
    kb: KnowledgeBase,
    rule: Rule,
    literals: Sequence[Literal],
    substitution: Substitution,
    known: Known,
) -> bool:
    return all(_holds(kb, rule, literal, substitution, known) for literal in literals)


def _reaches(number: float, threshold: float) -> bool:
    # What misses a threshold by less than a thousand-millionth of it reaches it.
    return number >= threshold or threshold - number <= threshold * 1e-9


def _holds(
    kb: KnowledgeBase, rule: Rule, literal: Literal, substitution: Substitution, known: Known
) -> bool:
    bound = _literal_bound(kb, rule, literal, substitution, known)
    match literal:
        case ForAll():
            # A forall holds iff nobody speaks against it so much that its negation fails.
            return bound is not None and _reaches(bound.lower, rule.negation_threshold)
        case Count():
            # A count holds iff there are enough, and then as a positive literal does.
            return bound is not None and bound.upper > 0 and _reaches(bound.lower, rule.threshold)
        case Positive():
            # A positive literal holds iff the atom is known, its upper bound is above 0 and its
            # lower bound reaches the rule's threshold, and the one that it asks for itself.
            if bound is None or bound.upper <= 0:
                return False
            asked = (rule.threshold, literal.minimum)
            return all(_reaches(bound.lower, threshold) for threshold in asked)
        case Negated():
            # A negated literal holds iff its lower bound reaches the negation threshold.
            return bound is not None and _reaches(bound.lower, rule.negation_threshold)
        case NotEqual(left, right):
            return substitution.get(left, left) != substitution.get(right, right)
    # A new kind of literal has no meaning here before it is written down, apart from the engines.
    raise NotImplementedError(f"what '{literal}' means is not defined")


def _literal_bound(
    kb: KnowledgeBase, rule: Rule, literal: Literal, substitution: Substitution, known: Known
) -> Bound | None:
    if isinstance(literal, Count):
        return _count_bound(kb, rule, literal, substitution, known)
    if isinstance(literal, ForAll):
        return _forall_bound(kb, rule, literal, substitution, known)
    atom = _atom(literal)
    if atom is None:  # a guard has no bound
        return None
    ground = _grounded(atom, substitution)
    if not isinstance(literal, Negated):
        return known.get(ground)
    bound = _strongest(ground, known)
    # A negated literal has the bound [1, 1] if the atom is unknown, else [1 − u, 1 − l].
    return Bound(1.0, 1.0) if bound is None else Bound(1 - bound.upper, 1 - bound.lower)


def _count_bound(
    kb: KnowledgeBase, rule: Rule, count: Count, substitution: Substitution, known: Known
) -> Bound | None:
    # For each value of the counted variables the best bound to which the literals inside come, by
    # the conjunction, over the values of the others; of these the k-th greatest of the lowers and
    # the k-th greatest of the uppers. Fewer than k, and there is no bound.
    inside = {*_variables_of(count.counted), *count.quantified}
    names = sorted(inside - _variables_of(_literals(rule)))
    found: dict[tuple[str, ...], list[Bound]] = {}
    for values in itertools.product(_constants(known), repeat=len(names)):
        local = {**substitution, **dict(zip(names, values, strict=True))}
        if _all_hold(kb, rule, count.counted, local, known):
            bounds = [_literal_bound(kb, rule, lit, local, known) for lit in count.counted]
            bound = _conjunction(kb, [bound for bound in bounds if bound is not None])
            found.setdefault(tuple(local[name] for name in count.quantified), []).append(bound)
    best = [_combined(max, bounds) for bounds in found.values()]
    if len(best) < count.minimum:
        return None
    return _combined(lambda values: sorted(values, reverse=True)[count.minimum - 1], best)


def _forall_bound(
    kb: KnowledgeBase, rule: Rule, forall: ForAll, substitution: Substitution, known: Known
) -> Bound:
    # For each value of its variables for which the guard holds the greater of two: the guard's
    # negation, and what the body comes to, [0, 0] if it does not hold. Of these the least.
    found = [Bound(1.0, 1.0)]
    outside = _variables_of(_literals(rule))
    given = {name: value for name, value in substitution.items() if name in outside}
    for values in itertools.product(_constants(known), repeat=len(forall.quantified)):
        one = {**given, **dict(zip(forall.quantified, values, strict=True))}
        guard = _least_of(kb, rule, forall.guard, one, known)
        if guard is not None:
            body = _least_of(kb, rule, forall.body, one, known) or Bound(0.0, 0.0)
            spared = Bound(1.0 - guard.upper, 1.0 - guard.lower)
            found.append(_combined(max, [spared, body]))
    return _combined(min, found)


def _least_of(
    kb: KnowledgeBase, rule: Rule, literals: Sequence[Literal], given: Substitution, known: Known
) -> Bound | None:
    # The least of literals, at best over the values of the variables that have none.
    names = sorted(_variables_of(literals) - given.keys())
    found = []
    for values in itertools.product(_constants(known), repeat=len(names)):
        local = {**given, **dict(zip(names, values, strict=True))}
        if _all_hold(kb, rule, literals, local, known):
            bounds = [_literal_bound(kb, rule, literal, local, known) for literal in literals]
            least = [bound for bound in bounds if bound is not None]
            found.append(_combined(min, least) if least else Bound(1.0, 1.0))
    return _combined(max, found) if found else None


def _strongest(pattern: Atom, known: Known) -> Bound | None:
    # not P(X, _) denies every P(X, e) at once: l and u are the greatest of all that are known.
    bounds = [
        bound
        for atom, bound in known.items()
        if atom.predicate == pattern.predicate
        and all(p in ("_", a) for p, a in zip(pattern.arguments, atom.arguments, strict=True))
    ]
    if not bounds:
        return None
    return Bound(max(bound.lower for bound in bounds), max(bound.upper for bound in bounds))


def _atom(literal: Literal) -> Atom | None:
    return literal.atom if isinstance(literal, Positive | Negated) else None


def _naive_pooled(
    kb: KnowledgeBase, rule: Rule, found: Sequence[Substitution], known: Known
) -> Bound:
    # For each body literal the distinct ground atoms over S(h), then the average over all of them.
    pool = []
    for literal in _literals(rule):
        # A literal has an atom for each of the values of its variables.
        inside = _inside(literal) or (literal,)
        names = sorted(_variables_of(inside) & _variables_of(_literals(rule)))
        values = {tuple(s[name] for name in names): s for s in found}
        distinct = {
            key: _literal_bound(kb, rule, literal, substitution, known)
            for key, substitution in values.items()
        }
        pool += [bound for bound in distinct.values() if bound is not None]
    return _conjunction(kb, pool)


def _naive_single(
    kb: KnowledgeBase, rule: Rule, found: Sequence[Substitution], known: Known
) -> list[Bound]:
    # Combine per substitution; best, sum and probabilistic_sum make one bound of all of these.
    single = []
    for substitution in found:
        bounds = [_literal_bound(kb, rule, lit, substitution, known) for lit in _literals(rule)]
        single.append(_conjunction(kb, [bound for bound in bounds if bound is not None]))
    return single


def _conjunction(kb: KnowledgeBase, bounds: Sequence[Bound]) -> Bound:
    return _combined(_CONJUNCTIONS[kb.semantics.conjunction], bounds)


def _disjunction(kb: KnowledgeBase, bounds: Sequence[Bound]) -> Bound:
    return _combined(_DISJUNCTIONS[kb.semantics.disjunction], bounds)


def _combined(combine: Callable[[Sequence[float]], float], bounds: Sequence[Bound]) -> Bound:
    # Lower bounds with lower, upper with upper.
    return Bound(combine([b.lower for b in bounds]), combine([b.upper for b in bounds]))


def _probabilistic_sum(values: Sequence[float]) -> float:
    # 1 - Π (1 - x), in the one form that rounds neither 0 nor 1 away from where thresholds are.
    return reduce(lambda a, b: a + b * (1.0 - a), values)


_CONJUNCTIONS: Mapping[str, Callable[[Sequence[float]], float]] = {
    "average": statistics.fmean,
    "minimum": min,
    "product": math.prod,
    "lukasiewicz": lambda values: max(0.0, math.fsum(values) - (len(values) - 1)),
}
_GATHERINGS: Mapping[str, Callable[[Sequence[float]], float]] = {
    "best": max,
    "sum": lambda values: min(1.0, math.fsum(values)),
    "probabilistic_sum": _probabilistic_sum,
}
_DISJUNCTIONS: Mapping[str, Callable[[Sequence[float]], float]] = {
    "maximum": max,
    "probabilistic_sum": _probabilistic_sum,
}


def _grounded(atom: Atom, substitution: Substitution) -> Atom:
    return Atom(atom.predicate, tuple(substitution.get(term, term) for term in atom.arguments))
