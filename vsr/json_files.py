"""JSON files, read as what they should be, and no larger than that can be."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from pydantic import TypeAdapter, ValidationError

from sfol.errors import FileError, SfolError
from sfol.reading import content_of, first_reason

Content = TypeVar("Content")


def read_json(
    path: Path, kind: type[Content], what: str, *, most: int, suggestion: str | None = None
) -> Content:
    """Return what a file holds.

    Args:
        path: of the file.
        kind: a pydantic model or a dataclass, what it should hold.
        what: this is called, such as ``card of a policy``.
        most: bytes that it may have.
        suggestion: what to do where it holds something else.

    Raises:
        FileError: there is no such file, it is too large, or it holds something else.
    """
    try:
        content = content_of(path, what, most)
    except FileError as error:
        raise FileError(
            error.message, name=error.name, suggestion=suggestion, place=error.place
        ) from None
    try:
        return TypeAdapter(kind).validate_json(content)
    except ValidationError as error:
        reason = first_reason(error)
    except SfolError as error:
        reason = error.message
    raise FileError(f"'{path}' is no {what}: {reason}", name=str(path), suggestion=suggestion)


def valid_text(text: str) -> str:
    """Return a text that can be written: what is no UTF-8 in a path stands escaped."""
    return text.encode("utf-8", "backslashreplace").decode()
