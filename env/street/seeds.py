"""The seeds of episodes, in ranges that can't meet.

A seed decides everything in an episode. So that nobody is judged on episodes that it was trained
on, or tuned by, each purpose draws from a range of its own.
"""

from __future__ import annotations

# Small numbers: the demo, tools, tests, and whatever people try by hand.
BY_HAND = range(10_000)
# The final test; nothing is ever tuned or trained on these.
FINAL_TEST = range(10_000, 10_000_000)
# Frames that networks are trained, chosen and judged by.
FRAMES = {
    "train": range(10_000_000, 20_000_000),
    "validation": range(20_000_000, 30_000_000),
    "test": range(30_000_000, 40_000_000),
}
# Policies: their training, and the evaluations by which the best one of a training is kept.
TRAINING = range(2**30, 3 * 2**29)
EVALUATION = range(3 * 2**29, 2**31)

RANGES = (BY_HAND, FINAL_TEST, *FRAMES.values(), TRAINING, EVALUATION)
