"""Work shared out to processes comes back in order, and whatever goes wrong comes back as well."""

import os
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from env.evaluation.parallel import cores, in_order
from sfol.errors import SfolError, SilentZeroWarning, UsageError, warn_of_silence

ROOT = Path(__file__).parents[3]


MODULES = {"torch", "stable_baselines3", "openvino", "pybullet", "env.street.crossing"}


def work(job):
    if job == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if job == "mistake":
        raise UsageError("this can't be done", name=job, suggestion="do something else")
    if job == "silent":
        warn_of_silence("no rule concludes anything")
    return 2 * job


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_the_jobs(workers):
    assert list(in_order(work, range(5), workers)) == [0, 2, 4, 6, 8]
    assert list(in_order(work, [], workers)) == []


def test_what_workers_warn_of_is_heard_once():
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("default")
        assert len(list(in_order(work, ["silent"] * 4, workers=2))) == 4
    assert [str(one.message) for one in heard] == ["no rule concludes anything"]
    assert issubclass(heard[0].category, SilentZeroWarning)


def test_a_killed_worker_is_an_error_and_no_hang():
    with pytest.raises(SfolError, match="worker process was killed") as caught:
        list(in_order(work, [1, "killed", 2, 3], workers=2))
    assert "same command goes on" in str(caught.value)


def test_a_mistake_arrives_as_it_is():
    with pytest.raises(UsageError, match="can't be done") as caught:
        list(in_order(work, [1, "mistake", 2], workers=2))
    assert caught.value.suggestion == "do something else"


PARENT = """
import os, signal
from env.evaluation.parallel import in_order
from tests.env.evaluation.test_parallel import work

if __name__ == "__main__":
    results = in_order(work, range(1000), workers=2)
    print(next(results), flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_workers_end_with_their_parent(tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    # Workers hold the pipe of standard output as well: this returns when the last of them is gone.
    done = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=120,
        check=False,
    )
    assert (done.returncode, done.stdout) == (-signal.SIGKILL, "0\n")


def test_who_stops_early_stops_the_work():
    results = in_order(work, range(1000), workers=2)
    assert next(results) == 0
    results.close()


def test_there_is_at_least_one_core():
    assert cores() >= 1


def test_workers_have_what_they_need_from_their_start(capfd):
    """Each would import it for itself, otherwise, and hold it alone."""
    names = "set(__import__('sys').modules)"
    threads = "__import__('torch').get_num_threads()"
    loaded, count = in_order(eval, [names, threads], workers=2)
    assert loaded.issuperset(MODULES)
    assert count == 1
    assert "pybullet" not in capfd.readouterr().err
