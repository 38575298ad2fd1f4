"""A knowledge base as tables for people."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from rich.console import Group
from rich.markup import escape
from rich.table import Table

from sfol.knowledge_base.model import KnowledgeBase


def summary_table(kb: KnowledgeBase) -> Group:
    """Return a knowledge base as tables: rules, weights, terms, signals, and what it is."""
    semantics = kb.semantics
    pooling = "pooled" if semantics.pools else "best"
    return Group(
        f"[bold]{escape(kb.name)}[/] {escape(kb.description.strip())}",
        f"[dim]subject {kb.subject} · {len(kb.declared)} predicates · {len(kb.tests)} tests · "
        f"hash {kb.hash[:12]}[/]",
        f"[dim]conjunction {semantics.conjunction} · groundings {pooling} · disjunction "
        f"{semantics.disjunction} · confidence {semantics.confidence}[/]",
        _table(
            "Rules",
            ("rule", "clause", "description"),
            ((r.name, str(r.clause), r.description) for r in kb.rules.values()),
        ),
        _table(
            "Weights",
            ("weight", "w ="),
            (
                (name, f"1/{weight.normalizer:g} × ({_sum(weight.coefficients)})")
                for name, weight in kb.weights.items()
            ),
        ),
        _table(
            "Reward, the sum of",
            ("term", "weight", "formula", "parameters"),
            (
                (t.name, str(t.weight), t.formula.text, _numbers(t.parameters))
                for t in kb.terms.values()
            ),
        ),
        _table(
            "Signals",
            ("signal", "unit", "description", "default"),
            (
                (name, s.unit, s.description, "" if s.default is None else f"{s.default:g}")
                for name, s in kb.signals.items()
            ),
        ),
    )


def _table(title: str, columns: Iterable[str], rows: Iterable[Iterable[str]]) -> Table:
    table = Table(*columns, title=title, title_justify="left")
    for row in rows:
        table.add_row(*map(escape, row))
    return table


def _sum(coefficients: Mapping[str, float]) -> str:
    return " + ".join(f"{number:g} {head}" for head, number in coefficients.items())


def _numbers(numbers: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {number:g}" for name, number in numbers.items())
