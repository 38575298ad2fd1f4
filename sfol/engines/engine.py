"""What every engine can do, and the engines by name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Protocol

from sfol.engines.compiled import CompiledEngine
from sfol.engines.conclusions import Conclusions
from sfol.engines.plan import Plan
from sfol.engines.program import Program
from sfol.engines.rounds import Round
from sfol.engines.tables import Tables
from sfol.errors import UsageError, did_you_mean, expect
from sfol.facts import Bound, Facts
from sfol.knowledge_base import KnowledgeBase, Rule
from sfol.knowledge_base.recursion import Component
from sfol.literals.search import WORK_LIMIT, Constants


class Engine(Protocol):
    """What every engine can do."""

    program: Program

    def conclude(self, facts: Facts) -> Conclusions:
        """Return everything that follows from facts."""
        ...

    def rule_bounds(self, rule: Rule, plan: Plan, tables: Tables) -> Mapping[Constants, Bound]:
        """Return what one rule alone concludes."""
        ...

    def rounds(self, stratum: Component, tables: Tables) -> Iterator[Round]:
        """Yield the rounds by which heads that depend on each other are concluded."""
        ...


def _pyreason_engine(kb: KnowledgeBase, work_limit: int) -> Engine:
    from sfol.engines.pyreason import PyReasonEngine  # noqa: PLC0415  (few need it)

    return PyReasonEngine(kb, work_limit)


ENGINES: Mapping[str, Callable[[KnowledgeBase, int], Engine]] = {
    "compiled": CompiledEngine,
    "pyreason": _pyreason_engine,
}


def make_engine(name: str, kb: KnowledgeBase, work_limit: int = WORK_LIMIT) -> Engine:
    """Return an engine by its name.

    Args:
        name: one of `ENGINES`.
        kb: the knowledge base that it is for.
        work_limit: how many known atoms the search of a body may look at.

    Raises:
        UsageError: there is none of this name, or the limit is not above 0.
    """
    expect(name, str, "the engine", f"give a name: {', '.join(ENGINES)}")
    if name not in ENGINES:
        raise UsageError(
            f"there is no engine '{name}'", name=name, suggestion=did_you_mean(name, ENGINES)
        )
    expect(work_limit, int, "the work limit", "give a whole number, such as 10_000_000")
    if work_limit < 1:
        raise UsageError(f"the work limit is {work_limit}", suggestion="give a number above 0")
    return ENGINES[name](kb, work_limit)
