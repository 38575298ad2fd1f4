"""The reward: facts and signals in, one number out, with everything that it was made of."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import replace
from functools import cached_property, partial, reduce
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, SupportsIndex, overload

from sfol import arrays
from sfol.arrays import Array, Backend, backend_of
from sfol.engines.batch import Batch, encode
from sfol.engines.batched import Bounds, conclude
from sfol.engines.conclusions import Conclusions
from sfol.engines.dense import DenseProgram, Domains, Key
from sfol.engines.engine import Engine, make_engine
from sfol.engines.matching import condition_criterion
from sfol.engines.plan import Plan
from sfol.episode import Episode, Timeline
from sfol.errors import (
    FormulaError,
    SignalError,
    UsageError,
    did_you_mean,
    expect,
    listed,
    warn_of_silence,
)
from sfol.facts import Bound, Facts
from sfol.formula import Formula
from sfol.knowledge_base import KnowledgeBase, RewardTerm
from sfol.knowledge_base.observing import entity_names
from sfol.knowledge_base.schedules import values_at
from sfol.knowledge_base.silence import silences
from sfol.literals.search import WORK_LIMIT
from sfol.observations.many import Scenes, ScenesReader
from sfol.observations.plans import Observation, ObservedStep, read_for_facts
from sfol.observations.single import ObservationReader
from sfol.operators import CONFIDENCES
from sfol.outcome import BatchOutcome, Outcome
from sfol.recorded_steps import Reals, RecordedSteps, first_of, record
from sfol.syntax import is_name, is_variable
from sfol.temporal import Memory
from sfol.tensor_reward import TensorReward

if TYPE_CHECKING:
    from sfol.explain import Explanation


class _Changes:
    """How often numbers were set to other ones."""

    __slots__ = ("count",)

    def __init__(self) -> None:
        self.count = 0


class Numbers(MutableMapping[str, float]):
    """Numbers by name that can be set, one by one or by `update`, but not added or removed.

    A number may be a torch tensor without dimensions, to learn it from the rewards of a batch.

    Args:
        numbers: name → number.
        what: what the names are, for error messages.
        changes: counts whenever a number is set to another one.
    """

    __slots__ = ("_changes", "_numbers", "_what")

    def __init__(
        self, numbers: Mapping[str, float], what: str, changes: _Changes | None = None
    ) -> None:
        self._numbers = dict(numbers)
        self._what = what
        self._changes = changes or _Changes()

    @property
    def plain(self) -> Mapping[str, float]:
        """The same numbers in a dictionary, which is read faster; do not change it."""
        return self._numbers

    def __getitem__(self, name: str) -> float:
        return self._numbers[name]

    def __setitem__(self, name: str, number: float) -> None:
        if not isinstance(name, str) or name not in self._numbers:
            raise UsageError(
                f"{self._what} has no '{name}'",
                name=str(name),
                suggestion=did_you_mean(str(name), self._numbers),
            )
        if not arrays.is_differentiable(number):
            value = arrays.as_float(number)
        elif getattr(number, "ndim", 0):
            value = None
        else:
            value = number  # as it is, so that gradients reach it
        if value is None or not arrays.is_finite(value):
            raise UsageError(
                f"'{name}' can't be {number!r:.80}", name=name, suggestion="give a finite number"
            )
        old = self._numbers[name]
        if value is not old and not (type(value) is type(old) is float and value == old):
            self._changes.count += 1
        self._numbers[name] = value

    def __delitem__(self, name: str) -> None:
        raise UsageError(
            f"'{name}' can't be removed from {self._what}", name=str(name), suggestion="set it to 0"
        )

    def __ior__(self, numbers: Mapping[str, float]) -> Numbers:
        self.update(numbers)
        return self

    def __iter__(self) -> Iterator[str]:
        return iter(self._numbers)

    def __len__(self) -> int:
        return len(self._numbers)

    def __repr__(self) -> str:
        return repr(self._numbers)


class NumberGroups(Mapping[str, Numbers]):
    """Groups of numbers by name; a group can be set as a whole, to numbers of the same names.

    Args:
        groups: name → its numbers.
        what: what a group is, for error messages.

    Attributes:
        changes: how often a number of any group was set to another one.
    """

    __slots__ = ("_groups", "changes")

    def __init__(self, groups: Mapping[str, Mapping[str, float]], what: str) -> None:
        self.changes = _Changes()
        self._groups = {
            name: Numbers(numbers, f"the {what} '{name}'", self.changes)
            for name, numbers in groups.items()
        }

    def __getitem__(self, name: str) -> Numbers:
        return self._groups[name]

    def __setitem__(self, name: str, numbers: Mapping[str, float]) -> None:
        expect(numbers, Mapping, name, "give a number for each of its names")
        if name not in self._groups or numbers.keys() != self._groups[name].keys():
            raise UsageError(
                f"'{name}' has other names than {', '.join(map(str, numbers))}",
                name=name,
                suggestion="set its numbers one by one: ['safety']['safe1'] = 0.5",
            )
        self._groups[name].update(numbers)

    def __iter__(self) -> Iterator[str]:
        return iter(self._groups)

    def __len__(self) -> int:
        return len(self._groups)

    def __repr__(self) -> str:
        return repr(self._groups)


class RewardFunction:
    """A knowledge base as a callable: the reward of a step from its facts and signals.

    Args:
        kb: a knowledge base, the path of one, or the name of a bundled one.
        engine: ``compiled``, or ``pyreason``, the much slower reference (extra `pyreason`); batches
            are evaluated by arithmetic of their own, whichever it is.
        work_limit: how many known atoms the search for a rule's substitutions may look at in a
            scene; past it a WorkLimitError names the rule.

    Attributes:
        kb: the knowledge base.
        coefficients: weight → head → coefficient (the paper's α, β); may be set at any time.
        parameters: term → parameter → number; may be set at any time.

    Raises:
        InvalidKnowledgeBase: the file has errors.
        UsageError: there is no such engine, or the limit is not above 0.

    Example:
        >>> reward = RewardFunction("aeb")
        >>> facts = Facts.parse("NoCrosswalk(ego). EmptyLane(ego).")
        >>> reward(facts, v=6.0, v_next=6.0)
        1.0
    """

    def __init__(
        self,
        kb: KnowledgeBase | str | Path,
        *,
        engine: str = "compiled",
        work_limit: int = WORK_LIMIT,
    ) -> None:
        self.kb = kb if isinstance(kb, KnowledgeBase) else KnowledgeBase.load(kb)
        self._engine_name = engine
        self._engine: Engine = make_engine(engine, self.kb, work_limit)
        self._conclude = self._conclude_first
        self._warned = False
        self._reader = ObservationReader(self.kb)
        self._scenes_reader = ScenesReader(self.kb)
        self._repeated_one, self._repeated_many = (
            {
                fired: RecordedSteps(partial(self._wanted, fired=fired), of_one=of_one)
                for fired in (False, True)
            }
            for of_one in (True, False)
        )
        self._repeated_outcomes = RecordedSteps(partial(self._wanted, bounds=True))
        self.coefficients = NumberGroups(
            {name: weight.coefficients for name, weight in self.kb.weights.items()}, "weight"
        )
        self.parameters = NumberGroups(
            {name: term.parameters for name, term in self.kb.terms.items()}, "term"
        )
        self._head_atoms = [*self._engine.program.subject_heads.items()]
        self._confidence = CONFIDENCES[self.kb.semantics.confidence]
        self._conditions = [
            (
                Plan.of(
                    c.when,
                    condition_criterion(c),
                    given=["X"],
                    owner=f"the entity weight of '{c.when}'",
                    limit=work_limit,
                ),
                c.weight,
            )
            for c in self.kb.entity_weights
        ]

    @property
    def engine(self) -> Engine:
        """The engine that draws the conclusions."""
        return self._engine

    @property
    def reads_facts(self) -> bool:
        """Whether the knowledge base says how facts are read off an observation, or needs none."""
        return self._reader.reads_facts

    @property
    def subject_heads(self) -> tuple[str, ...]:
        """The heads whose confidences an outcome has, in its order."""
        return tuple(self._engine.program.subject_heads)

    @property
    def hash(self) -> str:
        """The knowledge base's hash, with the coefficients and parameters as they are now."""
        return self.current().hash

    def current(self) -> KnowledgeBase:
        """Return the knowledge base with the coefficients and parameters as they are now."""
        weights = {
            name: weight.model_copy(update={"coefficients": _floats(self.coefficients[name])})
            for name, weight in self.kb.weights.items()
        }
        terms = {
            name: replace(term, parameters=_floats(self.parameters[name]))
            for name, term in self.kb.terms.items()
        }
        return replace(self.kb, weights=weights, terms=terms)

    def for_subject(self, subject: str) -> RewardFunction:
        """Return the reward of another subject, such as another agent, by the same rules.

        It has the coefficients and parameters of this one: set in either, they are set in both.
        Conclusions are of one subject, so each must draw its own.

        Args:
            subject: a constant, the entity whose conclusions make the reward.

        Raises:
            UsageError: it is no constant.
        """
        expect(subject, str, "the subject", "give the name of an entity")
        if not is_name(subject) or is_variable(subject):
            raise UsageError(
                f"the subject '{subject}' is not a constant",
                name=subject,
                suggestion="a constant begins with a lower-case letter, such as ego",
            )
        kb = replace(self.kb, subject=subject)
        other = RewardFunction(
            kb, engine=self._engine_name, work_limit=self._engine.program.work_limit
        )
        other.coefficients, other.parameters = self.coefficients, self.parameters
        return other

    def apply_schedules(
        self, *, steps: int | None = None, episodes: int | None = None
    ) -> dict[str, float]:
        """Set every number that the knowledge base schedules to its value in a training.

        Until this is called, and wherever nobody is trained, the file's own numbers count. It
        depends on nothing that was set before, so a training that is resumed calls it with all
        steps since its beginning.

        Args:
            steps: how many steps were taken, over all environments.
            episodes: how many episodes have ended, likewise; either may be left out if no schedule
                counts it.

        Returns:
            The name of each number, as the file has it → its value.

        Raises:
            UsageError: something that is counted is not given, or is no number from 0 up.

        Example:
            >>> from dataclasses import replace
            >>> from sfol.knowledge_base import ScheduledNumber
            >>> grows = ScheduledNumber("weights", "safety", "safe2", 0.0, 1.0, over=100_000)
            >>> kb = replace(KnowledgeBase.load("aeb"), schedules={"weights.safety.safe2": grows})
            >>> RewardFunction(kb).apply_schedules(steps=25_000)
            {'weights.safety.safe2': 0.25}
        """
        counted = {scheduled.by for scheduled in self.kb.schedules.values()}
        values = values_at(
            self.kb.schedules,
            _count("steps", steps, needed="steps" in counted),
            _count("episodes", episodes, needed="episodes" in counted),
        )
        for target, value in values.items():
            scheduled = self.kb.schedules[target]
            groups = self.coefficients if scheduled.section == "weights" else self.parameters
            groups[scheduled.group][scheduled.name] = value
        return values

    def facts(self) -> Facts:
        """Return an empty set of facts with the knowledge base's margin."""
        return Facts(margin=self.kb.grounding.margin)

    def __call__(self, facts: Facts, /, **signals: float) -> float:
        """Return the reward alone; see `evaluate`."""
        return self.evaluate(facts, **signals).reward

    def observe(self, observation: Observation) -> Facts:
        """Return the facts that the knowledge base reads off an observation.

        Args:
            observation: what the environment gives, in the form that the section `observation`
                says: mappings, sequences and arrays of real numbers, nested in any way.

        Raises:
            FactError: it has another form, a number that is read is NaN, or the confidence of a
                fact is not from 0 to 1.
            UsageError: the knowledge base has rules, but does not say how facts are read.
        """
        return self._reader.facts(observation)

    def observe_signals(  # noqa: PLR0913, PLR0917 (what env.step returns, in its order)
        self,
        observation: Observation,
        action: Observation = None,
        next_observation: Observation = None,
        native: Observation = None,
        terminated: Observation = None,
        truncated: Observation = None,
        /,
        **given: float,
    ) -> dict[str, float]:
        """Return the signals that the knowledge base reads off a transition, and those given.

        Args:
            observation: before the action, as for `observe`.
            action: if a signal reads it.
            next_observation: after the action, if a signal reads it.
            native: the environment's own reward, if a signal reads it.
            terminated: whether the step terminated the episode, if a signal reads it.
            truncated: whether the episode was truncated after it, if a signal reads it.
            given: signals by name, which are not read then.

        Raises:
            SignalError: something that is read is not given or has another form than the knowledge
                base says, or a number that is read, or a signal, is NaN.
        """
        step = ObservedStep(observation, action, next_observation, native, terminated, truncated)
        return self._signals_of(step, given)

    def _signals_of(self, step: ObservedStep, given: Mapping[str, float]) -> dict[str, float]:
        read = self._reader.signals(step, but=given)
        return {**read, **given}

    def transition(  # noqa: PLR0913, PLR0917 (as above)
        self,
        observation: Observation,
        action: Observation = None,
        next_observation: Observation = None,
        native: Observation = None,
        terminated: Observation = None,
        truncated: Observation = None,
        /,
        **signals: Array,
    ) -> Outcome | BatchOutcome:
        """Return the reward of a transition, with facts and signals read off its observations.

        Facts are read off the observation before the action, or off the next one if the knowledge
        base says `facts_at: next`. Arguments are in the order of what ``env.step`` returns:
        ``reward.transition(observation, action, *env.step(action)[:4])``.

        Args:
            observation: before the action, as for `observe`; or of B scenes, with arrays or torch
                tensors that have an axis B before all others.
            action: if a signal reads it; of each scene.
            next_observation: after the action, if facts or a signal are read off it; of each scene.
            native: the environment's own reward, if a signal reads it; of each scene.
            terminated: whether the step terminated the episode, likewise.
            truncated: whether the episode was truncated after it, likewise.
            signals: those that the knowledge base does not read, as for `evaluate`; a signal that
                it would read may be given, too, and is not read then.

        Returns:
            An `Outcome`, or a `BatchOutcome` for B scenes; gradients go through tensors.

        Raises:
            The errors of `observe`, `observe_signals` and `evaluate`.
        """
        step = ObservedStep(observation, action, next_observation, native, terminated, truncated)
        if self._scenes_reader.has_many(step):
            return self._of_scenes(step, signals)
        facts = self.observe(read_for_facts(self.kb, step))
        return self.evaluate(facts, **self._signals_of(step, signals))

    def transitions(  # noqa: PLR0913, PLR0917 (as above)
        self,
        observation: Observation,
        action: Observation = None,
        next_observation: Observation = None,
        native: Observation = None,
        terminated: Observation = None,
        truncated: Observation = None,
        /,
        **signals: Array,
    ) -> BatchOutcome:
        """Return the rewards of B transitions, also where B is 1 and `transition` can't tell.

        Args and errors are those of `transition`.
        """
        step = ObservedStep(observation, action, next_observation, native, terminated, truncated)
        return self._of_scenes(step, signals)

    def on_tensors(  # noqa: PLR0913, PLR0917 (as above)
        self,
        observation: Observation,
        action: Observation = None,
        next_observation: Observation = None,
        native: Observation = None,
        terminated: Observation = None,
        truncated: Observation = None,
        /,
    ) -> TensorReward:
        """Return what `transitions` does as one function of torch tensors, to compile or to map.

        It checks nothing and raises nothing: a step for which `transitions` would has a reward of
        NaN. It computes in float64, and has the numbers of rules and formulas as they are now.

        Args:
            observation: of steps that show the form of all others, arrays or tensors with an axis B
                before all others, as for `transitions`; so are the rest.
            action: likewise.
            next_observation: likewise.
            native: likewise.
            terminated: likewise.
            truncated: likewise.

        Returns:
            A function of the same arguments, see `sfol.tensor_reward.TensorReward`.

        Raises:
            UsageError: what would be done depends on more than the form, or is too much for this.
            The errors of `transitions`, for the first of the steps.

        Example:
            >>> import torch
            >>> reward = RewardFunction("cartpole")
            >>> graph = torch.compile(reward.on_tensors(torch.zeros(1, 4)), fullgraph=True)
        """
        for head in self._engine.program.recursive:
            raise UsageError(
                f"'{head}' depends on itself, and how many rounds it takes to conclude it is not "
                "known before: that is no graph",
                name=head,
                suggestion="let rules conclude it that do not read it, or call `transitions`",
            )
        step = (observation, action, next_observation, native, terminated, truncated)
        first = [first_of(part) for part in step]
        self.transitions(*first)  # which says what is wrong, if anything is
        recording = record(self._wanted, first, of_one=False)
        if recording is None:
            raise UsageError(
                f"what '{self.kb.name}' does to an observation is too much for one graph",
                name=self.kb.name,
                suggestion="fewer entities in the tables of the observation, or `transitions`",
            )
        return TensorReward(recording, [*self.kb.terms], [*self.kb.weights], self.subject_heads)

    def batch(self, scenes: Sequence[Facts]) -> Batch:
        """Encode many scenes at once, to evaluate them many times.

        Args:
            scenes: the facts of each; they are copied.

        Raises:
            FactError: a fact does not fit the knowledge base.
        """
        listed_scenes = [
            _facts(facts) for facts in listed(scenes, "the scenes", "give a list of sfol.Facts")
        ]
        self._check_has_no_memory()
        self._warn_once(name for facts in listed_scenes for name in facts.entities())
        return encode(self._engine.program, listed_scenes)

    def conclude(self, facts: Facts) -> Conclusions:
        """Return what follows from facts.

        `evaluate`, `explain` and `entity_weights` take it in place of the facts, so that several of
        them need not draw the same conclusions again.

        Args:
            facts: ground atoms with bounds; they are copied.

        Raises:
            FactError: a fact does not fit the knowledge base.
        """
        return self._conclude(_facts(facts))

    def episode(self) -> Episode:
        """Return a new episode, which remembers its steps for those that come after them.

        A knowledge base with operators over time, or with smoothed weights, is evaluated by
        episodes alone; for others they give what `evaluate` gives.

        Example:
            >>> episode = RewardFunction("aeb").episode()
            >>> facts = Facts.parse("NoCrosswalk(ego). EmptyLane(ego).")
            >>> episode.step(facts, v=6.0, v_next=6.0).weights["safety"]
            0.0
        """
        return Episode(self)

    def conclude_after(self, facts: Facts, memory: Memory) -> Conclusions:
        """Return what follows from the facts of a step, given what is remembered of those before.

        An `Episode` keeps the memory; where many are taken in turns, it can be kept elsewhere.

        Args:
            facts: ground atoms with bounds; they are copied.
            memory: of the steps before, as ``conclusions.memory`` is after each; `Memory()` before
                the first one.

        Raises:
            FactError: a fact does not fit the knowledge base.
            WorkLimitError: a rule has too many substitutions.
        """
        if not self._warned:
            self._warn_once(_facts(facts).entities())
        conclusions = self._timeline.conclude(_facts(facts), memory)
        return self._timeline.smoothed(conclusions, memory, self.weights)

    @overload
    def evaluate(self, facts: Facts | Conclusions, /, **signals: float) -> Outcome: ...

    @overload
    def evaluate(self, facts: Batch, /, **signals: Array) -> BatchOutcome: ...

    def evaluate(
        self, facts: Facts | Conclusions | Batch, /, **signals: Array
    ) -> Outcome | BatchOutcome:
        """Return the reward of a transition and everything that it was made of.

        Args:
            facts: what is known of the state before the action (of the next one, where the
                knowledge base says `facts_at: next`), or what `conclude` drew from it with the
                same knowledge base; or a batch of B scenes.
            signals: a number for each signal of the knowledge base, in its unit; those with a
                default may be left out. For a batch, numbers, or arrays or torch tensors (B,);
                one tensor among signals, bounds, coefficients or parameters makes all of the
                outcome tensors, through which gradients go. They are float64 if one of those
                tensors is, or none has real numbers, else float32; arrays are float64.

        Returns:
            An `Outcome`, or a `BatchOutcome` for a batch.

        Raises:
            FactError: a fact does not fit the knowledge base.
            SignalError: a signal is missing, unknown, NaN, or no number or array of the shape that
                is needed.
            FormulaError: a term or the reward has no finite value; the error names the term.
            UsageError: a batch was encoded for another knowledge base, or `facts` are none.
            WorkLimitError: a rule has too many substitutions in the scene.
        """
        given = self._given(signals)
        if isinstance(facts, Batch):
            return self._batch_outcome(facts, given)
        return self._outcome(self._concluded(facts), _single(given))

    def explain(self, facts: Facts | Conclusions, /, **signals: float) -> Explanation:
        """Return the proof tree of a reward: print it, or read its nodes.

        Args:
            facts: as for `evaluate`, but not a batch.
            signals: as for `evaluate`.

        Raises:
            The errors of `evaluate`.
        """
        from sfol.explain import explain  # noqa: PLC0415  (needed by few, and it imports rich)

        values = _single(self._given(signals))
        outcome = self._outcome(self._concluded(facts), values)
        return explain(self._engine, self.current(), outcome, values)

    def weights(self, facts: Facts | Conclusions) -> dict[str, float]:
        """Return the weights alone, which need no signals.

        Args:
            facts: as for `evaluate`, but not a batch.

        Returns:
            weight → w.

        Raises:
            FactError: a fact does not fit the knowledge base.
            WorkLimitError: a rule has too many substitutions in the scene.
        """
        conclusions = self._concluded(facts)
        return self._weighed(self._confidences(self._bounds(conclusions)), conclusions.memory)

    def weights_of_many(self, observation: Observation, /) -> dict[str, Array]:
        """Return the weights of B states, from facts that are read off observations of them.

        Args:
            observation: of B scenes, as for `transition`.

        Returns:
            weight → (B,).

        Raises:
            The errors of `observe`.
        """
        scenes = self._scenes_alone(observation)
        backend = scenes.backend
        confidences = self._array_confidences(self._scene_bounds(scenes), backend)
        return self._array_weights(confidences, backend.full(scenes.size, 0.0))

    def fired_of_many(self, observation: Observation, /) -> dict[str, Array]:
        """Return which rules fire in B states, as `Outcome.fired` does for one.

        Args:
            observation: of B scenes, as for `transition`.

        Returns:
            rule → bool (B,), whether it concluded something, for whichever entity.

        Raises:
            The errors of `observe`; WorkLimitError if a rule needs too large an array.
        """
        scenes = self._scenes_alone(observation)
        concluded, sizes = self._concluded_blocks(scenes)
        return self._dense.fired(concluded, scenes.backend, sizes, scenes.size)

    def _scenes_alone(self, observation: Observation) -> Scenes:
        """Read B states, and none of the signals."""
        step = ObservedStep(observation, next_observation=observation)
        given = dict.fromkeys(self.kb.signals, 0.0)
        return self._scenes_reader.read(step, given=given, numbers=self._all_numbers())

    def entity_weights(
        self, facts: Facts | Conclusions, entities: Iterable[str]
    ) -> dict[str, float]:
        """Return the descriptor's weight w_i of each entity: the first condition that holds.

        Args:
            facts: what is known of the scene, or what `conclude` drew from it; a condition may
                name heads of rules.
            entities: the names of the entities.

        Returns:
            entity → weight, 0 where no condition holds.

        Source: the paper's table of weighting factors for VSR.
        """
        tables = self._concluded(facts).tables
        entities = listed(entities, "the entities", "give a list of names")
        for entity in entities:
            expect(entity, str, "an entity", "give its name")
        return {
            entity: next(
                (weight for plan, weight in self._conditions if plan.holds(tables, [entity])),
                0.0,
            )
            for entity in entities
        }

    def __repr__(self) -> str:
        return f"<RewardFunction of {self.kb!r}, engine '{self._engine_name}'>"

    def __reduce__(self) -> tuple[object, ...]:
        # An engine is made anew from its knowledge base; numbers that were set go along.
        numbers = (dict(self._numbers(self.coefficients)), dict(self._numbers(self.parameters)))
        limit = self._engine.program.work_limit
        return _rebuild, (self.kb, self._engine_name, limit, *numbers)

    def _concluded(self, facts: Facts | Conclusions) -> Conclusions:
        if not isinstance(facts, Conclusions):
            return self._conclude(_facts(facts))
        if facts.subject != self.kb.subject:
            raise UsageError(
                f"the conclusions are those of '{facts.subject}'",
                name=facts.subject,
                suggestion=f"draw those of '{self.kb.subject}' with this reward's conclude()",
            )
        return facts

    def _conclude_first(self, facts: Facts) -> Conclusions:
        self._check_has_no_memory()
        self._warn_once(facts.entities())
        return self._engine.conclude(facts)

    def _warn_once(self, known: Iterable[str]) -> None:
        """Warn of what keeps rules from concluding anything, before the first conclusions."""
        if self._warned:
            return
        self._warned = True
        if not self.kb.has_memory:
            self._conclude = self._engine.conclude  # so that later calls cost nothing
        for silence in silences(self.kb, frozenset(known)):
            warn_of_silence(f"'{self.kb.name}': {silence.message} ({silence.suggestion})")

    def _check_has_no_memory(self) -> None:
        kb = self.kb
        if not kb.has_memory:
            return
        name = kb.timed[0].operator.name if kb.timed else next(iter(kb.smoothed))
        what = "the operator over time" if kb.timed else "the smoothed weight"
        raise UsageError(
            f"'{kb.name}' has {what} '{name}': what a step is worth depends on those before it",
            name=name,
            suggestion="let an episode take the steps in order: episode = reward.episode(), then "
            "episode.step(facts, …)",
        )

    @cached_property
    def _timeline(self) -> Timeline:
        limit = self._engine.program.work_limit
        return Timeline(self._engine, lambda kb: make_engine(self._engine_name, kb, limit))

    def _bounds(self, conclusions: Conclusions) -> dict[str, Bound | None]:
        return {head: conclusions.tables.bound(atom) for head, atom in self._head_atoms}

    def _weighed(
        self, confidences: Mapping[str, float], memory: Memory | None = None
    ) -> dict[str, float]:
        weights = {name: float(self._weight(name, confidences)) for name in self.kb.weights}
        return weights if memory is None else {**weights, **memory.weights}

    def _confidences(self, bounds: Mapping[str, Bound | None]) -> dict[str, float]:
        return {
            head: 0.0 if bound is None else self._confidence(*bound)
            for head, bound in bounds.items()
        }

    def _outcome(self, conclusions: Conclusions, signals: Mapping[str, float]) -> Outcome:
        bounds = self._bounds(conclusions)
        confidences = self._confidences(bounds)
        weights = self._weighed(confidences, conclusions.memory)
        terms = {
            name: self._term(term, weights, confidences, signals, Formula.__call__)
            for name, term in self.kb.terms.items()
        }
        return Outcome(
            reward=_total(terms),
            terms=terms,
            weights=weights,
            confidences=confidences,
            bounds=bounds,
            derived=conclusions.derived,
            conclusions=conclusions,
        )

    def _batch_outcome(self, batch: Batch, given: Mapping[str, Array]) -> BatchOutcome:
        if batch.program is not self._engine.program:
            raise UsageError(
                "the batch was made by another reward function",
                suggestion="encode the scenes with this one's batch()",
            )
        signals = {name: _column(name, value, len(batch)) for name, value in given.items()}
        backend = backend_of([batch.lower, batch.upper, *signals.values(), *self._all_numbers()])
        return self._arrays_outcome(conclude(batch, backend), signals, batch.size, backend)

    def repeated(self, step: Sequence[Observation], *, fired: bool = False) -> list[float] | None:
        """Return what one step is worth, if it can be repeated; several times as fast.

        Args:
            step: the six arguments of `transition`, some of which may be None.
            fired: whether it is wanted which rules fired, too.

        Returns:
            R, then the terms, weights and confidences of heads, in the order of an `Outcome`, and
            for each rule whether it fired; None if they can't be repeated: `transition` gives them,
            or says what is wrong.
        """
        return self._repeated_one[fired].numbers(step, self._state())

    def repeated_many(self, step: Sequence[Observation], *, fired: bool = False) -> Reals | None:
        """Return what B steps are worth, a row (B,) of an array each, as `repeated` does for one.

        Args:
            step: the six arguments of `transitions`, some of which may be None.
            fired: whether it is wanted which rules fired, too.
        """
        return self._repeated_many[fired].rows(step, self._state())

    def _wanted(
        self, step: ObservedStep, *, bounds: bool = False, fired: bool = False
    ) -> list[Array]:
        """Return what is repeated of B steps, in order."""
        outcome = self._evaluated_scenes(step)
        groups = (outcome.terms, outcome.weights, outcome.confidences)
        wanted = [outcome.reward, *(value for group in groups for value in group.values())]
        if bounds:
            wanted += [end for b in outcome.bounds.values() for end in (b.lower, b.upper, b.known)]
        if fired:
            found = self.fired_of_many(read_for_facts(self.kb, step))
            wanted += [found[rule] for rule in self.kb.rules]
        return wanted

    def _repeated_outcome(self, step: ObservedStep) -> BatchOutcome | None:
        wholes = tuple(step.wholes.values())
        values = self._repeated_outcomes.own_arrays(wholes, self._state())
        if values is None:
            return None
        rest = iter(values)
        reward, heads = next(rest), self.subject_heads
        terms, weights, confidences = (
            {name: next(rest) for name in names}
            for names in (self.kb.terms, self.kb.weights, heads)
        )
        bounds = {head: Bounds(next(rest), next(rest), next(rest)) for head in heads}
        return BatchOutcome(reward, terms, weights, confidences, bounds)

    def _state(self) -> object:
        """Return what is equal as long as no number has changed."""
        return self.coefficients.changes.count, self.parameters.changes.count

    def _of_scenes(self, step: ObservedStep, given: Mapping[str, Array]) -> BatchOutcome:
        found = None if given else self._repeated_outcome(step)
        return found or self._evaluated_scenes(step, given)

    def _evaluated_scenes(
        self, step: ObservedStep, given: Mapping[str, Array] = MappingProxyType({})
    ) -> BatchOutcome:
        scenes = self._scenes_reader.read(step, given=given, numbers=self._all_numbers())
        signals = {
            name: _column(name, value, scenes.size)
            for name, value in self._given({**scenes.signals, **given}).items()
        }
        bounds = self._scene_bounds(scenes)
        return self._arrays_outcome(bounds, signals, scenes.size, scenes.backend)

    def _scene_bounds(self, scenes: Scenes) -> dict[str, Bounds]:
        concluded, _ = self._concluded_blocks(scenes)
        return self._dense.of_subject(concluded, scenes.backend, scenes.size)

    def _concluded_blocks(self, scenes: Scenes) -> tuple[dict[Key, Bounds], dict[str, int]]:
        """Return everything that is known of scenes, and how many entities there are."""
        backend, dense = scenes.backend, self._dense
        blocks: dict[Key, Bounds] = {}
        for atom in self.kb.background:
            shape = (1,) * (len(atom.arguments) + 1)
            one = backend.full(1, 1.0).reshape(shape)
            key = (atom.predicate, dense.domains.axes(atom.arguments))
            blocks[key] = Bounds(one, one, backend.full(1, True).reshape(shape))
        for (predicate, slots), block in scenes.blocks.items():
            blocks[predicate, dense.domains.of_slots(slots)] = Bounds(*block)
        sizes = {**dense.domains.sizes, **scenes.sizes}
        return dense.conclude(blocks, backend, sizes), sizes

    @cached_property  # few reward functions are asked for many scenes at once
    def _dense(self) -> DenseProgram:
        self._check_has_no_memory()
        self._warn_once(())
        kb = self.kb
        domains = Domains.of(kb, {name: entity_names(name, s) for name, s in kb.entities.items()})
        keys = [(atom.predicate, domains.axes(atom.arguments)) for atom in kb.background]
        keys += [(name, domains.of_slots(slots)) for name, slots in self._scenes_reader.keys]
        return DenseProgram(self._engine.program, domains, keys)

    def _all_numbers(self) -> list[Array]:
        groups = (*self.coefficients.values(), *self.parameters.values())
        return [number for group in groups for number in group.plain.values()]

    def _arrays_outcome(
        self,
        bounds: Mapping[str, Bounds],
        given: Mapping[str, Array],
        size: int,
        backend: Backend,
    ) -> BatchOutcome:
        signals = {
            name: backend.real(value) if arrays.is_array(value) else value
            for name, value in given.items()
        }
        confidences = self._array_confidences(bounds, backend)
        zeros = backend.full(size, 0.0)
        weights = self._array_weights(confidences, zeros)
        terms = {
            name: zeros
            + backend.real(self._term(term, weights, confidences, signals, Formula.elementwise))
            for name, term in self.kb.terms.items()
        }
        return BatchOutcome(_total(terms, zeros), terms, weights, confidences, bounds)

    def _array_confidences(
        self, bounds: Mapping[str, Bounds], backend: Backend
    ) -> dict[str, Array]:
        return {
            head: backend.where(b.known, self._confidence(b.lower, b.upper), 0.0)
            for head, b in bounds.items()
        }

    def _array_weights(self, confidences: Mapping[str, Array], zeros: Array) -> dict[str, Array]:
        return {name: zeros + self._weight(name, confidences) for name in self.kb.weights}

    def _weight(self, name: str, confidences: Mapping[str, Array]) -> Array:
        # A head whose rules an overlay removed has no confidence and contributes nothing.
        total: Array = 0.0
        for head, coefficient in self.coefficients[name].plain.items():
            total = total + coefficient * confidences.get(head, 0.0)
        return total / self.kb.weights[name].normalizer

    def _term(
        self,
        term: RewardTerm,
        weights: Mapping[str, Array],
        confidences: Mapping[str, Array],
        signals: Mapping[str, Array],
        evaluate: Callable[[Formula, Mapping[str, Array]], Array],
    ) -> Array:
        weight = weights[term.weight] if isinstance(term.weight, str) else term.weight
        values = {**self.parameters[term.name].plain, **signals}
        for head in term.heads:
            values[head] = confidences.get(head, 0.0)
        try:
            value = weight * evaluate(term.formula, values)
        except FormulaError as error:
            raise _of_term(error, term.name) from None
        if not arrays.is_finite(value):
            raise FormulaError(
                f"the term '{term.name}' has no value: its weight {weight} times its formula is "
                "not finite",
                name=term.name,
            )
        return value

    def _given(self, given: Mapping[str, Array]) -> dict[str, Array]:
        """Return a value for every signal: the caller's, or its default."""
        known = self.kb.signals
        for name in given:
            if name not in known:
                raise SignalError(
                    f"'{name}' is no signal of '{self.kb.name}'",
                    name=name,
                    suggestion=did_you_mean(name, known),
                )
        values = {name: given.get(name, signal.default) for name, signal in known.items()}
        missing = [name for name, value in values.items() if value is None]
        if missing:
            shown = ", ".join(f"{name}=… ({known[name].unit})" for name in missing)
            raise SignalError(
                f"the signal '{missing[0]}' is missing",
                name=missing[0],
                suggestion=f"call it with {shown}",
            )
        return values

    @staticmethod
    def _numbers(groups: Mapping[str, Numbers]) -> Iterable[tuple[str, dict[str, float]]]:
        return ((name, dict(numbers)) for name, numbers in groups.items())


def _count(what: str, value: object, *, needed: bool) -> int:
    if value is None and not needed:
        return 0
    if isinstance(value, bool) or not isinstance(value, SupportsIndex) or int(value) < 0:
        raise UsageError(
            f"the {what} of the training are {value!r:.80}",
            name=what,
            suggestion=f"give how many there were, such as {what}=1000",
        )
    return int(value)


def _facts(facts: Facts) -> Facts:
    expect(facts, Facts, "a scene", "give sfol.Facts, such as Facts.parse('Vehicle(ego).')")
    return facts


def _total(terms: Mapping[str, Array], start: Array = 0.0) -> Array:
    """Return R, the sum of all terms."""
    # From left to right in every version of Python: `sum` compensates its rounding from 3.12 on.
    total = reduce(operator.add, terms.values(), start)
    if not arrays.is_finite(total):
        raise FormulaError("the sum of the terms is not finite")
    return total


def _single(signals: Mapping[str, object]) -> dict[str, float]:
    """Return the signals of one scene as Python's own numbers."""
    return {name: _number(name, value, "a number") for name, value in signals.items()}


def _column(name: str, value: Array, size: int) -> Array:
    """Return a signal of B scenes: a number, a tensor without dimensions, or an array (B,)."""
    expected = f"a number, or an array or tensor of shape ({size},)"
    if not getattr(value, "ndim", 0) and not arrays.is_differentiable(value):
        return _number(name, value, expected)
    shape = tuple(getattr(value, "shape", ()))
    if not arrays.is_array(value) or shape not in ((), (size,)) or not arrays.is_real(value):
        raise _no_signal(name, value, expected)
    if arrays.has_nan(value):
        raise SignalError(f"the signal '{name}' is NaN", name=name)
    return value


def _number(name: str, value: object, expected: str) -> float:
    number = arrays.as_float(value)
    if number is None:
        raise _no_signal(name, value, expected)
    if math.isnan(number):
        raise SignalError(f"the signal '{name}' is NaN", name=name)
    return number


def _no_signal(name: str, value: object, expected: str) -> SignalError:
    shape = getattr(value, "shape", None)
    of_shape = f" of shape {tuple(shape)}" if shape is not None else ""
    dtype = getattr(value, "dtype", None)
    of_kind = f" of {dtype}" if dtype is not None else ""
    return SignalError(
        f"the signal '{name}' is {type(value).__name__}{of_shape}{of_kind}",
        name=name,
        suggestion=f"it must be {expected}",
    )


def _floats(numbers: Mapping[str, Array]) -> dict[str, float]:
    return {name: float(number) for name, number in numbers.items()}


def _of_term(error: FormulaError, term: str) -> FormulaError:
    message = f"the term '{term}' has no value: {error.message}"
    return FormulaError(message, name=term, suggestion=error.suggestion)


def _rebuild(
    kb: KnowledgeBase,
    engine: str,
    work_limit: int,
    coefficients: Mapping[str, Mapping[str, float]],
    parameters: Mapping[str, Mapping[str, float]],
) -> RewardFunction:
    reward = RewardFunction(kb, engine=engine, work_limit=work_limit)
    for own, saved in ((reward.coefficients, coefficients), (reward.parameters, parameters)):
        for group, numbers in saved.items():
            own[group].update(numbers)
    return reward
