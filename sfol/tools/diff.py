"""What changed between two knowledge bases, and what that does to recorded episodes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from sfol.knowledge_base import KnowledgeBase, Rule, Smoothing, Time
from sfol.logs import Log
from sfol.outcome import Outcome
from sfol.tools.replay import ReplayedEpisode, replay

TOLERANCE = 1e-9
Texts = dict[str, dict[str, str]]


@dataclass(frozen=True)
class Change:
    """Something that two knowledge bases do not share.

    Attributes:
        section: such as ``rules``.
        name: of the rule, the weight, …; empty for a section without names.
        kind: ``added``, ``removed`` or ``changed``.
        before: part → text, of the parts that differ; empty if it was added.
        after: the same of the second knowledge base; empty if it was removed.
    """

    section: str
    name: str
    kind: Literal["added", "removed", "changed"]
    before: Mapping[str, str]
    after: Mapping[str, str]

    def to_dict(self) -> dict[str, Any]:
        """Return the change as plain data for JSON."""
        return {
            "section": self.section,
            "name": self.name,
            "kind": self.kind,
            "before": dict(self.before),
            "after": dict(self.after),
        }


def compare(before: KnowledgeBase, after: KnowledgeBase) -> tuple[Change, ...]:
    """Return what changed, in the order of a file's sections.

    Names and descriptions of files, tests, and predicates that only heads of rules bring in are
    not compared. No change means the same rewards and the same descriptors.
    """
    old, new = _sections(before), _sections(after)
    return (
        *(c for section in old for c in _changes(section, old[section], new[section])),
        *_reordered(list(old["entity_weights"]), list(new["entity_weights"])),
    )


def _changes(section: str, old: Texts, new: Texts) -> Iterator[Change]:
    for name in dict.fromkeys([*old, *new]):
        if name not in new:
            yield Change(section, name, "removed", old[name], {})
        elif name not in old:
            yield Change(section, name, "added", {}, new[name])
        elif old[name] != new[name]:
            yield Change(
                section, name, "changed", _less(old[name], new[name]), _less(new[name], old[name])
            )


def _reordered(old: Sequence[str], new: Sequence[str]) -> Iterator[Change]:
    """The first entity weight that holds counts, so their order matters too."""
    before = [name for name in old if name in new]
    after = [name for name in new if name in old]
    if before != after:
        texts = [{"": " → ".join(names)} for names in (before, after)]
        yield Change("entity_weights", "order", "changed", *texts)


def _less(parts: Mapping[str, str], others: Mapping[str, str]) -> dict[str, str]:
    """Return the parts that the others lack or have otherwise."""
    return {key: text for key, text in parts.items() if others.get(key) != text}


def _sections(kb: KnowledgeBase) -> dict[str, Texts]:
    """Return everything that is compared: section → name → part → text."""
    return {
        "subject": {"": {"": kb.subject}},
        "background": {str(atom): {} for atom in kb.background},
        "predicates": {p.signature: {"": p.description} for p in kb.declared.values()},
        "attributes": {a.signature: {"": a.description} for a in kb.attributes.values()},
        "rules": {name: _rule(parts) for name, parts in kb.written_rules.items()},
        "semantics": {
            "": {
                **{key: str(value) for key, value in kb.semantics.model_dump().items()},
                "groundings": kb.semantics.gathers,
            }
        },
        "observation": {
            name: {key: str(value) for key, value in source.model_dump().items()}
            for name, source in kb.observation.items()
        },
        "entities": {
            name: {"from": ", ".join(sort.tables), "at_most": f"{sort.at_most}"}
            for name, sort in kb.entities.items()
        },
        "facts": {
            fact.text: {
                "formula": fact.formula.text,
                "bounds": "exact" if fact.exact else "margin",
                "at_least": f"{fact.at_least!r}",
            }
            for fact in kb.facts
        },
        "facts_at": {"": {"": kb.facts_at}},
        "time": {"": _time(kb.time)},
        "signals": {
            name: {
                "unit": signal.unit,
                "default": "none" if signal.default is None else f"{signal.default!r}",
                "from": "none" if signal.observed is None else signal.observed,
            }
            for name, signal in kb.signals.items()
        },
        "weights": {
            name: {
                "normalizer": f"{weight.normalizer!r}",
                **({} if weight.smoothing is None else _smoothing(weight.smoothing)),
                **{
                    f"coefficients.{head}": f"{number!r}"
                    for head, number in weight.coefficients.items()
                },
            }
            for name, weight in kb.weights.items()
        },
        "terms": {
            term.name: {
                "weight": str(term.weight),
                "formula": term.formula.text,
                **{f"parameters.{name}": f"{number!r}" for name, number in term.parameters.items()},
            }
            for term in kb.terms.values()
        },
        "schedules": {
            target: {
                "from": f"{number.start!r}",
                "to": f"{number.end!r}",
                "over": f"{number.over} {number.by}",
            }
            for target, number in kb.schedules.items()
        },
        "entity_weights": _entity_weights(kb),
        "grounding": {
            name: {"": text} for name, text in _flat(kb.grounding.model_dump(mode="json"))
        },
    }


def _time(time: Time | None) -> dict[str, str]:
    return {} if time is None else {"step": f"{time.step!r}", "unit": time.unit}


def _smoothing(smoothing: Smoothing) -> dict[str, str]:
    return {f"smoothing.{key}": f"{value!r}" for key, value in smoothing.model_dump().items()}


def _rule(parts: Sequence[Rule]) -> dict[str, str]:
    """Return a rule as it is written, and its parts where it has some."""
    first = parts[0]
    return {
        "": str(first.part_of or first.clause),
        **{part.name: str(part.clause) for part in parts if part.part_of},
        "threshold": f"{first.threshold!r}",
        "negation_threshold": f"{first.negation_threshold!r}",
        "certainty": f"{first.certainty_entry!r}",
        "groundings": first.groundings or "as in semantics",
    }


def _entity_weights(kb: KnowledgeBase) -> Texts:
    parts: Texts = {}
    for entry in kb.entity_weights:
        name = str(entry.when)
        while name in parts:
            name += " (again)"
        parts[name] = {"weight": f"{entry.weight!r}", "at_least": f"{entry.at_least!r}"}
    return parts


def _flat(values: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", str(value)


# -- recorded episodes --------------------------------------------------------------------------


@dataclass(frozen=True)
class MovedStep:
    """A recorded step whose outcome is another one under the second knowledge base.

    Attributes:
        episode: the number of its episode.
        step: its index in the episode.
        time: seconds since the episode began.
        before: its outcome under the first knowledge base.
        after: its outcome under the second.
    """

    episode: int
    step: int
    time: float
    before: Outcome
    after: Outcome

    @property
    def moves(self) -> dict[str, tuple[float, float]]:
        """What moved, such as ``confidence safe1`` → value before and after."""
        old, new = _quantities(self.before), _quantities(self.after)
        pairs = {name: (old.get(name, 0.0), new.get(name, 0.0)) for name in {**old, **new}}
        return {name: pair for name, pair in pairs.items() if abs(pair[1] - pair[0]) > TOLERANCE}

    @property
    def size(self) -> tuple[float, float]:
        """How far the reward moved, and then anything else; what is worst has the largest."""
        differences = [abs(new - old) for old, new in self.moves.values()]
        return abs(self.after.reward - self.before.reward), max(differences, default=0.0)


@dataclass(frozen=True)
class LogDifference:
    """What two knowledge bases make of the same recorded episodes.

    Attributes:
        before: the episodes under the first.
        after: the episodes under the second.
        moved: the steps that have another outcome, the worst first.
    """

    before: tuple[ReplayedEpisode, ...]
    after: tuple[ReplayedEpisode, ...]
    moved: tuple[MovedStep, ...]

    @property
    def steps(self) -> int:
        """How many steps were recorded."""
        return sum(len(episode.outcomes) for episode in self.before)

    @property
    def movements(self) -> dict[str, tuple[int, float]]:
        """What moved → in how many steps, and by how much at most; the widest first."""
        found: dict[str, list[float]] = {}
        for moved in self.moved:
            for name, (old, new) in moved.moves.items():
                found.setdefault(name, []).append(new - old)
        largest = {name: (len(all_), max(all_, key=abs)) for name, all_ in found.items()}
        return dict(sorted(largest.items(), key=lambda item: -item[1][0]))

    def to_dict(self) -> dict[str, Any]:
        """Return the difference as plain data for JSON."""
        return {
            "steps": self.steps,
            "moved": [
                {"episode": m.episode, "step": m.step, "time": m.time, "moves": m.moves}
                for m in self.moved
            ],
            "returns": [
                {"episode": a.episode.number, "before": a.value, "after": b.value}
                for a, b in zip(self.before, self.after, strict=True)
            ],
        }


def compare_log(log: Log, before: KnowledgeBase, after: KnowledgeBase) -> LogDifference:
    """Return what moved on recorded episodes.

    Args:
        log: the recorded episodes.
        before: the first knowledge base.
        after: the second one.

    Raises:
        SfolError: a step has no reward under one of them.
    """
    old, new = replay(log, before), replay(log, after)
    steps = (
        MovedStep(a.episode.number, i, a.episode.steps[i].time, a.outcomes[i], b.outcomes[i])
        for a, b in zip(old, new, strict=True)
        for i in range(len(a.outcomes))
    )
    moved = [step for step in steps if step.moves]
    return LogDifference(old, new, tuple(sorted(moved, key=lambda m: m.size, reverse=True)))


def _quantities(outcome: Outcome) -> dict[str, float]:
    return {
        "reward": outcome.reward,
        **{f"term {name}": value for name, value in outcome.terms.items()},
        **{f"weight {name}": value for name, value in outcome.weights.items()},
        **{f"confidence {name}": value for name, value in outcome.confidences.items()},
    }
