"""What a knowledge base makes worth while, before anything is trained.

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
class Conduct:
    """A way to drive.

    Attributes:
        name: of the conduct.
        driver: who drives like that.
        ending: of the episodes that count.
    """

    name: str
    driver: str
    ending: Ending


CONDUCTS = (
    Conduct("collision", "full_throttle", "collision"),
    Conduct("standing still", "never_moves", "timeout"),
    Conduct("crawling", "crawl", "timeout"),
    Conduct("goal, carefully", "cautious", "success"),
    Conduct("goal, at once", "oracle", "success"),
)


@dataclass(frozen=True)
class Worth:
    """What a conduct is worth.

    Attributes:
        conduct: its name.
        total: mean return.
        discounted: mean discounted return.
    """

    conduct: str
    total: Mean
    discounted: Mean


def worth(conduct: Conduct, summaries: Sequence[Summary]) -> Worth:
    """Return what a conduct is worth.

    Args:
        conduct: a way to drive.
        summaries: of its driver, in any cells; only episodes with the conduct's ending count.
    """
    return Worth(
        conduct.name,
        Mean.pooled(summary.total[conduct.ending] for summary in summaries),
        Mean.pooled(summary.discounted[conduct.ending] for summary in summaries),
    )


def faults(worths: Sequence[Worth]) -> list[str]:
    """Return what is worth more than it should be; of nothing, the reward is in order.

    The order is that of the discounted returns, which are what is learned from.

    Args:
        worths: of all conducts. One without episodes says nothing.
    """
    value = {w.conduct: w.discounted.mean for w in worths if w.discounted.mean is not None}
    wrong = [("collision", "standing still")]
    for goal in ("goal, carefully", "goal, at once"):
        wrong += [("standing still", goal), ("crawling", goal)]
    return [
        f"'{less}' ({value[less]:.1f}) is worth no less than '{more}' ({value[more]:.1f})"
        for less, more in wrong
        if less in value and more in value and value[less] >= value[more]
    ]
