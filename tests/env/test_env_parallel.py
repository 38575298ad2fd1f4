"""Work shared out to processes comes back in order, and whatever goes wrong comes back as well."""

import os
import signal

import pytest

from env.parallel import cores, in_order
from sfol.errors import SfolError, UsageError


def work(job):
    if job == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if job == "mistake":
        raise UsageError("this can't be done", name=job, suggestion="do something else")
    return 2 * job


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_the_jobs(workers):
    assert list(in_order(work, range(5), workers)) == [0, 2, 4, 6, 8]
    assert list(in_order(work, [], workers)) == []


def test_a_killed_worker_is_an_error_and_no_hang():
    with pytest.raises(SfolError, match="worker process was killed") as caught:
        list(in_order(work, [1, "killed", 2, 3], workers=2))
    assert "same command goes on" in str(caught.value)


def test_a_mistake_arrives_as_it_is():
    with pytest.raises(UsageError, match="can't be done") as caught:
        list(in_order(work, [1, "mistake", 2], workers=2))
    assert caught.value.suggestion == "do something else"


def test_who_stops_early_stops_the_work():
    results = in_order(work, range(1000), workers=2)
    assert next(results) == 0
    results.close()


def test_there_is_at_least_one_core():
    assert cores() >= 1
