"""Files that are written whole or not at all."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sfol.errors import UsageError


@contextmanager
def replacing(path: Path, *, follow_link: bool = False) -> Iterator[Path]:
    """Yield the path of a file to write; it takes the place of `path` if nothing goes wrong.

    Until then the content stands beside it, in a file that ends in ``.part`` and that nobody else
    can have made: its name is drawn by chance and did not exist. An exception removes that file
    and leaves `path` as it was. Missing folders are made.

    Args:
        path: the file.
        follow_link: whether a link is followed and stays one; else it is replaced, and what it
            leads to is not touched.

    Raises:
        UsageError: the file can't be written.
    """
    target = path.resolve() if follow_link else path
    part = target.with_name(f"{target.name}.{secrets.token_hex(8)}.part")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        os.close(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        yield part
        if target.exists():
            shutil.copymode(target, part)
        os.replace(part, target)
    except OSError as error:
        raise unwritable(path, error) from None
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def append_line(path: Path, text: str) -> None:
    """Write a line at the end of a file, which is made if there is none; no link is followed.

    Raises:
        UsageError: the file can't be written.
    """
    try:
        descriptor = os.open(path, os.O_APPEND | os.O_CREAT | os.O_WRONLY | os.O_NOFOLLOW, 0o666)
        with open(descriptor, "a", encoding="utf-8") as file:
            file.write(f"{text}\n")
    except OSError as error:
        raise unwritable(path, error) from None


def check_writable(*paths: Path) -> None:
    """Make sure that files can be written, before the work that they are written for.

    Missing folders are made; nothing else is changed.

    Raises:
        UsageError: one can't be.
    """
    for path in paths:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=path.parent):
                pass
            if path.is_dir():
                raise IsADirectoryError(errno.EISDIR, "it is a folder")
        except OSError as error:
            raise unwritable(path, error) from None


def unwritable(path: Path, error: OSError) -> UsageError:
    """Return the error that a file or a folder can't be written."""
    reason = error.strerror or str(error)
    return UsageError(f"'{path}' can't be written: {reason}", name=str(path))
