"""What a knowledge base rewards, before anything is trained.

Whoever learns from a reward finds what pays. So collisions have to be worth less than standing
still, and standing still and crawling less than reaching the goal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from env.driving.rollout import Ending
from env.evaluation.evaluate import Summary
from env.evaluation.statistics import Mean


@dataclass(frozen=True)
class ReferenceBehaviour:
    """A way to drive.

    Attributes:
        name: of the behaviour.
        driver: who drives like that.
        ending: of the episodes that count.
    """

    name: str
    driver: str
    ending: Ending


REFERENCE_BEHAVIOURS = (
    ReferenceBehaviour("collision", "full_throttle", "collision"),
    ReferenceBehaviour("standing still", "never_moves", "timeout"),
    ReferenceBehaviour("crawling", "crawl", "timeout"),
    ReferenceBehaviour("goal, carefully", "cautious", "success"),
    ReferenceBehaviour("goal, at once", "oracle", "success"),
)


@dataclass(frozen=True)
class BehaviourReturn:
    """What a behaviour returns.

    Attributes:
        behaviour: its name.
        total: mean return.
        discounted: mean discounted return.
    """

    behaviour: str
    total: Mean
    discounted: Mean


def return_of(behaviour: ReferenceBehaviour, summaries: Sequence[Summary]) -> BehaviourReturn:
    """Return what a behaviour is one.

    Args:
        behaviour: a way to drive.
        summaries: of its driver, in any cells; only episodes with the behaviour's ending count.
    """
    return BehaviourReturn(
        behaviour.name,
        Mean.pooled(summary.total[behaviour.ending] for summary in summaries),
        Mean.pooled(summary.discounted[behaviour.ending] for summary in summaries),
    )


def faults(returns: Sequence[BehaviourReturn]) -> list[str]:
    """Return what is worth more than it should be; of nothing, the reward is in order.

    The order is that of the discounted returns, which are what is learned from.

    Args:
        returns: of all behaviours. One without episodes says nothing.
    """
    value = {w.behaviour: w.discounted.mean for w in returns if w.discounted.mean is not None}
    wrong = [("collision", "standing still")]
    for goal in ("goal, carefully", "goal, at once"):
        wrong += [("standing still", goal), ("crawling", goal)]
    return [
        f"'{less}' ({value[less]:.1f}) is worth no less than '{more}' ({value[more]:.1f})"
        for less, more in wrong
        if less in value and more in value and value[less] >= value[more]
    ]
