"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sfol.errors import UsageError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield the path of a file to write; it takes the place of `path` if nothing goes wrong.

    Until then the content stands beside it in a file that ends in ``.part``; an exception
    removes that file and leaves `path` as it was. A link stays a link. Missing folders are made.

    Raises:
        UsageError: the file can't be written.
    """
    target = path.resolve()
    part = target.with_name(f"{target.name}.part")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield part
        if target.exists():
            shutil.copymode(target, part)
        os.replace(part, target)
    except OSError as error:
        reason = error.strerror or str(error)
        raise UsageError(f"'{path}' can't be written: {reason}", name=str(path)) from None
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
