"""Tables show names as they are, whatever the terminal could make of them."""

import pytest
from rich.console import Console

from env.cli import tables
from env.cli.progress import counters
from env.evaluation.evaluate import Settings, Summary
from env.evaluation.results import DriveResult
from env.evaluation.statistics import Mean
from env.evaluation.sweep import ApproachResult

NAMES = ["[/]", "[bold]", "[/nothing]", "[red]x", "a[link=x]"]


def shown(*things):
    console = Console(width=200, record=True, quiet=False)
    with console.capture() as capture:
        console.print(*things)
    return capture.get()


@pytest.mark.parametrize("name", NAMES)
def test_names_are_no_markup(name):
    settings = Settings(name, None, "low", "full", True, "truth", 1, 0, "crossing", "", 1.0)
    summary = Summary(
        steps=1,
        measured={},
        total={},
        discounted={},
        fluctuation={name: Mean(1.0, 1)},
        heads={},
        rules={name: 0.5},
    )
    results = [DriveResult(settings, "", {}, summary)]
    assert name in shown(tables.collision_table(results))
    assert name in shown(tables.driving_table(results))
    assert shown(tables.coverage_table(results)).count(name) == 3
    approach = ApproachResult(name, 10.0, 0.5, "success", None, True)
    assert name in shown(tables.sweep_table(name, [approach]))


@pytest.mark.parametrize("name", NAMES)
def test_what_is_counted_is_no_markup(name):
    console = Console(width=200)
    with console.capture() as capture, counters(console, "steps") as bars:
        bars.add_task(name, total=1)
        console.print(bars.make_tasks_table(bars.tasks))
    assert name in capture.get()
