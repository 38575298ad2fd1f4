"""Locks between processes: what one of them writes, no other writes at the same time."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from sfol.errors import UsageError

try:
    import fcntl
except ImportError:  # as on Windows
    fcntl = None  # type: ignore[assignment]

_NO_LOCKS_HERE = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP)


@contextmanager
def locked(path: Path, what: str) -> Iterator[None]:
    """Keep a file or folder to this process; missing folders above it are made.

    The lock is on a file beside it that ends in ``.lock`` and says who holds it. It ends with the
    block or with the process, so that what a process leaves behind that died locks nothing.
    Where there are no such locks, as on Windows and on some network drives, nothing is locked.

    Args:
        path: the file or folder.
        what: what it is, such as ``log``, for the message.

    Raises:
        UsageError: it is locked already, here or by another process, or can't be locked.
    """
    if fcntl is None:
        yield
        return
    lock = path.with_name(f"{path.name}.lock")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = _acquired(lock, f"the {what} '{path}'")
    except OSError as error:
        reason = error.strerror or str(error)
        raise UsageError(f"'{path}' can't be written: {reason}", name=str(path)) from None
    try:
        yield
    finally:
        with suppress(OSError):
            lock.unlink()  # while it is held: who has opened it by now finds that it is gone
        os.close(descriptor)


def _acquired(lock: Path, what: str) -> int:
    """Return the descriptor of a lock file that is locked."""
    while True:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
        try:
            _lock(descriptor, what)
            if os.path.samestat(os.stat(lock), os.fstat(descriptor)):
                os.truncate(descriptor, 0)
                os.write(descriptor, _holder().encode())
                return descriptor
        except FileNotFoundError:
            pass
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)  # it was another's, who has removed it meanwhile


def _lock(descriptor: int, what: str) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = os.read(descriptor, 100).decode(errors="replace") or "another process"
        raise UsageError(
            f"{what} is being written by {holder}",
            suggestion="wait until it ends, or write elsewhere",
        ) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS_HERE:
            raise


def _holder() -> str:
    return f"process {os.getpid()} since {datetime.now():%Y-%m-%d %H:%M:%S}"
