"""Formulas of motion, as pure functions of speeds, gaps and times.

Every function says what it returns where there is nothing to measure.

Source: paper, section "Model Evaluation".
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

STANDSTILL = 0.1  # m/s; slower than this is standing


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
