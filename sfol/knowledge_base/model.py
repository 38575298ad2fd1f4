"""The checked whole: a knowledge base as the rest of sfol works with it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

from sfol.errors import KnowledgeBaseError, did_you_mean
from sfol.facts import TRUE, Facts
from sfol.knowledge_base.checking import check
from sfol.knowledge_base.format import KnowledgeBaseFile, Smoothing
from sfol.knowledge_base.loading import load
from sfol.knowledge_base.parts import Parts, Predicate, Rule, ScheduledNumber
from sfol.operators import POOLED
from sfol.syntax import Compared, Timed

_Model = TypeVar("_Model", bound=BaseModel)


@dataclass(frozen=True)
class KnowledgeBase(Parts):
    """A checked knowledge base: every clause parsed, every name known.

    Attributes:
        name: from the file.
        description: from the file.
        subject: the entity whose heads make the reward.
        background: ground atoms that always hold with [1, 1].
        predicates: by name; heads that only rules introduce are among them.
        attributes: by name.
        rules: by name, in the order of the file; in place of one with ``or`` or ``implies`` its
            parts, called ``safe2.1``, ``safe2.2`` and so on.
        semantics: the operators.
        signals: by name.
        weights: by name.
        terms: by name; their sum is the reward.
        schedules: numbers that change while an agent is trained, by name.
        entity_weights: in order; the first that holds counts.
        grounding: numbers for whoever turns observations into facts.
        observation: parts of what the environment gives, by name.
        entities: sorts of entities in it, by name.
        facts: how facts are read off it.
        facts_at: whether a step is rewarded by the facts of the state before the action, or of the
            next one.
        time: the length of a step, if the file says it.
        observed_signals: how signals are, by name.
        tests: cases of the last file; inherited ones do not run for an overlay.
        files: the files that it was made from, in the order in which they were applied.
        version: of the format, by which it was read.

    Example:
        >>> kb = KnowledgeBase.load("aeb")
        >>> len(kb.rules)
        9
    """

    @classmethod
    def load(
        cls, *sources: str | Path, sections: Mapping[str, type[BaseModel]] | None = None
    ) -> KnowledgeBase:
        """Read one knowledge base, or several applied left to right.

        Args:
            sources: paths of files (ending in .yaml or .yml), or names of bundled ones such as
                ``aeb``.
            sections: models of the sections of `grounding` that are to be checked too.

        Raises:
            InvalidKnowledgeBase: with every error found, each with file, line and column.
        """
        return cls(**vars(load(*sources, sections=sections)))

    @classmethod
    def of(cls, file: KnowledgeBaseFile) -> KnowledgeBase:
        """Check a file that extends nothing and stands nowhere on disk.

        Raises:
            InvalidKnowledgeBase: with every error found.
        """
        return cls(**vars(check(file)))

    @property
    def heads(self) -> tuple[str, ...]:
        """The predicates that rules conclude, each once, in the order of the rules."""
        return tuple(dict.fromkeys(rule.clause.head.predicate for rule in self.rules.values()))

    @property
    def written_rules(self) -> dict[str, tuple[Rule, ...]]:
        """The rules by their names in a file; one with ``or`` or ``implies`` has several parts."""
        found: dict[str, list[Rule]] = {}
        for rule in self.rules.values():
            found.setdefault(rule.entry, []).append(rule)
        return {name: tuple(parts) for name, parts in found.items()}

    @property
    def declared(self) -> dict[str, Predicate]:
        """The predicates that are declared, by name."""
        return {name: p for name, p in self.predicates.items() if p.declared}

    @property
    def weighed(self) -> frozenset[str]:
        """The heads that some weight or formula names."""
        weighed = {head for weight in self.weights.values() for head in weight.coefficients}
        return frozenset(weighed.union(*(term.heads for term in self.terms.values())))

    @property
    def read(self) -> frozenset[str]:
        """The predicates that some rule or condition reads."""
        bodies = [rule.clause.body for rule in self.rules.values()]
        bodies += [condition.when for condition in self.entity_weights]
        return frozenset().union(*(body.predicates for body in bodies))

    def gathers(self, rule: Rule) -> str:
        """Return what several substitutions of a rule come to: its own `groundings`, or all's."""
        return rule.groundings or self.semantics.gathers

    @property
    def timed(self) -> tuple[Timed, ...]:
        """What bodies ask operators over time, what stands in another one before it."""
        bodies = [rule.clause.body for rule in self.rules.values()]
        bodies += [condition.when for condition in self.entity_weights]
        return tuple(dict.fromkeys(name for body in bodies for name in body.timed))

    @property
    def comparisons(self) -> tuple[Compared, ...]:
        """What bodies say of values, each once."""
        bodies = [rule.clause.body for rule in self.rules.values()]
        bodies += [condition.when for condition in self.entity_weights]
        found = (atom.predicate for body in bodies for atom in body.comparisons)
        return tuple(dict.fromkeys(name for name in found if isinstance(name, Compared)))

    @property
    def smoothed(self) -> dict[str, Smoothing]:
        """The weights that follow their heads from step to step, by name."""
        return {name: w.smoothing for name, w in self.weights.items() if w.smoothing is not None}

    @property
    def has_memory(self) -> bool:
        """Whether what a step is worth depends on the steps before it."""
        return bool(self.timed or self.smoothed)

    @property
    def hash(self) -> str:
        """A digest of everything that can change a reward or a descriptor, 64 hex digits.

        Names of files, descriptions, tests, and coefficients of heads that no rule concludes are
        not part of it.
        """
        heads = set(self.heads)
        meaning = {
            "subject": self.subject,
            "background": sorted(map(str, self.background)),
            "rules": {name: _meaning_of(rule) for name, rule in self.rules.items()},
            "semantics": [
                *self.semantics.model_dump().values(),
                self.semantics.gathers == POOLED,
            ],
            "signals": {name: signal.default for name, signal in self.signals.items()},
            **self._compared_meaning(),
            "weights": {
                name: [
                    weight.normalizer,
                    {head: c for head, c in weight.coefficients.items() if head in heads},
                ]
                for name, weight in self.weights.items()
            },
            "terms": {
                name: [term.weight, term.formula.text, dict(term.parameters)]
                for name, term in self.terms.items()
            },
            "entity_weights": [[str(e.when), e.weight, e.at_least] for e in self.entity_weights],
            "grounding": self.grounding.model_dump(mode="json"),
            **self._observed_meaning(),
            **self._scheduled_meaning(),
            **self._timed_meaning(),
        }
        text = json.dumps(meaning, sort_keys=True, ensure_ascii=False)
        return hashlib.sha256(text.encode()).hexdigest()

    def _observed_meaning(self) -> dict[str, Any]:
        """Return what is read off observations, for the digest; one without it has none."""
        meaning = {
            "observation": {name: source.model_dump() for name, source in self.observation.items()},
            "entities": {name: [s.tables, s.at_most] for name, s in self.entities.items()},
            "facts": {f.text: [f.formula.text, f.exact, f.at_least] for f in self.facts},
            "facts_at": "" if self.facts_at == "state" else self.facts_at,
            "observed": {name: f.text for name, f in self.observed_signals.items()},
        }
        return {name: content for name, content in meaning.items() if content}

    def _compared_meaning(self) -> dict[str, Any]:
        """Return the attributes that bodies read, for the digest: `>=` alone does not tell."""
        read = sorted({name.attribute for name in self.comparisons})
        return {"attributes": read} if read else {}

    def _scheduled_meaning(self) -> dict[str, Any]:
        """Return how numbers change, for the digest; one without schedules has none."""
        meaning = {
            target: [number.start, number.end, number.over, number.by]
            for target, number in self.schedules.items()
            if number.section == "terms" or number.name in self.heads
        }
        return {"schedules": meaning} if meaning else {}

    def _timed_meaning(self) -> dict[str, Any]:
        """Return how a step depends on others, for the digest, apart from what clauses say."""
        if self.time is None or not self.has_memory:
            return {}
        smoothing = {name: [s.rise, s.fall] for name, s in self.smoothed.items()}
        return {"time": [self.time.step, *([smoothing] if smoothing else [])]}

    def number(self, scheduled: ScheduledNumber) -> float:
        """Return the file's own value of a number that is scheduled."""
        if scheduled.section == "weights":
            return self.weights[scheduled.group].coefficients[scheduled.name]
        return self.terms[scheduled.group].parameters[scheduled.name]

    def to_pyreason(self, facts: Facts) -> tuple[Any, list[Any], list[Any]]:
        """Return the PyReason program of a scene, for those who want to go on from it.

        All conclusions are among the facts, so that one run suffices: each rule then concludes its
        own bound, under a head of its own such as ``safe3.8(ego)``: what its body comes to, which
        its certainty still multiplies. Integers and quoted constants have names of their own, such
        as ``integer.7`` and ``text.4d617279``.

        Args:
            facts: ground atoms with bounds.

        Returns:
            A networkx graph of the entities, PyReason rules and PyReason facts. The rules name
            annotation functions: add each of `sfol.engines.pyreason_runtime.annotation_functions()`
            and set ``pyreason.settings.allow_ground_rules``.

        Raises:
            MissingExtraError: PyReason is not installed.
            FactError: a fact does not fit the knowledge base.
            KnowledgeBaseError: a body has an operator over time.
        """
        if self.timed:
            name = self.timed[0].operator.name
            raise KnowledgeBaseError(
                f"a program for PyReason has no memory, and '{self.name}' says '{name}'",
                name=name,
                suggestion="let RewardFunction(kb, engine='pyreason').episode() take the steps",
            )
        from sfol.engines.pyreason import PyReasonEngine  # noqa: PLC0415

        return PyReasonEngine(self).to_pyreason(facts)

    def grounding_of(self, section: str, model: type[_Model]) -> _Model:
        """Return a consumer's section of `grounding`, read by the consumer's own model.

        Args:
            section: its key, such as ``segmentation``.
            model: the pydantic model that describes it; a missing section has its defaults.

        Raises:
            KnowledgeBaseError: the section does not fit the model.
        """
        content = (self.grounding.model_extra or {}).get(section, {})
        try:
            return model.model_validate(content)
        except ValueError as error:
            raise KnowledgeBaseError(
                f"grounding.{section} of '{self.name}' is not valid: {error}", name=section
            ) from error

    def predicate(self, name: str) -> Predicate:
        """Return a declared predicate.

        Raises:
            KnowledgeBaseError: there is none of this name.
        """
        if name not in self.predicates:
            raise KnowledgeBaseError(
                f"'{name}' is no predicate of '{self.name}'",
                name=name,
                suggestion=did_you_mean(name, self.predicates),
            )
        return self.predicates[name]

    def __repr__(self) -> str:
        return (
            f"<KnowledgeBase '{self.name}': {len(self.predicates)} predicates, "
            f"{len(self.written_rules)} rules, {len(self.terms)} terms, {self.hash[:12]}>"
        )


def _meaning_of(rule: Rule) -> list[Any]:
    """Return what a rule says, for the digest; what it leaves to defaults is no part of it."""
    certainty = [] if rule.certainty == TRUE else [list(rule.certainty)]
    groundings = [] if rule.groundings is None else [rule.groundings]
    return [str(rule.clause), rule.threshold, rule.negation_threshold, *certainty, *groundings]
