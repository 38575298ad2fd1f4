"""What an engine draws from some facts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from sfol.engines.program import Program
from sfol.engines.tables import Tables
from sfol.facts import Bound
from sfol.syntax import Atom
from sfol.temporal import Memory


@dataclass(frozen=True)
class Conclusions:
    """What follows from some facts.

    Attributes:
        tables: facts, background, and the conclusions that concern the subject or that some body
            reads.
        derived: the atoms that some rule concluded, with their final bounds.
        memory: what the episode remembers after the step that they are of, if they are of one.
        asserted: what facts and background say of heads that depend on themselves; the tables have
            their final bounds.
    """

    tables: Tables
    derived: Mapping[Atom, Bound]
    _program: Program = field(repr=False, compare=False)
    memory: Memory | None = None
    asserted: tuple[tuple[Atom, Bound], ...] = ()

    @cached_property
    def subject(self) -> str:
        """The entity that they were drawn for."""
        return self._program.knowledge_base.subject

    @cached_property  # found when first asked for: few ask
    def fired(self) -> frozenset[str]:
        """The names of the rules that concluded something; of parts, and what they are parts of."""
        return frozenset(
            name
            for head, rules in self._program.rules.items()
            if head not in self._program.auxiliary
            for rule, plan in rules
            if plan.holds(self.tables)
            for name in (rule.name, rule.entry)
        )

    def __getstate__(self) -> dict[str, Any]:
        # A program is made of closures, which no pickle holds; what it is asked for can be.
        kept = ("tables", "derived", "subject", "fired", "memory", "asserted")
        return {name: getattr(self, name) for name in kept}
