"""Guards of difference: ``X != Y``."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

from sfol.arrays import Array
from sfol.facts import TRUE
from sfol.literals.literal import Criterion, Literal, QueryClause, Thresholds
from sfol.literals.search import Rows, Scene, Search, Step
from sfol.syntax import Reader


@dataclass(frozen=True)
class NotEqual(Literal):
    """The condition that two terms are different entities; it has no bound."""

    left: str
    right: str

    @classmethod
    def parse(cls, reader: Reader) -> Self | None:
        if not reader.sees("!=", ahead=1):
            return None
        left = reader.term("a term")
        reader.expect("!=")
        return cls(left, reader.term("a term"))

    def __str__(self) -> str:
        return f"{self.left} != {self.right}"

    @property
    def terms(self) -> tuple[str, ...]:
        return self.left, self.right

    def substituted(self, values: Mapping[str, str]) -> Self:
        return type(self)(*(values.get(term, term) for term in self.terms))

    def matched(self, target: Literal, values: Mapping[str, str]) -> Mapping[str, str] | None:
        # Difference has no direction, and its variables stand in positive literals as well.
        same = isinstance(target, NotEqual) and (
            set(self.substituted(values).terms) == set(target.terms)
        )
        return values if same else None

    def never_holds(self) -> bool:
        return self.left == self.right

    def step(self, number: int, slots: Mapping[str, int], criterion: Criterion, then: Step) -> Step:
        left, right = slots[self.left], slots[self.right]

        def step(search: Search) -> None:
            if search.values[left] != search.values[right]:
                then(search)

        return step

    def holds_among(self, numbers: Callable[[str], Array]) -> Array:
        return numbers(self.left) != numbers(self.right)

    def refutation(self, scene: Scene, thresholds: Thresholds) -> str:
        return str(self)

    def query(self, thresholds: Thresholds) -> QueryClause:
        return QueryClause("are.different", self.terms, 1.0, counts=False, symmetric=True)

    def query_rows(self, scene: Scene, domain: Sequence[str]) -> Rows:
        return dict.fromkeys(itertools.permutations(domain, 2), TRUE)
