"""The reward: facts and signals in, one number out, with everything that it was made of."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, overload

from sfol import arrays
from sfol.arrays import Array, backend_of
from sfol.engines.batch import Batch, encode
from sfol.engines.batched import conclude
from sfol.engines.conclusions import Conclusions
from sfol.engines.engine import Engine, make_engine
from sfol.engines.matching import condition_criterion
from sfol.engines.plan import Plan
from sfol.errors import FormulaError, SignalError, UsageError, did_you_mean
from sfol.facts import Facts
from sfol.formula import Formula
from sfol.knowledge_base import KnowledgeBase, RewardTerm
from sfol.operators import CONFIDENCES
from sfol.outcome import BatchOutcome, Outcome
from sfol.syntax import Atom

if TYPE_CHECKING:
    from sfol.explain import Explanation


class Numbers(dict[str, float]):
    """Numbers by name that can be set but not added or removed.

    A number may be a torch tensor without dimensions, to learn it from the rewards of a batch.

    Args:
        numbers: name → number.
        what: what the names are, for error messages.
    """

    def __init__(self, numbers: Mapping[str, float], what: str) -> None:
        super().__init__(numbers)
        self._what = what

    def __setitem__(self, name: str, number: float) -> None:
        if name not in self:
            raise UsageError(
                f"{self._what} has no '{name}'", name=name, suggestion=did_you_mean(name, self)
            )
        if arrays.is_differentiable(number):  # so that gradients reach it
            super().__setitem__(name, number)
            return
        if not float("-inf") < number < float("inf"):
            raise UsageError(f"'{name}' can't be {number}", name=name)
        super().__setitem__(name, float(number))


class RewardFunction:
    """A knowledge base as a callable: the reward of a step from its facts and signals.

    Args:
        kb: a knowledge base, the path of one, or the name of a bundled one.
        engine: ``compiled``, or ``pyreason``, the much slower reference (extra `pyreason`); batches
            are evaluated by arithmetic of their own, whichever it is.

    Attributes:
        kb: the knowledge base.
        coefficients: weight → head → coefficient (the paper's α, β); may be set at any time.
        parameters: term → parameter → number; may be set at any time.

    Raises:
        InvalidKnowledgeBase: the file has errors.
        UsageError: there is no such engine.

    Example:
        >>> reward = RewardFunction("aeb")
        >>> facts = Facts.parse("NoCrosswalk(ego). EmptyLane(ego).")
        >>> reward(facts, v=6.0, v_next=6.0)
        1.0
    """

    def __init__(self, kb: KnowledgeBase | str | Path, *, engine: str = "compiled") -> None:
        self.kb = kb if isinstance(kb, KnowledgeBase) else KnowledgeBase.load(kb)
        self._engine_name = engine
        self._engine: Engine = make_engine(engine, self.kb)
        self.coefficients: dict[str, Numbers] = {
            name: Numbers(weight.coefficients, f"the weight '{name}'")
            for name, weight in self.kb.weights.items()
        }
        self.parameters: dict[str, Numbers] = {
            name: Numbers(term.parameters, f"the term '{name}'")
            for name, term in self.kb.terms.items()
        }
        self._head_atoms = [
            (head, Atom(head, (self.kb.subject,))) for head in self._engine.program.subject_heads
        ]
        self._confidence = CONFIDENCES[self.kb.semantics.confidence]
        self._conditions = [
            (Plan.of(c.when, condition_criterion(c), given=["X"]), c.weight)
            for c in self.kb.entity_weights
        ]

    @property
    def engine(self) -> Engine:
        """The engine that draws the conclusions."""
        return self._engine

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

    def facts(self) -> Facts:
        """Return an empty set of facts with the knowledge base's margin."""
        return Facts(margin=self.kb.grounding.margin)

    def __call__(self, facts: Facts, **signals: float) -> float:
        """Return the reward alone; see `evaluate`."""
        return self.evaluate(facts, **signals).reward

    def batch(self, scenes: Sequence[Facts]) -> Batch:
        """Encode many scenes at once, to evaluate them many times.

        Args:
            scenes: the facts of each; they are copied.

        Raises:
            FactError: a fact does not fit the knowledge base.
        """
        return encode(self._engine.program, scenes)

    def conclude(self, facts: Facts) -> Conclusions:
        """Return what follows from facts.

        `evaluate`, `explain` and `entity_weights` take it in place of the facts, so that several of
        them need not draw the same conclusions again.

        Args:
            facts: ground atoms with bounds; they are copied.

        Raises:
            FactError: a fact does not fit the knowledge base.
        """
        return self._engine.conclude(facts)

    @overload
    def evaluate(self, facts: Facts | Conclusions, **signals: float) -> Outcome: ...

    @overload
    def evaluate(self, facts: Batch, **signals: Array) -> BatchOutcome: ...

    def evaluate(
        self, facts: Facts | Conclusions | Batch, **signals: Array
    ) -> Outcome | BatchOutcome:
        """Return the reward of a transition and everything that it was made of.

        Args:
            facts: what is known of the state before the action, or what `conclude` drew from it
                with the same knowledge base; or a batch of B scenes.
            signals: a number for each signal of the knowledge base, in its unit; those with a
                default may be left out. For a batch, numbers, or arrays or torch tensors (B,);
                one tensor among signals, bounds, coefficients or parameters makes all of the
                outcome tensors of its type, through which gradients go.

        Returns:
            An `Outcome`, or a `BatchOutcome` for a batch.

        Raises:
            FactError: a fact does not fit the knowledge base.
            SignalError: a signal is missing, unknown or NaN.
            FormulaError: a term has no value; the error names it.
            UsageError: a batch was encoded for another knowledge base.
        """
        values = self._signals(signals)
        if isinstance(facts, Batch):
            return self._batch_outcome(facts, values)
        return self._outcome(self._concluded(facts), values)

    def explain(self, facts: Facts | Conclusions, **signals: float) -> Explanation:
        """Return the proof tree of a reward: print it, or read its nodes.

        Args:
            facts: as for `evaluate`, but not a batch.
            signals: as for `evaluate`.

        Raises:
            The errors of `evaluate`.
        """
        from sfol.explain import explain  # noqa: PLC0415  (needed by few, and it imports rich)

        values = self._signals(signals)
        outcome = self._outcome(self._concluded(facts), values)
        return explain(self._engine, self.current(), outcome, values)

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
        return {
            entity: next(
                (
                    weight
                    for plan, weight in self._conditions
                    if plan.substitutions(tables, [entity])
                ),
                0.0,
            )
            for entity in entities
        }

    def __repr__(self) -> str:
        return f"<RewardFunction of {self.kb!r}, engine '{self._engine_name}'>"

    def __reduce__(self) -> tuple[object, ...]:
        # An engine is made anew from its knowledge base; numbers that were set go along.
        numbers = (dict(self._numbers(self.coefficients)), dict(self._numbers(self.parameters)))
        return _rebuild, (self.kb, self._engine_name, *numbers)

    def _concluded(self, facts: Facts | Conclusions) -> Conclusions:
        return facts if isinstance(facts, Conclusions) else self._engine.conclude(facts)

    def _outcome(self, conclusions: Conclusions, signals: Mapping[str, float]) -> Outcome:
        bounds = {head: conclusions.tables.bound(atom) for head, atom in self._head_atoms}
        confidences = {
            head: 0.0 if bound is None else self._confidence(*bound)
            for head, bound in bounds.items()
        }
        weights = {name: self._weight(name, confidences) for name in self.kb.weights}
        terms = {
            name: self._term(term, weights, signals, Formula.__call__)
            for name, term in self.kb.terms.items()
        }
        return Outcome(
            reward=sum(terms.values()),
            terms=terms,
            weights=weights,
            confidences=confidences,
            bounds=bounds,
            derived=conclusions.derived,
            conclusions=conclusions,
        )

    def _batch_outcome(self, batch: Batch, signals: Mapping[str, Array]) -> BatchOutcome:
        if batch.program is not self._engine.program:
            raise UsageError(
                "the batch was made by another reward function",
                suggestion="encode the scenes with this one's batch()",
            )
        groups = (*self.coefficients.values(), *self.parameters.values())
        numbers = [number for group in groups for number in group.values()]
        backend = backend_of([batch.lower, batch.upper, *signals.values(), *numbers])
        signals = {
            name: backend.array(value) if arrays.is_array(value) else value
            for name, value in signals.items()
        }
        bounds = conclude(batch, backend)
        confidences = {
            head: backend.where(b.known, self._confidence(b.lower, b.upper), 0.0)
            for head, b in bounds.items()
        }
        zeros = backend.full(batch.size, 0.0)
        weights = {name: zeros + self._weight(name, confidences) for name in self.kb.weights}
        terms = {
            name: zeros + self._term(term, weights, signals, Formula.elementwise)
            for name, term in self.kb.terms.items()
        }
        return BatchOutcome(sum(terms.values(), zeros), terms, weights, confidences, bounds)

    def _weight(self, name: str, confidences: Mapping[str, Array]) -> Array:
        # A head whose rules an overlay removed has no confidence and contributes nothing.
        total = sum(c * confidences.get(head, 0.0) for head, c in self.coefficients[name].items())
        return total / self.kb.weights[name].normalizer

    def _term(
        self,
        term: RewardTerm,
        weights: Mapping[str, Array],
        signals: Mapping[str, Array],
        evaluate: Callable[[Formula, Mapping[str, Array]], Array],
    ) -> Array:
        weight = weights[term.weight] if isinstance(term.weight, str) else term.weight
        try:
            value = weight * evaluate(term.formula, {**self.parameters[term.name], **signals})
        except FormulaError as error:
            raise _of_term(error, term.name) from None
        if arrays.has_nan(value):
            raise FormulaError(
                f"the term '{term.name}' is NaN: its weight {weight} times an infinite formula",
                name=term.name,
            )
        return value

    def _signals(self, given: Mapping[str, Array]) -> dict[str, Array]:
        known = self.kb.signals
        for name, value in given.items():
            if name not in known:
                raise SignalError(
                    f"'{name}' is no signal of '{self.kb.name}'",
                    name=name,
                    suggestion=did_you_mean(name, known),
                )
            if arrays.has_nan(value):
                raise SignalError(f"the signal '{name}' is NaN", name=name)
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


def _floats(numbers: Mapping[str, Array]) -> dict[str, float]:
    return {name: float(number) for name, number in numbers.items()}


def _of_term(error: FormulaError, term: str) -> FormulaError:
    message = f"the term '{term}' has no value: {error.message}"
    return FormulaError(message, name=term, suggestion=error.suggestion)


def _rebuild(
    kb: KnowledgeBase,
    engine: str,
    coefficients: Mapping[str, Mapping[str, float]],
    parameters: Mapping[str, Mapping[str, float]],
) -> RewardFunction:
    reward = RewardFunction(kb, engine=engine)
    for own, saved in ((reward.coefficients, coefficients), (reward.parameters, parameters)):
        for group, numbers in saved.items():
            for name, number in numbers.items():
                own[group][name] = number
    return reward
