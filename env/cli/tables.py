"""Results as tables on the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from env.evaluation.evaluate import Summary
from env.evaluation.metrics import Pooled
from env.evaluation.results import DriveResult
from env.evaluation.returns import BehaviourReturn
from env.evaluation.statistics import Mean, Share
from env.evaluation.sweep import ApproachResult
from sfol.cli.output import escaped

NOTHING = "–"


def print_results(console: Console, results: Sequence[DriveResult]) -> None:
    """Print collision test, driving characteristics and rule coverage."""
    for table in (collision_table(results), driving_table(results), coverage_table(results)):
        console.print(table)


def collision_table(results: Sequence[DriveResult]) -> Table:
    """Return the paper's collision test, with Wilson's 95 % intervals."""
    table = _table(
        "Collision test: % with 95 % intervals; mean stopping distance in m, of so many episodes",
        *("success", "collision", "timeout", "stop", "of"),
    )
    for result in results:
        measured = result.summary.measured
        stop = measured.get("stopping_distance")
        table.add_row(
            *_where(result),
            *(
                _percent(measured.get(ending), colour)
                for ending, colour in (
                    ("success", "green"),
                    ("collision", "red"),
                    ("timeout", "yellow"),
                )
            ),
            _metric(stop, 2),
            str(stop.episodes) if isinstance(stop, Mean) else NOTHING,
        )
    return table


# Column, metric, and digits after the point.
_DRIVING = (
    ("v", "rms_speed", 1),
    ("a", "rms_acceleration", 1),
    ("jerk", "rms_jerk", 1),
    ("TTC", "min_ttc", 1),
    ("hit", "impact_speed", 1),
    ("near", "near_miss", 0),
    ("false", "false_braking", 1),
    ("goal", "time_to_goal", 1),
    ("rest", "contact_at_rest", 0),
)


def driving_table(results: Sequence[DriveResult]) -> Table:
    """Return the paper's driving characteristics, in SI units."""
    table = _table(
        "Driving, in SI units: RMS of speed, acceleration, jerk; TTC, impact speed, time to goal; "
        "near misses and false braking in %; instants of contact at rest",
        *(column for column, _, _ in _DRIVING),
    )
    for result in results:
        measured = result.summary.measured
        numbers = (_metric(measured.get(name), digits) for _, name, digits in _DRIVING)
        table.add_row(*_where(result), *numbers)
    return table


def coverage_table(results: Sequence[DriveResult]) -> Table:
    """Return how often each rule concluded something, and how restless the weights were."""
    drivers = list(dict.fromkeys(result.settings.driver for result in results))
    summaries = {
        driver: [result.summary for result in results if result.settings.driver == driver]
        for driver in drivers
    }
    table = Table(
        title="Rule coverage (% of steps) and fluctuation of weights (1/s), all cells together",
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    table.add_column("")
    for driver in drivers:
        table.add_column(escaped(driver), justify="right")
    for rule in results[0].summary.rules:
        shares = [_coverage(summaries[driver], rule) for driver in drivers]
        table.add_row(
            escaped(rule), *(_share(share) if share else "[red]never[/]" for share in shares)
        )
    for weight in results[0].summary.fluctuation:
        means = [Mean.pooled(s.fluctuation[weight] for s in summaries[d]) for d in drivers]
        table.add_row(f"w {escaped(weight)}", *map(_number, means))
    return table


def _coverage(summaries: Sequence[Summary], rule: str) -> float:
    steps = sum(summary.steps for summary in summaries)
    return sum(summary.rules[rule] * summary.steps for summary in summaries) / steps


def returns_table(returns: Sequence[BehaviourReturn]) -> Table:
    """Return what each behaviour is one."""
    table = Table("behaviour", title="Returns", title_justify="left", box=SIMPLE_HEAD)
    for name in ("return", "discounted", "episodes"):
        table.add_column(name, justify="right")
    for one in returns:
        table.add_row(
            one.behaviour,
            _number(one.total, 1),
            _number(one.discounted, 1),
            str(one.total.episodes),
        )
    return table


def sweep_table(driver: str, results: Sequence[ApproachResult]) -> Table:
    """Return what came of a driver's approaches: a row per speed, a column per point of impact."""
    table = Table("km/h", title=escaped(driver), title_justify="left", box=SIMPLE_HEAD)
    impacts = sorted({result.impact for result in results})
    for impact in impacts:
        table.add_column(f"at {impact:.0%}", justify="right")
    for speed in dict.fromkeys(result.speed for result in results):
        row = {result.impact: _outcome(result) for result in results if result.speed == speed}
        table.add_row(f"{speed:.0f}", *(row[impact] for impact in impacts))
    return table


def _outcome(result: ApproachResult) -> str:
    if result.impact_speed is not None:
        return f"[red]hit at {result.impact_speed:.0f} km/h[/]"
    if result.ending == "timeout":
        return "[yellow]never went on[/]"
    return "[green]stopped[/]" if result.stopped else "[green]passed[/]"


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in ("driver", "cell"):
        table.add_column(name, no_wrap=True)
    for name in columns:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _where(result: DriveResult) -> tuple[str, str]:
    settings = result.settings
    cell = f"{settings.traffic}/{settings.occlusion}"
    return escaped(settings.driver), cell if settings.hazard else f"{cell}, no hazard"


def _percent(measured: Pooled | None, colour: str) -> str:
    if not isinstance(measured, Share):
        return NOTHING
    low, high = 100 * measured.low, 100 * measured.high
    text = f"{100 * (measured.share or 0.0):.0f} [dim]{low:.0f}–{high:.0f}[/]"
    return f"[{colour}]{text}[/]" if measured.count else text


def _metric(measured: Pooled | None, digits: int) -> str:
    if isinstance(measured, Mean):
        return _number(measured, digits)
    if isinstance(measured, Share):
        return _share(measured.share, digits)
    return NOTHING if measured is None else str(measured)


def _share(share: float | None, digits: int = 1) -> str:
    return NOTHING if share is None else f"{100 * share:.{digits}f}"


def _number(value: Mean, digits: int = 2) -> str:
    return NOTHING if value.mean is None else f"{value.mean:.{digits}f}"
