"""A knowledge base as one file that can be loaded again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import yaml
from pydantic import BaseModel

from sfol.knowledge_base.format import Case
from sfol.knowledge_base.model import KnowledgeBase
from sfol.knowledge_base.parts import ObservedFact, Predicate, Rule, ScheduledNumber

_HEAD = ("version", "name", "description", "subject", "background")
_WIDTH = 100
_SMALL = 72


def to_yaml(kb: KnowledgeBase) -> str:
    """Return a knowledge base as one file that extends nothing; loading it gives the same hash.

    A weight may name a head whose rules were all removed. One file alone can't say that: such a
    coefficient, which only ever added 0, is left out, and the hash is then another one.

    Args:
        kb: loaded, or built and changed as objects.
    """
    sections = {name: content for name, content in _file(kb).items() if content not in ({}, [], "")}
    first = {key: sections.pop(key) for key in _HEAD if key in sections}
    parts = (first, *({name: _block(content)} for name, content in sections.items()))
    return "\n".join(map(_dump, parts))


def _file(kb: KnowledgeBase) -> dict[str, Any]:
    return {
        "version": kb.version,
        "name": kb.name,
        "description": kb.description,
        "subject": kb.subject,
        "background": [str(atom) for atom in kb.background],
        "predicates": {p.signature: p.description for p in _declared(kb)},
        "attributes": {a.signature: a.description for a in kb.attributes.values()},
        "rules": dict(_rules(kb)),
        "semantics": kb.semantics.model_dump(exclude_none=True),
        "observation": {name: _said(source) for name, source in kb.observation.items()},
        "entities": {name: _said(sort) for name, sort in kb.entities.items()},
        "facts": {fact.text: _fact(fact) for fact in kb.facts},
        "facts_at": "" if kb.facts_at == "state" else kb.facts_at,
        "time": "" if kb.time is None else kb.time.model_dump(),
        "signals": {name: _said(signal) for name, signal in kb.signals.items()},
        "weights": {
            name: {**_said(weight), "coefficients": _with_rules(kb, weight.coefficients)}
            for name, weight in kb.weights.items()
        },
        "terms": {
            term.name: _without_defaults(
                {
                    "weight": term.weight,
                    "formula": term.formula.text,
                    "parameters": dict(term.parameters),
                    "description": term.description,
                },
                {"parameters": {}, "description": ""},
            )
            for term in kb.terms.values()
        },
        "schedules": {
            target: _scheduled(number)
            for target, number in kb.schedules.items()
            if number.section == "terms" or number.name in kb.heads
        },
        "entity_weights": [
            _without_defaults(
                {"when": str(e.when), "weight": e.weight, "at_least": e.at_least}, {"at_least": 0.5}
            )
            for e in kb.entity_weights
        ],
        "grounding": kb.grounding.model_dump(),
        "tests": [_case(kb, case) for case in kb.tests],
    }


def _declared(kb: KnowledgeBase) -> list[Predicate]:
    """Return what a file must declare: also a head whose rules or readers were taken out."""
    implied = (kb.read | kb.weighed).intersection(kb.heads)
    return [p for name, p in kb.predicates.items() if p.declared or name not in implied]


def _rules(kb: KnowledgeBase) -> Iterator[tuple[str, str | dict[str, Any]]]:
    """Yield rules as they are written; parts that were changed as objects stand alone."""
    for name, parts in kb.written_rules.items():
        if _are_all_parts(name, parts):
            yield name, _rule(parts[0], str(parts[0].part_of))
        else:
            yield from ((part.name, _rule(part, str(part.clause))) for part in parts)


def _are_all_parts(name: str, parts: Sequence[Rule]) -> bool:
    """Tell whether rules are all parts of one as it is written, and nothing else."""
    first = parts[0]
    if first.part_of is None:
        return False
    return parts == tuple(
        replace(first, name=f"{name}.{number}", clause=clause)
        for number, clause in enumerate(first.part_of.clauses, start=1)
    )


def _rule(rule: Rule, text: str) -> str | dict[str, Any]:
    entry = _without_defaults(
        {
            "rule": text,
            "description": rule.description,
            "threshold": rule.threshold,
            "negation_threshold": rule.negation_threshold,
            "certainty": rule.certainty_entry,
            "groundings": rule.groundings,
        },
        {
            "description": "",
            "threshold": 0.0,
            "negation_threshold": 0.5,
            "certainty": 1.0,
            "groundings": None,
        },
    )
    return entry if len(entry) > 1 else text


def _fact(fact: ObservedFact) -> str | dict[str, Any]:
    entry = _without_defaults(
        {
            "formula": fact.formula.text,
            "bounds": "exact" if fact.exact else "margin",
            "at_least": fact.at_least,
        },
        {"bounds": "margin", "at_least": 0.0},
    )
    return entry if len(entry) > 1 else fact.formula.text


def _scheduled(number: ScheduledNumber) -> dict[str, Any]:
    entry = {"from": number.start, "to": number.end, "over": number.over, "by": number.by}
    return _without_defaults(entry, {"by": "steps"})


def _case(kb: KnowledgeBase, case: Case) -> dict[str, Any]:
    said = _said(case)
    for expect in (said["expect"], *(step.get("expect", {}) for step in said.get("steps", ()))):
        for part in ("bounds", "confidences"):
            if part in expect:
                expect[part] = {h: v for h, v in expect[part].items() if h in kb.predicates}
    return said


def _with_rules(kb: KnowledgeBase, coefficients: Mapping[str, float]) -> dict[str, float]:
    return {head: number for head, number in coefficients.items() if head in kb.heads}


def _said(model: BaseModel) -> dict[str, Any]:
    return model.model_dump(exclude_defaults=True, by_alias=True)


def _without_defaults(entry: dict[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in entry.items() if defaults.get(key, ...) != value}


class _Block(dict[str, Any]):
    """A mapping with a line for each entry, however small it is."""


class _Dumper(yaml.SafeDumper):
    """Writes small collections in one line, and texts of several lines as blocks."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        super().increase_indent(flow, indentless=False)

    def mapping(self, data: Mapping[str, Any]) -> yaml.MappingNode:
        node = self.represent_mapping("tag:yaml.org,2002:map", data)
        node.flow_style = not isinstance(data, _Block) and _is_small(node)
        return node

    def sequence(self, data: Iterable[Any]) -> yaml.SequenceNode:
        node = self.represent_sequence("tag:yaml.org,2002:seq", data)
        node.flow_style = _is_small(node)
        return node

    def text(self, data: str) -> yaml.ScalarNode:
        style = None if "\n" not in data else "|" if "\n" in data[:-1] else ">"
        return self.represent_scalar("tag:yaml.org,2002:str", data, style=style)


