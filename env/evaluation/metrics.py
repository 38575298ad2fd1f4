"""Formulas of the collision test and of the driving characteristics, as pure functions.

Every function says what it returns where there is nothing to measure. Numbers of an episode that
has none are nan or infinite; in summaries None stands for that.

Source: paper, section "Model Evaluation".
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

NEAR_MISS = 2.0  # s; a smaller time to collision is a near miss (paper)
HARD_BRAKING = 3.0  # m/s²; Euro NCAP's mark


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
