"""Progress bars that count."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

Item = TypeVar("Item")


class Bar:
    """A bar that counts what is passed on under it."""

    def __init__(self, bars: Progress, task: TaskID) -> None:
        self._bars = bars
        self._task = task

    def count(self, what: str, items: Iterable[Item]) -> Iterator[Item]:
        """Yield the items, and count them under the name `what`."""
        self._bars.update(self._task, description=what)
        for item in items:
            self._bars.advance(self._task)
            yield item


@contextmanager
def counting(console: Console, total: int, unit: str) -> Iterator[Bar]:
    """Show a bar.

    Args:
        console: where it shows.
        total: how many items there will be.
        unit: what they are.
    """
    with counters(console, unit) as bars:
        yield Bar(bars, bars.add_task("", total=total))


def counters(console: Console, unit: str) -> Progress:
    """Return bars that tell how many of all items are done, and how long the rest will take.

    Args:
        console: where they show.
        unit: what the items are.
    """
    columns = (
        TextColumn("{task.description:<32}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    return Progress(*columns, console=console)
