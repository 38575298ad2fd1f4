"""What is measured of a drive: one row for each metric of the collision test and of driving.

A metric says how its number comes of one episode, and how those of many become a summary. Results,
tables and figures ask these rows, so that a new metric is one new row.

Source: paper, section "Model Evaluation".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from env.driving.rollout import Ending
from env.evaluation.statistics import Mean, Share
from env.world import kinematics

NEAR_MISS = 2.0  # s; a smaller time to collision is a near miss (paper)
HARD_BRAKING = 3.0  # m/s²; Euro NCAP's mark

Value = float | int | bool | None  # None: the episode has none
Pooled = Share | Mean | int
Pool = Callable[[Sequence[Value], int], Pooled]


@dataclass(frozen=True)
class Course:
    """The numbers of one driven episode of n steps.

    Attributes:
        dt: length of a step, in s.
        speeds: of ego at n + 1 instants, in m/s.
        distances: d of each step, in m; infinite when nobody is in the way.
        ttcs: smallest time to collision of each step, in s; infinite when there is none.
        crosswalk_free: of each step, whether nobody was on the crosswalk at its end.
        ending: how it ended.
        info: what the environment said of the last step.
    """

    dt: float
    speeds: Sequence[float]
    distances: Sequence[float]
    ttcs: Sequence[float]
    crosswalk_free: Sequence[bool]
    ending: Ending
    info: Mapping[str, Any]

    @property
    def seconds(self) -> float:
        """How long it took."""
        return len(self.distances) * self.dt

    @property
    def accelerations(self) -> npt.NDArray[np.float64]:
        """Of each step, in m/s²."""
        return kinematics.rate(self.speeds, self.dt)


@dataclass(frozen=True)
class Metric:
    """Something that is measured of episodes.

    Attributes:
        name: in results and tables.
        unit: of its number; 1 of shares and counts.
        of: the number of one episode, or None where it has none.
        pool: makes a summary of the numbers of many episodes, and of all their steps.
    """

    name: str
    unit: str
    of: Callable[[Course], Value]
    pool: Pool


# How the numbers of episodes become a summary


def mean(values: Sequence[Value], steps: int) -> Mean:
    """Return the mean over the episodes that have the number."""
    return Mean.over(values)


def share(values: Sequence[Value], steps: int) -> Share:
    """Return the share of episodes of which something is true."""
    return Share.over(bool(value) for value in values)


def share_of_steps(values: Sequence[Value], steps: int) -> Share:
    """Return the share of steps; its interval takes neighbours for independent."""
    return Share.out_of(sum(int(value or 0) for value in values), steps)


def total(values: Sequence[Value], steps: int) -> int:
    """Return the sum."""
    return sum(int(value or 0) for value in values)


# How the number of an episode comes of its course


def near_miss(course: Course) -> bool:
    """Tell whether a collision was less than 2 s away, and there was none (paper)."""
    return min(course.ttcs) <= NEAR_MISS and course.ending != "collision"


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
    """Return how restless a weight is: its total variation per second, `Σ |w[k+1] − w[k]| / T`.

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


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


METRICS = (
    Metric("success", "1", lambda c: c.ending == "success", share),
    Metric("collision", "1", lambda c: c.ending == "collision", share),
    Metric("timeout", "1", lambda c: c.ending == "timeout", share),
    Metric("near_miss", "1", near_miss, share),
    Metric(
        "false_braking",
        "1",
        lambda c: false_braking(c.accelerations, c.distances, c.crosswalk_free),
        share_of_steps,
    ),
    # Over episodes with a stop for somebody.
    Metric("stopping_distance", "m", lambda c: _known(c.info["stopping_distance"]), mean),
    Metric("rms_speed", "m/s", lambda c: kinematics.rms(c.speeds), mean),
    Metric("rms_acceleration", "m/s²", lambda c: kinematics.rms(c.accelerations), mean),
    Metric(
        "rms_jerk",
        "m/s³",
        lambda c: _known(kinematics.rms(kinematics.rate(c.accelerations, c.dt))),
        mean,
    ),
    # Over episodes in which somebody was in the way; 0 on contact.
    Metric("min_ttc", "s", lambda c: _known(min(c.ttcs)), mean),
    Metric("impact_speed", "m/s", lambda c: c.info["speed"] if c.info["collision"] else None, mean),
    Metric("time_to_goal", "s", lambda c: c.seconds if c.ending == "success" else None, mean),
    # Instants at which somebody touched ego while it stood.
    Metric("contact_at_rest", "1", lambda c: int(c.info["contact_at_rest"]), total),
)