_Dumper.add_representer(dict, _Dumper.mapping)
_Dumper.add_representer(_Block, _Dumper.mapping)
_Dumper.add_representer(list, _Dumper.sequence)
_Dumper.add_representer(tuple, _Dumper.sequence)
_Dumper.add_representer(str, _Dumper.text)


def _is_small(node: yaml.CollectionNode) -> bool:
    """Tell whether a collection reads well in one line."""
    parts = _parts(node)
    long = any(
        getattr(part, "flow_style", None) is False or getattr(part, "style", None) in ("|", ">")
        for part in parts
    )
    return not long and _length(node) <= _SMALL


def _parts(node: yaml.CollectionNode) -> list[Any]:
    """Return the nodes of keys and values; PyYAML has no common type for what they have."""
    if isinstance(node, yaml.MappingNode):
        return [part for entry in node.value for part in entry]
    return list(node.value)


def _length(node: yaml.Node) -> int:
    if isinstance(node, yaml.CollectionNode):
        return sum(_length(part) + 2 for part in _parts(node))
    return len(node.value)


def _block(content: Any) -> Any:
    return _Block(content) if isinstance(content, dict) and len(content) > 1 else content


def _dump(data: Mapping[str, Any]) -> str:
    return yaml.dump(
        _Block(data), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=_WIDTH
    )
