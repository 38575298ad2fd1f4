"""Recorded episodes under a knowledge base: what the same drives would have been worth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from sfol.errors import FormulaError, SfolError, SignalError
from sfol.facts import Facts
from sfol.knowledge_base import KnowledgeBase
from sfol.logs import Log, LoggedEpisode, LoggedStep
from sfol.outcome import Outcome
from sfol.reward import RewardFunction


@dataclass(frozen=True)
class ReplayedEpisode:
    """A recorded episode with what a knowledge base makes of it.

    Attributes:
        episode: what was recorded.
        outcomes: one for each step.
    """

    episode: LoggedEpisode
    outcomes: tuple[Outcome, ...]

    @property
    def value(self) -> float:
        """The return, which is the sum of the rewards."""
        return sum(outcome.reward for outcome in self.outcomes)


def replay(log: Log, kb: KnowledgeBase) -> tuple[ReplayedEpisode, ...]:
    """Evaluate every step of a log under a knowledge base.

    Predicates and signals that it does not know are left out; see `unknown_names`.

    Args:
        log: the recorded episodes.
        kb: any knowledge base, not only that of the recording.

    Raises:
        SfolError: a step has no reward, as where a signal is missing; the error says which step.
    """
    reward = RewardFunction(kb)
    return tuple(
        ReplayedEpisode(
            episode,
            tuple(
                _evaluate(reward, step, f"episode {episode.number}, step {index}")
                for index, step in enumerate(episode.steps)
            ),
        )
        for episode in log.episodes
    )


def unknown_names(log: Log, kb: KnowledgeBase) -> tuple[str, ...]:
    """Return the predicates and signals of a log that a knowledge base does not know."""
    steps = [step for episode in log.episodes for step in episode.steps]
    predicates = {name for step in steps for name in step.facts.predicates()}
    signals = {name for step in steps for name in step.signals}
    return (*sorted(predicates - kb.predicates.keys()), *sorted(signals - kb.signals.keys()))


def known(step: LoggedStep, kb: KnowledgeBase) -> tuple[Facts, Mapping[str, float]]:
    """Return the facts and signals of a step that a knowledge base knows."""
    facts = step.facts
    if not set(facts.predicates()) <= kb.predicates.keys():
        facts = Facts(margin=facts.margin)
        for atom, bound in step.facts.items():
            if atom.predicate in kb.predicates:
                facts.add(atom.predicate, *atom.arguments, bound=bound)
    return facts, {name: value for name, value in step.signals.items() if name in kb.signals}


def _evaluate(reward: RewardFunction, step: LoggedStep, where: str) -> Outcome:
    facts, signals = known(step, reward.kb)
    try:
        return reward.evaluate(facts, **signals)
    except (SignalError, FormulaError) as error:
        raise SfolError(
            f"{where} under '{reward.kb.name}': {error.message}",
            name=error.name,
            suggestion="record it, or give the signal a default"
            if isinstance(error, SignalError)
            else error.suggestion,
        ) from None
