"""Why a file can't be read, in words for an error."""

from __future__ import annotations

from pydantic import ValidationError


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
