"""What `aeb` tells while it works: a bar on a terminal, lines in a log."""

from __future__ import annotations

from io import StringIO

import pytest
from rich.console import Console

from env.cli.progress import counters, counting


class HandSetClock:
    """A clock that a test sets, in s."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def test_in_a_log_a_line_tells_every_minute_how_far_it_is() -> None:
    log, clock = StringIO(), HandSetClock()
    with counters(Console(file=log), "steps", clock) as bars:
        task = bars.add_task("low traffic", total=100)
        told = []
        for done in range(10, 40, 10):
            clock.now += 40.0
            bars.update(task, completed=done)
            told.append(log.getvalue().count("low traffic"))
    assert told == [0, 1, 1]
    assert "20/100" in log.getvalue()
    assert "30/100 steps" in log.getvalue().splitlines()[-1]


@pytest.mark.parametrize("terminal", [True, False])
def test_everything_that_is_counted_passes_and_shows_in_the_end(terminal: bool) -> None:
    shown = StringIO()
    console = Console(file=shown, force_terminal=terminal, width=120)
    with counting(console, 3, "episodes") as bar:
        assert list(bar.count("crawl", iter("abc"))) == ["a", "b", "c"]
    assert "crawl" in shown.getvalue()
    assert "3/3" in shown.getvalue()


def test_on_a_narrow_terminal_the_numbers_stay_whole() -> None:
    shown = StringIO()
    with counters(Console(file=shown, force_terminal=True, width=80), "steps") as bars:
        bars.add_task("low/medium/high, 74% of 50 succeed", total=200_000, completed=112_345)
    assert "112345/200000" in shown.getvalue()
