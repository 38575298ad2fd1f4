"""Files that are read: regular ones within limits, or an error of ours that says why not."""

from __future__ import annotations

from io import BufferedReader
from pathlib import Path

from pydantic import ValidationError

from sfol.errors import FileError, Place

MAXIMUM_BYTES = 1_000_000


def opened(path: Path, what: str = "file") -> BufferedReader:
    """Return a file to read its bytes from.

    Args:
        path: the file; a folder is none, nor is a pipe, which might never end.
        what: what it is, such as ``log``, for the message.

    Raises:
        FileError: it can't be read.
    """
    try:
        if path.exists() and not path.is_file():
            raise _unreadable(path, what, "it is not a regular file")
        return path.open("rb")
    except OSError as error:
        raise _unreadable(path, what, error.strerror or str(error)) from None
    except ValueError as error:  # a name with a null character
        raise _unreadable(path, what, str(error)) from None


def content_of(path: Path, what: str = "file", most: int = MAXIMUM_BYTES) -> bytes:
    """Return the bytes of a file.

    Args:
        path: the file.
        what: what it is, for the message.
        most: bytes that it may have.

    Raises:
        FileError: it can't be read, or is too long.
    """
    with opened(path, what) as file:
        try:
            content = file.read(most + 1)  # however much a file grows meanwhile
        except OSError as error:
            raise _unreadable(path, what, error.strerror or str(error)) from None
    if len(content) > most:
        raise FileError(
            f"the {what} has more than {most} bytes", name=path.name, place=Place(str(path))
        )
    return content


def text_of(path: Path, what: str = "file", most: int = MAXIMUM_BYTES) -> str:
    """Return the text of a file in UTF-8; arguments as for `content_of`.

    Raises:
        FileError: it can't be read, is too long or is not UTF-8.
    """
    try:
        return content_of(path, what, most).decode()
    except UnicodeDecodeError as error:
        raise FileError(
            f"the {what} is not UTF-8 text: {error}", name=path.name, place=Place(str(path))
        ) from None


def first_reason(error: Exception) -> str:
    """Return the first thing that is wrong, in one line.

    Args:
        error: of the operating system, of pydantic, or of a library that reads files.
    """
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        return f"{key}: {first['msg']}" if key else first["msg"]
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return (str(error).splitlines() or [type(error).__name__])[0]


def _unreadable(path: Path, what: str, reason: str) -> FileError:
    return FileError(f"the {what} can't be read: {reason}", name=path.name, place=Place(str(path)))
