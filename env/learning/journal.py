"""What happened in a training, line by line, in files that are taken up again with it."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from sfol.writing import replacing

Row = dict[str, Any]


class History:
    """Rows in the order in which they happened, as JSON lines.

    Args:
        file: where they are; it is made with the first row.
    """

    def __init__(self, file: Path) -> None:
        self._file = file

    def rows(self) -> list[Row]:
        """Return all rows. The last one is left out if a killed process left half of it."""
        if not self._file.exists():
            return []
        *whole, _ = self._file.read_text(encoding="utf-8").split("\n")
        return [json.loads(line) for line in whole]

    def append(self, row: Row) -> None:
        """Write a row."""
        with self._file.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")

    def go_back_to(self, steps: int) -> None:
        """Forget the rows after a step: training goes on from there, and they will come again."""
        kept = [row for row in self.rows() if row["steps"] <= steps]
        if self._file.exists():
            with replacing(self._file) as part:
                part.write_text("".join(json.dumps(row) + "\n" for row in kept), encoding="utf-8")


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
