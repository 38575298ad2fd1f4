"""Which rules hold only where another one of the same head does (θ-subsumption).

To tell takes time that can grow exponentially with the literals of a rule, so the search has a
budget of steps, and what it did not get to is returned too.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from sfol.knowledge_base import Rule
from sfol.literals import Literal
from sfol.syntax import variables

PAIR_STEPS = 20_000
ALL_STEPS = 1_000_000

Pair = tuple[Rule, Rule]
_Key = tuple[object, ...]
_Values = Mapping[str, str]


@dataclass(frozen=True)
class Comparison:
    """What a bounded search found out.

    Attributes:
        covered: pairs (general, special), where the special rule holds only where the general one
            does; no rule is the special one twice.
        undecided: pairs that took all the steps of a pair.
        rest: rules that were not compared with all after them, as all steps were taken.
    """

    covered: tuple[Pair, ...]
    undecided: tuple[Pair, ...]
    rest: tuple[Rule, ...]


def compared(
    rules: Iterable[Rule], *, pair_steps: int = PAIR_STEPS, all_steps: int = ALL_STEPS
) -> Comparison:
    """Compare the rules of each head with each other.

    Args:
        rules: of two equal ones the later counts as the special one.
        pair_steps: how many literals are looked at for a pair.
        all_steps: how many in all.
    """
    groups: dict[str, list[Rule]] = {}
    for rule in rules:
        groups.setdefault(rule.clause.head.predicate, []).append(rule)
    search = _Search(pair_steps, all_steps)
    for group in groups.values():
        search.compare(group)
    return Comparison(tuple(search.covered.values()), tuple(search.undecided), tuple(search.rest))


class _Spent(Exception):  # noqa: N818  (no error: it ends a search)
    """All steps of a pair were taken."""


class _Budget:
    def __init__(self, steps: int) -> None:
        self.left = steps

    def spend(self) -> None:
        if self.left <= 0:
            raise _Spent
        self.left -= 1


class _Search:
    def __init__(self, pair_steps: int, all_steps: int) -> None:
        self.covered: dict[str, Pair] = {}
        self.undecided: list[Pair] = []
        self.rest: list[Rule] = []
        self._pair_steps = pair_steps
        self._left = all_steps

    def compare(self, group: Sequence[Rule]) -> None:
        partners = _partners(group)
        for number, first in enumerate(group[:-1]):
            if first.name in self.covered:
                continue
            for second in partners(number) if self._left > 0 else ():
                self._left -= 1
                self._try(general=first, special=second)  # of two equal ones the later one
                self._try(general=second, special=first)
                if self._left <= 0:
                    break
            if self._left <= 0:
                self.rest.append(first)

    def _try(self, general: Rule, special: Rule) -> None:
        if self.covered.keys() & {general.name, special.name}:
            return
        budget = _Budget(min(self._pair_steps, self._left))
        before = budget.left
        try:
            if _covers(general, special, budget):
                self.covered[special.name] = general, special
        except _Spent:
            self.undecided.append((general, special))
        self._left -= before - budget.left


def _partners(group: Sequence[Rule]) -> Callable[[int], list[Rule]]:
    """Return which rules after the one of a number may cover it, or be covered by it.

    Every kind of literal of the general rule stands in the special one too: so does its rarest.
    """
    kinds = [{_key(literal) for literal in rule.clause.body.literals} for rule in group]
    counts = Counter(key for keys in kinds for key in keys)
    rarest = [min(keys, key=counts.__getitem__) for keys in kinds]
    holders, rarest_in = defaultdict(set), defaultdict(set)
    for number, keys in enumerate(kinds):
        rarest_in[rarest[number]].add(number)
        for key in keys:
            holders[key].add(number)

    def partners(number: int) -> list[Rule]:
        near = holders[rarest[number]].union(*(rarest_in[key] for key in kinds[number]))
        return [group[other] for other in sorted(near) if other > number]

    return partners


def _key(literal: Literal) -> _Key:
    return type(literal), *(atom.predicate for atom in literal.atoms)


def _covers(general: Rule, special: Rule, budget: _Budget) -> bool:
    """Tell whether a substitution makes the general rule's body part of the special one's."""
    if general.threshold > special.threshold:
        return False
    if general.negation_threshold > special.negation_threshold:
        return False
    # What is more certain says more, however seldom it holds.
    if any(g < s for g, s in zip(general.certainty, special.certainty, strict=True)):
        return False
    if general.groundings != special.groundings:
        return False
    start = general.clause.head.matched(special.clause.head, {})
    targets = defaultdict(list)
    for literal in special.clause.body.literals:
        targets[_key(literal)].append(literal)
    return start is not None and _embeds(general.clause.body.literals, targets, start, budget)


def _embeds(
    literals: Sequence[Literal],
    targets: Mapping[_Key, Sequence[Literal]],
    values: _Values,
    budget: _Budget,
) -> bool:
    """Tell whether the literals become some of the targets; what has fewest ways goes first."""
    while literals:
        literal, ways = _fewest(literals, targets, values, budget)
        literals = [other for other in literals if other is not literal]
        if len(ways) != 1:
            return any(_embeds(literals, targets, way, budget) for way in ways)
        values = ways[0]
    return True


def _fewest(
    literals: Sequence[Literal],
    targets: Mapping[_Key, Sequence[Literal]],
    values: _Values,
    budget: _Budget,
) -> tuple[Literal, Sequence[_Values]]:
    """Return the literal that can become the fewest targets, with what each way binds."""
    best: tuple[Literal, Sequence[_Values]] | None = None
    for literal in literals:
        budget.spend()
        if not literal.atoms and not values.keys() >= {*variables(*literal.terms)}:
            continue  # a guard is tested once its variables have values
        ways = _ways(literal, targets, values, budget)
        if best is None or len(ways) < len(best[1]):
            best = literal, ways
        if len(ways) <= 1:
            break
    assert best is not None, "a guard's variables stand in literals that have atoms"
    return best


def _ways(
    literal: Literal,
    targets: Mapping[_Key, Sequence[Literal]],
    values: _Values,
    budget: _Budget,
) -> list[_Values]:
    found: list[_Values] = []
    for target in targets.get(_key(literal), ()):
        budget.spend()
        extended = literal.matched(target, values)
        if extended is not None and extended not in found:
            found.append(extended)
    return found
