"""A folder that is written to belongs to one process at a time.

A file in it, ``.lock``, says who has it. The operating system holds the lock and lets it go when
the process ends, however it ends; a file that is left over from a killed one locks nothing.
"""

from __future__ import annotations

import fcntl
import os
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from sfol.errors import SfolError
from sfol.writing import unwritable

_NAME = ".lock"


class _Holder(BaseModel):
    """Who has a folder.

    Attributes:
        pid: number of the process.
        command: that it runs.
        since: when it took the folder.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    pid: int
    command: str
    since: datetime

    def __str__(self) -> str:
        return f"process {self.pid} ({self.command}) since {self.since:%Y-%m-%d %H:%M:%S}"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Have a folder for oneself; it is made if there is none.

    Args:
        folder: that is to be written to.

    Raises:
        SfolError: another process has it.
        UsageError: nothing can be written there.
    """
    file = folder / _NAME
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = _taken(file)
    except BlockingIOError:
        raise SfolError(
            f"the folder '{folder}' is in use by {_holder(file)}",
            name=str(folder),
            suggestion="wait for it, stop it, or name another --output",
        ) from None
    except OSError as error:
        raise unwritable(folder, error) from None
    try:
        yield
    finally:
        with suppress(OSError):  # the folder may be gone
            file.unlink()  # while nobody else can have it
        os.close(lock)


def _taken(file: Path) -> int:
    """Lock a file and return its descriptor."""
    while True:
        lock = os.open(file, os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW, 0o644)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_still(file, lock):
                os.truncate(lock, 0)
                os.write(lock, _own().model_dump_json().encode())
                return lock
        except OSError:
            os.close(lock)
            raise
        os.close(lock)


def _is_still(file: Path, lock: int) -> bool:
    """Tell whether a file is the one that was opened; the last holder may have removed that."""
    try:
        return os.path.samestat(file.stat(), os.fstat(lock))
    except FileNotFoundError:
        return False


def _own() -> _Holder:
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    return _Holder(pid=os.getpid(), command=command, since=datetime.now().astimezone())


def _holder(file: Path) -> str:
    try:
        return str(_Holder.model_validate_json(file.read_bytes()))
    except (OSError, ValidationError):  # it has just begun, or just ended
        return "another process"
