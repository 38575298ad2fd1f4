"""A progress bar that counts."""

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
    columns = (
        TextColumn("{task.description:<30}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(unit),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bars:
        yield Bar(bars, bars.add_task("", total=total))
