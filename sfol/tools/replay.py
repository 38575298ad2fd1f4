"""Recorded episodes under a knowledge base: what the same drives would have been worth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

from sfol.episode import Episode
from sfol.errors import FormulaError, SfolError, SignalError
from sfol.facts import Facts
from sfol.knowledge_base import KnowledgeBase
from sfol.logs import Log, LoggedEpisode, LoggedStep
from sfol.outcome import Outcome
from sfol.reward import RewardFunction

_PACE = 0.01  # of a step: recorded times are rounded


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

    Predicates and signals that it does not know are left out; see `unknown_names`. Each recorded
    episode is an episode of it, so that its rules may speak of steps that have passed.

    Args:
        log: the recorded episodes.
        kb: any knowledge base, not only that of the recording.

    Raises:
        SfolError: a step has no reward, as where a signal is missing, or another length than rules
            over time count on; the error says which step.
    """
    reward = RewardFunction(kb)
    return tuple(_replayed(reward, episode) for episode in log.episodes)


def _replayed(reward: RewardFunction, recorded: LoggedEpisode) -> ReplayedEpisode:
    if reward.kb.has_memory:
        _check_pace(reward.kb, recorded)
    episode = reward.episode()
    outcomes = tuple(
        _evaluate(episode, reward.kb, step, f"episode {recorded.number}, step {index}")
        for index, step in enumerate(recorded.steps)
    )
    return ReplayedEpisode(recorded, outcomes)


def _check_pace(kb: KnowledgeBase, recorded: LoggedEpisode) -> None:
    """Make sure that steps are as long as a knowledge base says, if it says so in seconds."""
    if kb.time is None or kb.time.unit != "s":
        return
    for index, (step, following) in enumerate(pairwise(recorded.steps)):
        apart = following.time - step.time
        if not math.isclose(apart, kb.time.step, rel_tol=_PACE):
            raise SfolError(
                f"episode {recorded.number}, step {index} took {apart:.4g} s, and a step of "
                f"'{kb.name}' takes {kb.time.step:g} s",
                name="time",
                suggestion="record every step, or set the step of the section time",
            )


def unknown_names(log: Log, kb: KnowledgeBase) -> tuple[str, ...]:
    """Return the predicates, attributes and signals of a log that a knowledge base lacks."""
    steps = [step for episode in log.episodes for step in episode.steps]
    predicates = {name for step in steps for name in step.facts.predicates()}
    attributes = {name for step in steps for name in step.facts.values()}
    signals = {name for step in steps for name in step.signals}
    return (
        *sorted(predicates - kb.predicates.keys()),
        *sorted(attributes - kb.attributes.keys()),
        *sorted(signals - kb.signals.keys()),
    )


def known(step: LoggedStep, kb: KnowledgeBase) -> tuple[Facts, Mapping[str, float]]:
    """Return the facts and signals of a step that a knowledge base knows."""
    facts = step.facts
    knows_bounds = facts.predicates() <= kb.predicates.keys()
    if not knows_bounds or not facts.values().keys() <= kb.attributes.keys():
        facts = facts.restricted(kb.predicates, kb.attributes)
    return facts, {name: value for name, value in step.signals.items() if name in kb.signals}


def _evaluate(episode: Episode, kb: KnowledgeBase, step: LoggedStep, where: str) -> Outcome:
    facts, signals = known(step, kb)
    try:
        return episode.step(facts, **signals)
    except (SignalError, FormulaError) as error:
        raise SfolError(
            f"{where} under '{kb.name}': {error.message}",
            name=error.name,
            suggestion="record it, or give the signal a default"
            if isinstance(error, SignalError)
            else error.suggestion,
        ) from None
