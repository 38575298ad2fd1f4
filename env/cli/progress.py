"""Progress bars that count; where nobody looks, lines for a log."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column

Item = TypeVar("Item")

_BETWEEN_LINES = 60.0  # s


class Bar:
    """A bar that counts what is passed on under it."""

    def __init__(self, bars: Progress, task: TaskID) -> None:
        self._bars = bars
        self._task = task

    def count(self, what: str, items: Iterable[Item]) -> Iterator[Item]:
        """Yield the items, and count them under the name `what`."""
        self._bars.update(self._task, description=what)
        for item in items:
            self._bars.update(self._task, advance=1)
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


class _Lines(Progress):
    """Bars in a file: what is done is told in a line every minute, and all of it in the end."""

    def __init__(
        self, *columns: ProgressColumn, console: Console, clock: Callable[[], float]
    ) -> None:
        super().__init__(*columns, console=console, get_time=clock)
        self._last = clock()

    def update(self, task_id: TaskID, *args: Any, **options: Any) -> None:
        """Do what a bar does, and tell it if it is time."""
        super().update(task_id, *args, **options)
        if self.get_time() - self._last >= _BETWEEN_LINES:
            self._last = self.get_time()
            self.console.print(self.make_tasks_table([self._tasks[task_id]]))


def counters(console: Console, unit: str, clock: Callable[[], float] = time.monotonic) -> Progress:
    """Return bars that tell how many of all items are done, and how long the rest will take.

    Args:
        console: where they show. If it is no terminal, a line tells the same every minute.
        unit: what the items are.
        clock: the time, in s.
    """
    text = TextColumn("{task.description:<32}", markup=False)
    # Where there is little room it is the bar that gets shorter, not the numbers.
    count = MofNCompleteColumn(table_column=Column(no_wrap=True))
    times = TextColumn(unit), TimeElapsedColumn(), TimeRemainingColumn()
    if console.is_terminal:
        return Progress(text, BarColumn(), count, *times, console=console, get_time=clock)
    return _Lines(text, count, *times, console=console, clock=clock)
