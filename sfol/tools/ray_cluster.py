"""Work shared out to the processes of a Ray cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from sfol.errors import SfolError, UsageError, missing_extra

Job = TypeVar("Job")
Result = TypeVar("Result")

_OWN = {"include_dashboard": False, "_node_ip_address": "127.0.0.1"}  # nobody else sees it

HELP = (
    "Share the work out to a Ray cluster: host:port, auto for the one of this machine, or local "
    "for one that ends with the work. Its machines need this software, and the same folders."
)


def on_ray(
    work: Callable[[Job], Result], jobs: Sequence[Job], address: str, *, processors: int = 1
) -> Iterator[Result]:
    """Yield what comes of every job, as soon as it is done.

    Args:
        work: does a job; it may be begun anew where a process or a machine of the cluster ends.
        jobs: what is to be done; they and what comes of them can be pickled.
        address: of the cluster, as in `HELP`.
        processors: how many a job needs.

    Raises:
        MissingExtraError: Ray is not installed.
        UsageError: there is no such cluster, or no machine in it has so many processors.
        SfolError: a job's own error, or its process ended again and again; other jobs are ended.
    """
    try:
        import ray  # noqa: PLC0415  (an extra, and slow to import)
    except ImportError:
        raise missing_extra("ray", "work on a Ray cluster needs it", extra="ray") from None
    _connect(ray, address)
    try:
        _check_room(ray, processors)
        task: Any = ray.remote(num_cpus=processors)(_do)
        shared = ray.put(work)  # sent to each machine once
        pending = [task.remote(shared, job) for job in jobs]
        while pending:
            (done,), pending = ray.wait(pending, num_returns=1)
            yield _result_of(ray, done)
    finally:
        ray.shutdown()


def _do(work: Callable[[Job], Result], job: Job) -> Result:
    return work(job)


def _connect(ray: Any, address: str) -> None:
    try:
        ray.init(address=address, **(_OWN if address == "local" else {}))
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise UsageError(
            f"no Ray cluster at '{address}': {str(error).splitlines()[0]}",
            name=address,
            suggestion="start one with `ray start --head`, or give local",
        ) from None


def _check_room(ray: Any, processors: int) -> None:
    """Refuse a job that would wait for ever."""
    most = max(node["Resources"].get("CPU", 0) for node in ray.nodes() if node["Alive"])
    if most < processors:
        raise UsageError(
            f"a job needs {processors} processors, and no machine of the cluster has more than "
            f"{most:g}",
            name=str(processors),
            suggestion="fewer streets at once, or a larger machine",
        )


def _result_of(ray: Any, reference: Any) -> Any:
    try:
        return ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, SfolError):
            raise error.cause from None
        raise
    except ray.exceptions.RayError as error:
        raise SfolError(
            f"a process of the cluster ended: {str(error).splitlines()[0]}",
            suggestion="what is finished is kept: the same command goes on",
        ) from None
