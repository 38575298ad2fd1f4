"""What every engine can do, and the engines by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from sfol.engines.compiled import CompiledEngine
from sfol.engines.conclusions import Conclusions
from sfol.engines.plan import Plan
from sfol.engines.program import Program
from sfol.engines.tables import Tables
from sfol.errors import UsageError, did_you_mean, expect
from sfol.facts import Bound, Facts
from sfol.knowledge_base import KnowledgeBase, Rule
from sfol.literals.search import Constants


class Engine(Protocol):
    """What every engine can do."""

    program: Program

    def conclude(self, facts: Facts) -> Conclusions:
        """Return everything that follows from facts."""
        ...

    def rule_bounds(self, rule: Rule, plan: Plan, tables: Tables) -> Mapping[Constants, Bound]:
        """Return what one rule alone concludes."""
        ...


def _pyreason_engine(kb: KnowledgeBase) -> Engine:
    from sfol.engines.pyreason import PyReasonEngine  # noqa: PLC0415  (few need it)

    return PyReasonEngine(kb)


ENGINES: Mapping[str, Callable[[KnowledgeBase], Engine]] = {
    "compiled": CompiledEngine,
    "pyreason": _pyreason_engine,
}


def make_engine(name: str, kb: KnowledgeBase) -> Engine:
    """Return an engine by its name.

    Raises:
        UsageError: there is none of this name.
    """
    expect(name, str, "the engine", f"give a name: {', '.join(ENGINES)}")
    if name not in ENGINES:
        raise UsageError(
            f"there is no engine '{name}'", name=name, suggestion=did_you_mean(name, ENGINES)
        )
    return ENGINES[name](kb)
