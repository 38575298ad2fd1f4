"""The formulas, on cases that can be worked out by hand, and by their laws."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from env.evaluation import metrics
from env.evaluation.statistics import Mean, Share
from env.world import kinematics
from env.world.kinematics import stopping_distance

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


def test_rms_by_hand_and_of_nothing():
    assert kinematics.rms([3.0, -4.0]) == pytest.approx(math.sqrt(12.5))
    assert math.isnan(kinematics.rms([]))


def test_acceleration_and_jerk_are_rates():
    speeds = [0.0, 0.2, 0.6, 0.6]
    accelerations = kinematics.rate(speeds, 0.1)
    assert accelerations == pytest.approx([2.0, 4.0, 0.0])
    assert kinematics.rate(accelerations, 0.1) == pytest.approx([20.0, -40.0])
    assert kinematics.rate([1.0], 0.1).size == 0


@pytest.mark.parametrize(
    ("acceleration", "distance", "crosswalk_free", "counts"),
    [
        (-3.1, math.inf, True, 1),
        (-2.9, math.inf, True, 0),  # gently
        (3.1, math.inf, True, 0),  # that is throttle
        (-8.0, 40.0, True, 0),  # somebody is, or will be, in the way
        (-8.0, math.inf, False, 0),  # somebody is on the crosswalk
    ],
)
def test_false_braking_is_hard_and_for_nobody(acceleration, distance, crosswalk_free, counts):
    assert metrics.false_braking([acceleration], [distance], [crosswalk_free]) == counts


def test_false_braking_of_no_steps_is_none():
    assert metrics.false_braking([], [], []) == 0


def test_fluctuation_is_total_variation_per_second():
    assert metrics.fluctuation([0.0, 1.0, 0.5, 0.5], dt=0.5) == pytest.approx(0.75)
    assert metrics.fluctuation([0.3], dt=0.1) == 0.0
    assert math.isnan(metrics.fluctuation([], dt=0.1))


def test_a_discounted_return_by_hand():
    assert metrics.discounted_return([1.0, 2.0, 4.0], 0.5) == pytest.approx(3.0)
    assert metrics.discounted_return([1.0, 2.0, 4.0], 1.0) == pytest.approx(7.0)
    assert metrics.discounted_return([], 0.5) == 0.0


def test_a_mean_leaves_out_who_has_no_number():
    assert Mean.over([1.0, None, 3.0]) == Mean(2.0, 2)
    assert Mean.over([None]) == Mean(None, 0)


@given(st.lists(st.lists(st.none() | st.floats(-1e3, 1e3), max_size=5), max_size=5))
def test_pooled_means_are_the_mean_over_all(groups):
    pooled = Mean.pooled(map(Mean.over, groups))
    together = Mean.over(value for group in groups for value in group)
    assert pooled.episodes == together.episodes
    assert pooled.mean == pytest.approx(together.mean, abs=1e-6)


@given(st.integers(1, 1000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_intervals_are_wilson_s(trial):
    """(p̂ + z²/2n ± z √(p̂(1−p̂)/n + z²/4n²)) / (1 + z²/n) (Wilson, 1927)."""
    count, n = trial
    share = Share.out_of(count, n)
    p, z = count / n, 1.959963984540054
    middle = p + z**2 / (2 * n)
    half = z * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    scale = 1 + z**2 / n
    assert share.share == p
    assert share.low == pytest.approx((middle - half) / scale, abs=1e-9)
    assert share.high == pytest.approx((middle + half) / scale, abs=1e-9)


def test_a_share_of_nothing_says_nothing():
    assert Share.over([]) == Share(0, 0, None, 0.0, 1.0)
    assert Share.over([True, False, True]).count == 2
