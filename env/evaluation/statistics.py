"""Means and shares over many episodes, each with how many episodes it stands on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Mean:
    """A mean over those episodes that have the number.

    Attributes:
        mean: Σ x / n; None where no episode has it.
        episodes: n, how many have it.
    """

    mean: float | None
    episodes: int

    @classmethod
    def over(cls, values: Iterable[float | None]) -> Mean:
        """Return the mean of those values that are not None."""
        numbers = [value for value in values if value is not None]
        return cls(float(np.mean(numbers)) if numbers else None, len(numbers))

    @classmethod
    def pooled(cls, means: Iterable[Mean]) -> Mean:
        """Return the mean over the episodes of all these means."""
        parts = [(part.mean, part.episodes) for part in means if part.mean is not None]
        episodes = sum(count for _, count in parts)
        total = sum(mean * count for mean, count in parts)
        return cls(total / episodes if episodes else None, episodes)


@dataclass(frozen=True)
class Share:
    """How many of some trials came out in a certain way.

    Attributes:
        count: how many.
        of: of how many trials.
        share: count / of; None of no trials.
        low: lower end of Wilson's 95 % interval; 0 of no trials.
        high: its upper end; 1 of no trials.
    """

    count: int
    of: int
    share: float | None
    low: float
    high: float

    @classmethod
    def out_of(cls, count: int, trials: int) -> Share:
        """Return the share of `count` among `trials`."""
        from scipy.stats import binomtest  # noqa: PLC0415  (slow to import, and few need it)

        if not trials:
            return cls(0, 0, None, 0.0, 1.0)
        interval = binomtest(count, trials).proportion_ci(0.95, method="wilson")
        return cls(count, trials, count / trials, float(interval.low), float(interval.high))

    @classmethod
    def over(cls, flags: Iterable[bool]) -> Share:
        """Return the share of those flags that are set."""
        flags = list(flags)
        return cls.out_of(sum(flags), len(flags))
