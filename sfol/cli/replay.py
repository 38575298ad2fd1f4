"""`sfol replay`: recorded episodes under a knowledge base, over time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from sfol.cli.app import app
from sfol.cli.inputs import path_or_name
from sfol.cli.output import line, note, note_unknown, stdout
from sfol.errors import UsageError
from sfol.knowledge_base import KnowledgeBase
from sfol.knowledge_base.loading import bundled_names
from sfol.logs import Log, LoggedStep, read_log
from sfol.outcome import Outcome
from sfol.tools.plotting import MOST_EPISODES, plot
from sfol.tools.replay import ReplayedEpisode
from sfol.tools.replay import replay as replayed
from sfol.tools.texts import visible

_NAMES, _COLUMN = 28, 11  # characters for the names of the rows, and for each step
_COLOURS = {
    "signal": "default",
    "confidence": "green",
    "weight": "magenta",
    "term": "cyan",
    "reward": "bold",
}


@app.command()
def replay(
    log: Annotated[Path, typer.Argument(help="A log, a Parquet file.", show_default=False)],
    kb: Annotated[
        str | None,
        typer.Argument(
            help="A file, or a bundled name; else the one of the recording.",
            metavar="FILE",
            show_default=False,
        ),
    ] = None,
    episode: Annotated[int | None, typer.Option(min=0, help="Show this episode only.")] = None,
    every: Annotated[
        int | None, typer.Option(min=1, help="Show every n-th step, not what fits the width.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option("--plot", help="Draw all steps into this file, such as out.png.")
    ] = None,
) -> None:
    """Replay a log of recorded episodes: signals, confidences, weights, terms and reward over time.

    The knowledge base may be another one than that of the recording: facts and signals stand in
    the log, and everything else is computed anew.

    Example: `sfol replay runs/drives.parquet my_rules.yaml --plot drives.png`
    """  # fmt: skip
    recorded = read_log(log)
    base = KnowledgeBase.load(path_or_name(kb)) if kb else _of_the_recording(recorded)
    note_unknown(recorded, base)
    episodes = _chosen(replayed(recorded, base), episode)
    console = stdout()
    for one in episodes:
        for table in _tables(one, every, console.width):
            console.print(table)
    if picture is not None:
        plot(episodes, picture)
        if len(episodes) > MOST_EPISODES:
            note(f"only the first {MOST_EPISODES} episodes are drawn")
        line(console, f"{visible(picture)}: drawn")


def _of_the_recording(log: Log) -> KnowledgeBase:
    if log.name not in bundled_names():  # a log is data: its name is no path
        raise UsageError(
            f"the log was recorded under '{log.name}', which is not bundled",
            name=log.name,
            suggestion="name its file: sfol replay LOG FILE",
        )
    kb = KnowledgeBase.load(log.name)
    if kb.hash != log.hash:
        note(f"'{kb.name}' has changed since the recording")
    return kb


def _chosen(episodes: Sequence[ReplayedEpisode], number: int | None) -> Sequence[ReplayedEpisode]:
    if not episodes:
        raise UsageError("the log has no episodes")
    if number is None:
        return episodes
    if number >= len(episodes):
        raise UsageError(
            f"the log has no episode {number}", suggestion=f"there are 0 to {len(episodes) - 1}"
        )
    return episodes[number : number + 1]


def _tables(replayed: ReplayedEpisode, every: int | None, width: int) -> Iterator[Table]:
    """Yield tables with a column for a step, as many as fit beside each other."""
    episode, count = replayed.episode, len(replayed.outcomes)
    fitting = max((width - _NAMES) // _COLUMN, 2)
    shown = _chosen_steps(count, every, fitting)
    title = (
        f"episode {episode.number}: {visible(episode.ending or 'cut short')}, "
        f"{count} steps, return {replayed.value:.4g}"
    )
    for start in range(0, len(shown), fitting):
        yield _table(replayed, shown[start : start + fitting], title if start == 0 else None)


def _table(replayed: ReplayedEpisode, shown: Sequence[int], title: str | None) -> Table:
    """Return a table with a column for a step, and a row for everything that has a number."""
    episode, outcomes = replayed.episode, replayed.outcomes
    table = Table(title=title, title_justify="left")
    table.add_column("time in s")
    for index in shown:
        table.add_column(f"{episode.steps[index].time:.1f}", justify="right", no_wrap=True)
    rows = [_numbers(episode.steps[index], outcomes[index]) for index in shown]
    for group, colour in _COLOURS.items():
        for name in rows[0][group]:
            # A term of nothing is often -0.0, which + 0.0 makes 0.
            cells = [f"{row[group][name] + 0.0:.3g}" for row in rows]
            style = colour if any(cell != cells[0] for cell in cells) else "dim"
            table.add_row(visible(f"{group} {name}".strip()), *cells, style=style)
        table.add_section()
    return table


def _chosen_steps(count: int, every: int | None, fitting: int) -> list[int]:
    """Return the steps to show: every n-th, or as many as fit, and always the last."""
    last = count - 1
    apart = every or max(math.ceil(last / (fitting - 1)), 1)
    return [*range(0, last, apart), last]


def _numbers(step: LoggedStep, outcome: Outcome) -> dict[str, Mapping[str, float]]:
    return {
        "signal": step.signals,
        "confidence": outcome.confidences,
        "weight": outcome.weights,
        "term": outcome.terms,
        "reward": {"": outcome.reward},
    }
