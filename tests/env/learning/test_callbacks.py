"""What happens between updates happens at the same steps, however often a training starts."""

from hypothesis import given
from hypothesis import strategies as st

from env.learning.callbacks import BetweenUpdates


def steps_of(rollout, interval, last, start, end):
    """Return after how many steps something is done from `start` on, before `end`."""
    done = []
    callback = BetweenUpdates(
        interval, lambda model: done.append(callback.num_timesteps), last=last
    )
    callback.model = None
    for steps in range(start, end, rollout):
        callback.num_timesteps = steps
        callback._on_rollout_start()
    return done


@given(
    rollout=st.integers(1, 50),
    interval=st.integers(1, 200),
    lengths=st.lists(st.integers(1, 20), min_size=1, max_size=8),
)
def test_intervals_do_not_begin_anew_with_a_start(rollout, interval, lengths):
    end = rollout * sum(lengths)
    found, start = [], 0
    for length in lengths:
        last = found[-1] if found else 0
        stop = start + rollout * length
        found += steps_of(rollout, interval, last, start, stop)
        start = stop
    assert found == steps_of(rollout, interval, 0, 0, end)
    assert all(
        after - before >= interval for before, after in zip([0, *found], found, strict=False)
    )
