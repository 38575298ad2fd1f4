"""Work shared out to processes, with the results in the order of the jobs."""

from __future__ import annotations

import os
import signal
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing import get_all_start_methods, get_context, parent_process
from typing import Any, TypeVar

from sfol.errors import SfolError
from vsr.threads import one_thread

Job = TypeVar("Job")
Result = TypeVar("Result")
_Warning = tuple[str, type[Warning], str, int]  # text, category, and the place that it is about
_warned: dict[Any, Any] = {}  # where Python notes what was said, to say it once


def in_order(work: Callable[[Job], Result], jobs: Sequence[Job], workers: int) -> Iterator[Result]:
    """Yield what comes of every job, in the order of the jobs.

    Args:
        work: does a job; a function of a module, so that another process finds it.
        jobs: what is to be done.
        workers: how many processes; 1 is this one, which also gives the warnings of the others.

    Raises:
        SfolError: a process was killed.
    """
    if workers == 1:
        with one_thread():
            yield from map(work, jobs)
        return
    pool = ProcessPoolExecutor(
        min(workers, len(jobs)) or 1, mp_context=get_context(start_method()), initializer=_settle
    )
    try:
        for result, heard in pool.map(partial(_heard, work), jobs):
            for warning in heard:
                warnings.warn_explicit(*warning, registry=_warned)
            yield result
    except BrokenProcessPool:
        raise SfolError(
            "a worker process was killed, most likely because memory ran out",
            suggestion="fewer --workers; what is finished is kept, so the same command goes on",
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _heard(work: Callable[[Job], Result], job: Job) -> tuple[Result, list[_Warning]]:
    """Return what comes of a job, and what it warned of: many workers would say the same."""
    with warnings.catch_warnings(record=True) as heard:
        result = work(job)
    return result, [(str(w.message), w.category, w.filename, w.lineno) for w in heard]


def start_method() -> str:
    """Return how worker processes are started, by the name that multiprocessing has for it.

    They are forked from a server that has imported what they need and done nothing with it: what a
    process inherits of pybullet and torch at work can hang. They start in a second and share the
    server's memory. Where there is no such server, each is a new process with its own.
    """
    if "forkserver" not in get_all_start_methods():
        return "spawn"
    get_context("forkserver").set_forkserver_preload(["env.evaluation.worker_imports"])
    return "forkserver"


def cores() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _settle() -> None:
    """Make a process a quiet worker of one thread; the parent alone hears the keyboard."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    import env.evaluation.worker_imports  # noqa: F401, PLC0415 (here, after a spawn)


def _end_with_parent() -> None:
    """End this process when its parent is gone; it would wait for jobs for ever."""
    parent = parent_process()
    assert parent is not None  # a worker has one
    parent.join()
    os._exit(1)
