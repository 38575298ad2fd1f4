"""Locks between processes: what one of them writes, no other writes at the same time."""

from __future__ import annotations

import errno
import os
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from sfol.errors import UsageError
from sfol.writing import unwritable

try:
    import fcntl
except ImportError:  # as on Windows
    fcntl = None  # type: ignore[assignment]

_NO_LOCKS_HERE = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP)
_HOLDER_LENGTH = 300


@contextmanager
def locked(path: Path, what: str) -> Iterator[None]:
    """Keep a file to this process; missing folders above it are made.

    The lock is on a file beside it that ends in ``.lock`` and says who holds it. It ends with the
    block or with the process, so that what a process leaves behind that died locks nothing.
    Where there are no such locks, as on Windows and on some network drives, nothing is locked.

    Args:
        path: the file.
        what: what it is, such as ``log``, for the message.

    Raises:
        UsageError: it is locked already, here or by another process, or can't be locked.
    """
    with _locked(path.with_name(f"{path.name}.lock"), path, f"the {what} '{path}'"):
        yield


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Keep a folder to this process, as `locked` does a file, by a file ``.lock`` in it.

    Args:
        folder: that is to be written to; it is made if there is none.

    Raises:
        UsageError: it is locked already, here or by another process, or can't be written to.
    """
    with _locked(folder / ".lock", folder, f"the folder '{folder}'"):
        yield


@contextmanager
def _locked(lock: Path, path: Path, what: str) -> Iterator[None]:
    try:
        lock.parent.mkdir(parents=True, exist_ok=True)
        descriptor = None if fcntl is None else _acquired(lock, what)
    except OSError as error:
        raise unwritable(path, error) from None
    try:
        yield
    finally:
        if descriptor is not None:
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
        text = os.read(descriptor, 2 * _HOLDER_LENGTH).decode(errors="replace")
        holder = text if text.startswith("process ") and text.isprintable() else "another process"
        raise UsageError(
            f"{what} is in use by {holder}",
            suggestion="wait until it ends, stop it, or write elsewhere",
        ) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS_HERE:
            raise


def _holder() -> str:
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])[:_HOLDER_LENGTH]
    return f"process {os.getpid()} since {datetime.now():%Y-%m-%d %H:%M:%S} ({command})"
