"""The demo: five episodes, the most dangerous moment of them, and the report."""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

import sfol
from env.demo.episode import Episode, Step
from env.demo.moment import moment_pictures
from env.demo.recording import coverage, drive, most_dangerous, signals_of, write_log
from env.demo.report import Focus, Provenance, write_report
from env.driving.drivers import Driver
from env.driving.policies import TRAINED, make_driver
from env.street.crossing import OccludedCrossing
from env.world.actors import Behaviour
from env.world.cells import Traffic
from env.world.world import Occlusion
from sfol.cli.output import escaped
from sfol.facts import Facts
from sfol.locking import locked_folder
from sfol.writing import check_writable
from vsr.threads import one_thread

_REPORT, _LOG = "report.html", "episodes.parquet"


class DemoDrive(NamedTuple):
    """One episode of the demo."""

    driver: str
    traffic: Traffic
    occlusion: Occlusion
    behaviour: Behaviour
    seed: int


# The trained policy in three cells, and two scripted drivers on the last one's very street.
DEMO = (
    DemoDrive(TRAINED, "low", "partial", "briefly_visible", 1),
    DemoDrive(TRAINED, "medium", "full", "hidden", 2),
    DemoDrive(TRAINED, "high", "full", "hidden", 10),
    DemoDrive("cautious", "high", "full", "hidden", 10),
    DemoDrive("full_throttle", "high", "full", "hidden", 10),
)


def run_demo(rules: str, output: Path, seed: int, console: Console) -> None:
    """Drive, explain the most dangerous moment, and write the report and the log.

    Args:
        rules: a knowledge base: a path, or a bundled name.
        output: folder for report.html and episodes.parquet.
        seed: added to the seeds of the episodes.
        console: where episodes and explanation are printed.

    Raises:
        SfolError: another process has the folder, nothing can be written there, or the rules or a
            driver can't be used.
    """
    kb = sfol.KnowledgeBase.load(rules)
    with locked_folder(output), one_thread():
        check_writable(output / _REPORT, output / _LOG)
        started = time.perf_counter()
        episodes = _drive_all([plan._replace(seed=plan.seed + seed) for plan in DEMO], kb, console)
        seconds = time.perf_counter() - started
        steps = sum(len(e.steps) for e in episodes)
        focus = _explained(episodes, kb, console)
        made = (
            f"aeb demo --rules {rules} --seed {seed}; sfol {sfol.__version__}, Python "
            f"{platform.python_version()}, the street's renderer, the simulator's segmentation; "
            f"{steps} steps in {seconds:.0f} s"
        )
        path, log = output / _REPORT, output / _LOG
        write_report(path, episodes, _groups(kb), focus, Provenance(kb.name, kb.hash, made))
        write_log(log, episodes, kb)
    report = f"\n{steps} steps in {seconds:.0f} s. The report: {escaped(path)}"
    console.print(report, soft_wrap=True)
    again = f"sfol diff {rules} FILE --log {log}"
    console.print(f"Other rules on these steps: {escaped(again)}", soft_wrap=True)


def _explained(episodes: Sequence[Episode], kb: sfol.KnowledgeBase, console: Console) -> Focus:
    """Print the episodes and explain the most dangerous moment of them."""
    heads = [head for group in _groups(kb).values() for head in group]
    which, index = most_dangerous(episodes)
    episode, step = episodes[which], episodes[which].steps[index]
    explanation = str(_explain(kb, episodes[which].steps[: index + 1]))
    _print_summary(console, episodes, coverage(episodes, heads))
    console.print(
        f"[bold]The most dangerous moment[/]: {episode.driver} in {episode.traffic} traffic with "
        f"{episode.occlusion} occlusion, second {step.time:.1f}, {_danger(episode, step)}\n"
    )
    console.print(explanation, markup=False, soft_wrap=True)
    return Focus(which, index, explanation, moment_pictures(step, kb))


def _groups(kb: sfol.KnowledgeBase) -> dict[str, tuple[str, ...]]:
    """Return the heads of each weight."""
    return {name: tuple(weight.coefficients) for name, weight in kb.weights.items()}


def _drive_all(
    plans: Sequence[DemoDrive], kb: sfol.KnowledgeBase, console: Console
) -> list[Episode]:
    columns = (
        TextColumn("{task.description:<34}", markup=False),
        BarColumn(),
        TextColumn("{task.completed:3.0f} of {task.total:.0f} m"),
        TimeElapsedColumn(),
    )
    drivers = {name: make_driver(name) for name in dict.fromkeys(plan.driver for plan in plans)}
    with Progress(*columns, console=console) as bars:
        return [_drive_one(plan, drivers[plan.driver], kb, bars) for plan in plans]


def _drive_one(plan: DemoDrive, driver: Driver, kb: sfol.KnowledgeBase, bars: Progress) -> Episode:
    street = OccludedCrossing(
        traffic=plan.traffic, occlusion=plan.occlusion, behaviour=plan.behaviour, rules=kb
    )
    bar = bars.add_task(
        f"{plan.driver}, {plan.traffic} / {plan.occlusion}", total=street.world.geometry.goal
    )
    try:
        return drive(
            street,
            driver,
            plan.seed,
            name=plan.driver,
            progress=lambda step: bars.update(bar, completed=step.position),
        )
    finally:
        bars.stop_task(bar)
        street.close()


def _explain(kb: sfol.KnowledgeBase, steps: Sequence[Step]) -> object:
    """Explain the last of some steps, with those before it in mind."""
    reward = sfol.RewardFunction(kb)
    episode, margin = reward.episode(), kb.grounding.margin
    *_, last = (episode.conclude(Facts.parse(step.facts, margin=margin)) for step in steps)
    return reward.explain(last, **signals_of(steps[-1]))


def _print_summary(
    console: Console, episodes: Sequence[Episode], counts: Mapping[str, int]
) -> None:
    console.print(_episode_table(episodes))
    console.print(_coverage_table(counts, episodes))


def _episode_table(episodes: Sequence[Episode]) -> Table:
    table = Table(title="Episodes", title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in ("driver", "cell", "ending"):
        table.add_column(name, no_wrap=True)
    for name in ("s", "km/h", "near m", "TTC s", "return"):
        table.add_column(name, justify="right", no_wrap=True)
    colours = {"success": "green", "collision": "red", "timeout": "yellow"}
    for episode in episodes:
        steps = episode.steps
        table.add_row(
            episode.driver,
            f"{episode.traffic}, {episode.occlusion}",
            f"[{colours[episode.ending]}]{episode.ending}[/]",
            f"{len(steps) * episode.control_dt:.1f}",
            f"{max(step.speed_next for step in steps) * 3.6:.1f}",
            _number(min(step.distance for step in steps)),
            _number(min(step.ttc for step in steps)),
            f"{sum(step.reward for step in steps):.1f}",
        )
    return table


def _coverage_table(counts: Mapping[str, int], episodes: Sequence[Episode]) -> Table:
    total = sum(len(episode.steps) for episode in episodes)
    table = Table("head", title="Rule coverage", title_justify="left", box=SIMPLE_HEAD)
    table.add_column("steps above zero", justify="right")
    table.add_column("share", justify="right")
    for head, count in counts.items():
        table.add_row(
            escaped(head), str(count) if count else "[red]never[/]", f"{count / total:.0%}"
        )
    return table


def _danger(episode: Episode, step: Step) -> str:
    if episode.ending == "collision" and step is episode.steps[-1]:
        return f"contact at {step.speed_next * 3.6:.0f} km/h"
    return f"{step.ttc:.2f} s to a collision, {step.distance:.1f} m away"


def _number(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "–"
