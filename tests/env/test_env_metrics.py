"""The formulas, on cases that can be worked out by hand."""

import math

import numpy as np
import pytest

from env.metrics import stopping_distance, time_to_collision


def test_time_to_collision_is_gap_over_closing_speed():
    times = time_to_collision([10.0, 10.0, 10.0, -1.0, 0.0], [5.0, 0.0, -2.0, 5.0, 5.0])
    assert times.tolist() == [2.0, math.inf, math.inf, math.inf, 0.0]


def test_time_to_collision_broadcasts():
    assert time_to_collision(np.ones((3, 2)), [1.0, 2.0]).tolist() == [[1.0, 0.5]] * 3
    assert time_to_collision([], 1.0).shape == (0,)


DRIVE, STOP = [5.0] * 5, [0.0] * 12


@pytest.mark.parametrize(
    ("speeds", "distances", "expected"),
    [
        (DRIVE + STOP, [9.0] * 5 + [3.0] * 12, 3.0),
        (STOP + DRIVE, [3.0] * 17, math.nan),  # standing at the start is no stop
        (DRIVE + STOP[:5] + DRIVE, [3.0] * 15, math.nan),  # too short
        (DRIVE + STOP, [math.inf] * 17, math.nan),  # for nobody
        (DRIVE + STOP + DRIVE + STOP, [math.inf] * 17 + [2.0] * 17, 2.0),
        (DRIVE + STOP + DRIVE + STOP, [4.0] * 17 + [2.0] * 17, 4.0),  # the first counts
        ([], [], math.nan),
    ],
)
def test_stopping_distance_is_that_of_the_first_stop_for_somebody(speeds, distances, expected):
    assert stopping_distance(speeds, distances, dt=0.1) == pytest.approx(expected, nan_ok=True)
