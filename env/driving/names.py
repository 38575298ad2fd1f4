"""Names that become parts of paths: those of setups, trainings and drivers."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import AfterValidator

from sfol.errors import UsageError

MOST = 128  # characters; file systems allow 255 with all endings
_NAME = re.compile(rf"[A-Za-z0-9_][A-Za-z0-9._-]{{0,{MOST - 1}}}")
_ELSE = re.compile(r"[^A-Za-z0-9._-]+")


def checked_name(name: str) -> str:
    """Return a name, which leads nowhere but to a file or folder that is called so.

    Raises:
        UsageError: it has other characters than letters, digits, and ``.``, ``_``, ``-`` after the
            first, has none, or has too many.
    """
    if not _NAME.fullmatch(name):
        shown = name if len(name) <= MOST else f"{name[:MOST]}…"
        raise UsageError(
            f"{shown!r} is no name",
            name=shown,
            suggestion=f"letters, digits, _ and, after the first, . and -; {MOST} at most",
        )
    return name


Name = Annotated[str, AfterValidator(checked_name)]


def name_like(text: str) -> str:
    """Return a name for a text, such as a file's; other characters become ``_``, half are kept."""
    return _ELSE.sub("_", text).lstrip(".-")[: MOST // 2] or "_"
