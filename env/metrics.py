"""Formulas of the collision test and of the driving characteristics, as pure functions.

Every function says what it returns where there is nothing to measure. Numbers of an episode that
has none are nan or infinite; in summaries None stands for that.

Source: paper, section "Model Evaluation".
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

STANDSTILL = 0.1  # m/s; slower than this is standing
NEAR_MISS = 2.0  # s; a smaller time to collision is a near miss (paper)
HARD_BRAKING = 3.0  # m/s²; Euro NCAP's mark
# γ of a return. With 0.99, 10 s count, and a quick collision was worth more than standing still.
DISCOUNT = 0.997


# Of one episode


def time_to_collision(gaps: npt.ArrayLike, closing_speeds: npt.ArrayLike) -> Array:
    """Return the time until a gap closes: gap / closing speed.

    Args:
        gaps: in m; broadcast with the speeds.
        closing_speeds: in m/s.

    Returns:
        In s; infinite where nothing closes: at rest, when moving apart, and for what is passed
        already (gap < 0).
    """
    gaps, speeds = np.asarray(gaps, float), np.asarray(closing_speeds, float)
    closes = (speeds > 0.0) & (gaps >= 0.0)
    times: Array = np.full(closes.shape, np.inf)
    return np.divide(gaps, speeds, out=times, where=closes)


def stopping_distance(
    speeds: npt.ArrayLike, distances: npt.ArrayLike, dt: float, hold: float = 1.0
) -> float:
    """Return how far before a pedestrian ego first came to stand.

    The distance d at the first instant of the first standstill (v < 0.1 m/s throughout `hold`)
    that follows a drive and has a pedestrian in the way.

    Args:
        speeds: of ego at the end of each step, in m/s.
        distances: from its front to the nearest pedestrian in the way at these instants, in m;
            infinite when there is none.
        dt: length of a step, in s.
        hold: how long ego has to stand, in s.

    Returns:
        In m; nan when there was no such stop.
    """
    standing = np.less(speeds, STANDSTILL)
    in_the_way = np.asarray(distances, float)[1:]
    steps = max(round(hold / dt), 1)
    if standing.size <= steps:
        return float("nan")
    stays = np.lib.stride_tricks.sliding_window_view(standing[1:], steps).all(axis=1)
    stops = ~standing[:-steps] & stays & np.isfinite(in_the_way[: stays.size])
    return float(in_the_way[np.argmax(stops)]) if stops.any() else float("nan")


def rms(values: npt.ArrayLike) -> float:
    """Return the root mean square, √(Σ x² / n); nan of nothing."""
    numbers = np.asarray(values, float)
    return float(np.sqrt(np.mean(numbers**2))) if numbers.size else float("nan")


def rate(values: npt.ArrayLike, dt: float) -> Array:
    """Return how fast something changes: (x[k+1] − x[k]) / dt.

    Of speeds that is the acceleration, and of accelerations the jerk.

    Args:
        values: at n instants.
        dt: between them, in s.

    Returns:
        float (n − 1,); empty of fewer than two.
    """
    return np.diff(np.asarray(values, float)) / dt


def false_braking(
    accelerations: npt.ArrayLike, distances: npt.ArrayLike, crosswalk_free: npt.ArrayLike
) -> int:
    """Count the steps in which ego brakes hard though nothing asks for it.

    Those are the steps with a deceleration above 3 m/s² while no pedestrian is in ego's corridor or
    enters it within 4 s (d is infinite), and nobody is on the crosswalk.

    Args:
        accelerations: of each step, in m/s².
        distances: d of each step, in m.
        crosswalk_free: of each step, whether nobody was on the crosswalk.

    Returns:
        A number of steps; 0 of none.
    """
    hard = np.asarray(accelerations, float) < -HARD_BRAKING
    free = np.isinf(np.asarray(distances, float)) & np.asarray(crosswalk_free, bool)
    return int(np.count_nonzero(hard & free))


def fluctuation(weights: npt.ArrayLike, dt: float) -> float:
    """Return how restless a weight is: its total variation per second, Σ |w[k+1] − w[k]| / T.

    Args:
        weights: w of each step.
        dt: length of a step, in s.

    Returns:
        In 1/s, T being the length of the episode; 0 of one step, and nan of none.
    """
    numbers = np.asarray(weights, float)
    if not numbers.size:
        return float("nan")
    return float(np.abs(np.diff(numbers)).sum() / (numbers.size * dt))


def discounted_return(rewards: npt.ArrayLike, discount: float) -> float:
    """Return Σ γ^k r[k], k from 0; 0 of nothing. With γ = 1 it is the return itself."""
    numbers = np.asarray(rewards, float)
    return float(numbers @ discount ** np.arange(numbers.size))


# Of many episodes


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
