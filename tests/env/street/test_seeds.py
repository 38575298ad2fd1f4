"""Nobody is judged on episodes that were seen before."""

from itertools import pairwise

from env.evaluation.evaluate import Drive
from env.street import seeds


def test_no_two_purposes_share_a_seed():
    ranges = sorted(seeds.RANGES, key=lambda one: one.start)
    assert all(one and one.stop <= other.start for one, other in pairwise(ranges))


def test_every_seed_is_one_that_gymnasium_takes():
    assert all(one.start >= 0 and one.stop <= 2**32 for one in seeds.RANGES)


def test_what_results_were_made_with_stays():
    assert Drive.seed == seeds.FINAL_TEST.start == 10_000
    assert [one.start for one in seeds.FRAMES.values()] == [10_000_000, 20_000_000, 30_000_000]
