"""Episodes: the rewards of steps in order, where rules speak of steps that have passed.

What operators over time say is computed between the strata, and given to the engine like facts. A
head that an operator speaks of is concluded first, by an engine that has only the rules which that
needs; the engine of the whole knowledge base then draws the conclusions of the step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sfol.comparisons import compared_rows
from sfol.engines.conclusions import Conclusions
from sfol.engines.engine import Engine
from sfol.engines.tables import Tables
from sfol.errors import expect
from sfol.facts import Bound, Facts
from sfol.knowledge_base import KnowledgeBase
from sfol.knowledge_base.recursion import components
from sfol.literals.search import Constants
from sfol.observations.plans import Observation, ObservedStep, read_for_facts
from sfol.outcome import Outcome
from sfol.syntax import Atom, Timed
from sfol.temporal import Memory, Moment, Remembered, Rows, smoothed, steps_of

if TYPE_CHECKING:
    from sfol.reward import RewardFunction


@dataclass(frozen=True)
class _Layer:
    """What operators over time say as soon as certain heads are concluded.

    Attributes:
        engine: concludes these heads; None if there are none.
        timed: the operators' predicates, what stands in another one before it.
    """

    engine: Engine | None
    timed: tuple[Timed, ...]


class Timeline:
    """How the steps of a knowledge base follow on each other.

    Args:
        engine: of the whole knowledge base.
        make: makes an engine of the same kind for some of its rules.
    """

    def __init__(self, engine: Engine, make: Callable[[KnowledgeBase], Engine]) -> None:
        kb = engine.program.knowledge_base
        self._engine = engine
        self._kb = kb
        self._length = kb.time.step if kb.time else 1.0
        self._layers = tuple(_layers(kb, make))
        self._windows = {
            name: steps_of(name.operator.duration or 0.0, self._length) for name in kb.timed
        }
        self._smoothing = kb.smoothed
        self._comparisons = kb.comparisons
        self._strict = tuple(name for name in kb.timed if name.operator.strict)

    def conclude(self, facts: Facts, memory: Memory) -> Conclusions:
        """Return what follows from the facts of a step, with what is remembered after it.

        Args:
            facts: ground atoms with bounds; they are not changed.
            memory: what is remembered of the steps before.
        """
        said: dict[str, dict[Constants, Bound]] = {
            name: compared_rows(name, facts.values()) for name in self._comparisons
        }
        atoms: dict[str, Remembered] = {}
        for layer in self._layers:
            known = self._known(layer.engine, facts, said)
            for name in layer.timed:
                before = memory.atoms.get(name, {})
                rows: Rows = before
                if not name.operator.strict:
                    atoms[str(name)], rows = self._advanced(name, before, known, memory.step)
                said[name] = dict(rows)
                known.put_all(name, said[name])
        conclusions = self._engine.conclude(facts.extended(said))
        for name in self._strict:
            before = memory.atoms.get(name, {})
            atoms[str(name)], _ = self._advanced(name, before, conclusions.tables, memory.step)
        return replace(conclusions, memory=Memory(memory.step + 1, atoms))

    def smoothed(
        self,
        conclusions: Conclusions,
        before: Memory,
        weigh: Callable[[Conclusions], Mapping[str, float]],
    ) -> Conclusions:
        """Return the conclusions of a step with the weights that follow those of the step before.

        Args:
            conclusions: of the step.
            before: what is remembered of the steps before.
            weigh: returns what weights come to by themselves.
        """
        after = conclusions.memory
        if after is None or not self._smoothing:
            return conclusions
        weights, follow = weigh(conclusions), {}
        for name, smoothing in self._smoothing.items():
            new = weights[name]
            old = before.weights.get(name, new)
            constant = smoothing.rise if new > old else smoothing.fall
            follow[name] = smoothed(old, new, constant, self._length)
        return replace(conclusions, memory=replace(after, weights=follow))

    def _known(
        self, engine: Engine | None, facts: Facts, said: Mapping[str, dict[Constants, Bound]]
    ) -> Tables:
        """Return what is known of a step so far."""
        if engine is None:
            tables = Tables.of(facts, self._kb.background)
        else:
            tables = self._concluded(engine, facts, said)
        for name, rows in said.items():
            tables.put_all(name, rows)
        return tables

    @staticmethod
    def _concluded(
        engine: Engine, facts: Facts, said: Mapping[str, dict[Constants, Bound]]
    ) -> Tables:
        arities = engine.program.arities
        conclusions = engine.conclude(
            facts.extended({name: rows for name, rows in said.items() if name in arities})
        )
        tables = conclusions.tables
        for atom, bound in list(conclusions.derived.items()):
            tables.put(atom, bound)
        return tables

    def _advanced(
        self, name: Timed, before: Remembered, known: Tables, step: int
    ) -> tuple[Remembered, Rows]:
        moment = Moment.of(name, known, step, self._windows[name])
        return name.operator.advance(before, moment)


def _layers(kb: KnowledgeBase, make: Callable[[KnowledgeBase], Engine]) -> Iterator[_Layer]:
    """Yield the layers of a knowledge base, each with what is known before it alone."""
    levels = _levels(kb)
    for level in sorted({levels[name] for name in kb.timed}):
        timed = tuple(name for name in kb.timed if levels[name] == level)
        needed = _needed(kb, timed)
        rules = {n: rule for n, rule in kb.rules.items() if rule.clause.head.predicate in needed}
        part = replace(kb, rules=rules, weights={}, terms={}, schedules={}, entity_weights=())
        yield _Layer(make(part) if rules else None, timed)


def _levels(kb: KnowledgeBase) -> dict[str, int]:
    """Return after how many layers every head, and every operator over time, can be concluded."""
    heads = frozenset(kb.heads)
    levels: dict[str, int] = {}

    def level(name: str) -> int:
        if not isinstance(name, Timed):
            return levels.get(name, 0)
        operands = () if name.operator.strict else name.operands
        return max((level(a.predicate) + (a.predicate in heads) for a in operands), default=0)

    # A component comes after all that it reads, and what it reads of itself counts for nothing.
    for predicates, _ in components(kb.rules.values()):
        rules = (r for r in kb.rules.values() if r.clause.head.predicate in predicates)
        read = (name for rule in rules for name in rule.clause.body.asked)
        levels |= dict.fromkeys(predicates, max(map(level, read), default=0))
    return levels | {name: level(name) for name in kb.timed}


def _needed(kb: KnowledgeBase, timed: tuple[Timed, ...]) -> frozenset[str]:
    """Return the heads that must be concluded before what operators over time say of them."""
    heads, needed = frozenset(kb.heads), set[str]()
    waiting = [a.predicate for name in timed for operand in _below(name) for a in operand.present]
    while waiting:
        name = waiting.pop()
        if name in heads and name not in needed:
            needed.add(name)
            for rule in kb.rules.values():
                if rule.clause.head.predicate == name:
                    waiting.extend(rule.clause.body.present)
    return frozenset(needed)


def _below(name: Timed) -> tuple[Atom, ...]:
    return () if name.operator.strict else name.operands


class Episode:
    """The steps of one episode under a knowledge base, in order; `RewardFunction.episode` makes it.

    Args:
        reward: the reward function.

    Attributes:
        memory: what is remembered of the steps so far, a value: kept and set again, it takes the
            episode back to where it was.

    Example:
        >>> import sfol
        >>> episode = sfol.RewardFunction("aeb").episode()
        >>> facts = sfol.Facts.parse("NoCrosswalk(ego). EmptyLane(ego).")
        >>> episode.step(facts, v=6.0, v_next=6.0).reward
        1.0
    """

    def __init__(self, reward: RewardFunction) -> None:
        self._reward = reward
        self.memory = Memory()

    def reset(self) -> None:
        """Begin a new episode: nothing is remembered."""
        self.memory = Memory()

    def step(self, facts: Facts, /, **signals: float) -> Outcome:
        """Return the reward of the next step and everything that it was made of.

        Args:
            facts: what is known of the state before the action; see `RewardFunction.evaluate`.
            signals: as there.

        Raises:
            The errors of `RewardFunction.evaluate`; the episode then is where it was.
        """
        conclusions = self._concluded(facts)
        outcome = self._reward.evaluate(conclusions, **signals)
        self._remember(conclusions)
        return outcome

    def transition(  # noqa: PLR0913, PLR0917 (what env.step returns, in its order)
        self,
        observation: Observation,
        action: Observation = None,
        next_observation: Observation = None,
        native: Observation = None,
        terminated: Observation = None,
        truncated: Observation = None,
        /,
        **signals: float,
    ) -> Outcome:
        """Return the reward of the next transition, with facts and signals read off observations.

        Args and errors are those of `RewardFunction.transition`, of one scene.
        """
        step = ObservedStep(observation, action, next_observation, native, terminated, truncated)
        facts = self._reward.observe(read_for_facts(self._reward.kb, step))
        read = self._reward.observe_signals(*step.wholes.values(), **signals)
        return self.step(facts, **read)

    def conclude(self, facts: Facts) -> Conclusions:
        """Return what follows from the facts of the next step.

        `RewardFunction.evaluate`, `explain`, `weights` and `entity_weights` take it in place of
        facts: where the facts of a state are there before the signals of its step.

        Raises:
            The errors of `RewardFunction.conclude`; the episode then is where it was.
        """
        conclusions = self._concluded(facts)
        self._remember(conclusions)
        return conclusions

    def _concluded(self, facts: Facts) -> Conclusions:
        expect(facts, Facts, "a scene", "give sfol.Facts, such as Facts.parse('Vehicle(ego).')")
        return self._reward.conclude_after(facts, self.memory)

    def _remember(self, conclusions: Conclusions) -> None:
        assert conclusions.memory is not None, "conclusions of a step"
        self.memory = conclusions.memory

    def __repr__(self) -> str:
        return f"<Episode of '{self._reward.kb.name}' after {self.memory.step} steps>"
