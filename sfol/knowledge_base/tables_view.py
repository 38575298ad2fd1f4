"""A knowledge base as tables for people."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from rich.console import Group
from rich.markup import escape
from rich.table import Table

from sfol.facts import TRUE
from sfol.knowledge_base.model import KnowledgeBase
from sfol.knowledge_base.parts import Rule


def summary_table(kb: KnowledgeBase) -> Group:
    """Return a knowledge base as tables: rules, weights, terms, signals, and what it is."""
    semantics = kb.semantics
    return Group(
        f"[bold]{escape(kb.name)}[/] {escape(kb.description.strip())}",
        f"[dim]subject {kb.subject} · {len(kb.declared)} predicates · {len(kb.tests)} tests · "
        f"hash {kb.hash[:12]}[/]",
        f"[dim]conjunction {semantics.conjunction} · groundings {semantics.gathers} · disjunction "
        f"{semantics.disjunction} · confidence {semantics.confidence}[/]",
        _table(
            "Rules",
            ("rule", "clause", "description"),
            (
                (name, _clause(parts[0]), parts[0].description)
                for name, parts in kb.written_rules.items()
            ),
        ),
        *_attributes(kb),
        _table(
            "Weights",
            ("weight", "w ="),
            (
                (name, f"1/{weight.normalizer:g} × ({_sum(weight.coefficients)})")
                for name, weight in kb.weights.items()
            ),
        ),
        *_smoothed(kb),
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
            ("signal", "unit", "description", "default", "from"),
            (
                (
                    name,
                    s.unit,
                    s.description,
                    "" if s.default is None else f"{s.default:g}",
                    s.observed or "",
                )
                for name, s in kb.signals.items()
            ),
        ),
        *_scheduled(kb),
        *_observed(kb),
    )


def _attributes(kb: KnowledgeBase) -> Iterator[Table]:
    if kb.attributes:
        rows = ((a.signature, a.description) for a in kb.attributes.values())
        yield _table("Attributes", ("attribute", "value"), rows)


def _smoothed(kb: KnowledgeBase) -> Iterator[Table]:
    if kb.smoothed and kb.time is not None:
        yield _table(
            f"Weights that follow, in {kb.time.unit} until 1/e of a change is left",
            ("weight", "rise", "fall"),
            ((name, f"{s.rise:g}", f"{s.fall:g}") for name, s in kb.smoothed.items()),
        )


def _scheduled(kb: KnowledgeBase) -> Iterator[Table]:
    if kb.schedules:
        yield _table(
            "Schedules of a training",
            ("number", "from", "to", "over"),
            (
                (target, f"{s.start:g}", f"{s.end:g}", f"{s.over:,} {s.by}")
                for target, s in kb.schedules.items()
            ),
        )


def _observed(kb: KnowledgeBase) -> Iterator[Table]:
    """Yield what is read off observations, if anything is."""
    if kb.observation:
        yield _table(
            "Observation",
            ("part", "key", "fields", "present"),
            (
                (
                    name,
                    ".".join(map(str, source.path)) or "the whole",
                    ", ".join(source.columns) or "one number",
                    "" if source.present is None else str(source.present),
                )
                for name, source in kb.observation.items()
            ),
        )
    if kb.entities:
        yield _table(
            "Entities",
            ("sort", "from", "at most"),
            ((n, ", ".join(sort.tables), f"{sort.at_most}") for n, sort in kb.entities.items()),
        )
    if kb.facts:
        yield _table(
            "Facts of the state before the action"
            if kb.facts_at == "state"
            else "Facts of the state after the action",
            ("atom", "formula", "bounds", "at least"),
            (
                (f.text, f.formula.text, "exact" if f.exact else "margin", f"{f.at_least:g}")
                for f in kb.facts
            ),
        )


def _table(title: str, columns: Iterable[str], rows: Iterable[Iterable[str]]) -> Table:
    table = Table(*columns, title=title, title_justify="left")
    for row in rows:
        table.add_row(*map(escape, row))
    return table


def _clause(rule: Rule) -> str:
    weakened = "" if rule.certainty == TRUE else f"  certainty {rule.certainty_entry}"
    gathered = "" if rule.groundings is None else f"  groundings {rule.groundings}"
    return f"{rule.part_of or rule.clause}{weakened}{gathered}"


def _sum(coefficients: Mapping[str, float]) -> str:
    return " + ".join(f"{number:g} {head}" for head, number in coefficients.items())


def _numbers(numbers: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {number:g}" for name, number in numbers.items())
