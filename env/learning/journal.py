"""What happened in a training, line by line, in files that are taken up again with it."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sfol.errors import FileError, Place
from sfol.reading import content_of
from sfol.writing import append_line, replacing

_MOST = 100_000_000  # bytes
Row = dict[str, Any]


class History:
    """Rows in the order in which they happened, as JSON lines.

    Args:
        file: where they are; it is made with the first row.
        numbers: the keys that each row has, of numbers.
    """

    def __init__(self, file: Path, numbers: Sequence[str]) -> None:
        self.file = file
        self._numbers = numbers

    def rows(self) -> list[Row]:
        """Return all rows. The last one is left out if a killed process left half of it.

        Raises:
            FileError: the file can't be read, or holds something else.
        """
        if not self.file.exists():
            return []
        *whole, _ = content_of(self.file, "journal", _MOST).split(b"\n")
        return [self._row(number, line) for number, line in enumerate(whole, start=1)]

    def append(self, row: Row) -> None:
        """Write a row.

        Raises:
            UsageError: the file can't be written.
        """
        append_line(self.file, json.dumps(row))

    def go_back_to(self, steps: int) -> None:
        """Forget the rows after a step: training goes on from there, and they will come again."""
        kept = [row for row in self.rows() if row["steps"] <= steps]
        if self.file.exists():
            with replacing(self.file) as part:
                part.write_text("".join(json.dumps(row) + "\n" for row in kept), encoding="utf-8")

    def _row(self, number: int, line: bytes) -> Row:
        try:
            row = json.loads(line)
            if all(isinstance(row[key], int | float) for key in self._numbers):
                return row
        except (ValueError, RecursionError, LookupError, TypeError):  # no JSON, or something else
            pass
        raise FileError(
            f"this is no row of a training, with numbers for {', '.join(self._numbers)}",
            name=str(self.file),
            suggestion="remove the line",
            place=Place(str(self.file), number),
        )


class Clock:
    """How long a training has taken, over all the times that it was started.

    Args:
        seconds: that it took before.
    """

    def __init__(self, seconds: float) -> None:
        self._started = time.monotonic() - seconds

    @property
    def seconds(self) -> float:
        """Until now."""
        return round(time.monotonic() - self._started, 1)
