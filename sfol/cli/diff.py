"""`sfol diff`: what changed, and what that does to recorded episodes."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from sfol.cli.app import app
from sfol.cli.inputs import LogFile, path_or_name
from sfol.cli.output import line, note_unknown, print_errors, print_file, stdout
from sfol.errors import SfolError, UsageError
from sfol.knowledge_base import KnowledgeBase
from sfol.logs import Log, read_log
from sfol.reward import RewardFunction
from sfol.tools.committed import committed
from sfol.tools.diff import Change, LogDifference, MovedStep, compare, compare_log
from sfol.tools.replay import known
from sfol.tools.texts import visible

_MARKS = {"added": ("+", "green"), "removed": ("-", "red"), "changed": ("~", "yellow")}
_SECONDS = 0.5


@app.command()
def diff(  # noqa: PLR0913, PLR0917  (each is an option of the command line)
    source: Annotated[
        str, typer.Argument(help="A file, or a bundled name.", metavar="A", show_default=False)
    ],
    other: Annotated[
        str | None,
        typer.Argument(
            help="Another one. Without it, A is compared with its last commit.",
            metavar="B",
            show_default=False,
        ),
    ] = None,
    log: LogFile = None,
    top: Annotated[int, typer.Option(min=1, help="Show so many steps of the log.")] = 5,
    watch: Annotated[bool, typer.Option("--watch", help="Again at every save.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show what changed between two knowledge bases, or since the last commit.

    With a log of recorded episodes also which steps, confidences, weights, rewards and returns
    moved, worst first, the worst one explained. Exit codes as those of diff: 0 the same,
    1 different.

    Example: `sfol diff aeb my_rules.yaml --log runs/drives.parquet`

    Example: `sfol diff my_rules.yaml --watch`
    """  # fmt: skip
    recorded = read_log(log) if log else None

    def once() -> tuple[bool, tuple[str, ...]]:
        before, after = _pair(source, other)
        changes = compare(before, after)
        difference = compare_log(recorded, before, after) if recorded else None
        if as_json:
            _print_json(changes, difference)
        else:
            console = stdout()
            _print_changes(console, changes)
            if recorded is not None and difference is not None:
                _print_log(console, recorded, (before, after), difference, top)
        return bool(changes), (*before.files, *after.files)

    if watch:
        _watch(once, [source, *([other] if other else [])])
    elif once()[0]:
        raise typer.Exit(1)


def _pair(source: str, other: str | None) -> tuple[KnowledgeBase, KnowledgeBase]:
    if other is not None:
        first, second = (KnowledgeBase.load(path_or_name(name)) for name in (source, other))
        return first, second
    if not os.path.isfile(source):
        raise UsageError(
            f"'{source}' is no file, so it has no last commit",
            name=source,
            suggestion="name a second knowledge base",
        )
    return committed(Path(source)), KnowledgeBase.load(Path(source))


# -- again at every save ------------------------------------------------------------------------


def _watch(once: Callable[[], tuple[bool, tuple[str, ...]]], names: Sequence[str]) -> None:
    files: tuple[str, ...] = tuple(names)
    try:
        while True:
            try:
                files = (*names, *once()[1])
            except SfolError as error:
                print_errors(error)
            _wait_for_change(files)
    except KeyboardInterrupt:
        return


def _wait_for_change(files: Iterable[str]) -> None:
    before = _stamps(files)
    while _stamps(files) == before:
        time.sleep(_SECONDS)


def _stamps(files: Iterable[str]) -> dict[str, int | None]:
    return {file: _stamp(file) for file in files}


def _stamp(file: str) -> int | None:
    try:
        return os.stat(file).st_mtime_ns
    except (OSError, ValueError):  # a bundled name, or a file that is just being replaced
        return None


# -- output -------------------------------------------------------------------------------------


def _print_json(changes: Sequence[Change], difference: LogDifference | None) -> None:
    data: dict[str, object] = {"changes": [change.to_dict() for change in changes]}
    if difference is not None:
        data["log"] = difference.to_dict()
    print_file(json.dumps(data, indent=2, ensure_ascii=False) + "\n")


def _print_changes(console: Console, changes: Sequence[Change]) -> None:
    if not changes:
        console.print("no difference")
    for section, group in groupby(changes, key=lambda change: change.section):
        line(console, (section, "bold"))
        for change in group:
            _print_change(console, change)


def _print_change(console: Console, change: Change) -> None:
    mark, colour = _MARKS[change.kind]
    parts = {**change.before, **change.after}
    alone = parts.get("", "")
    head = f"{change.name}: " if change.name and alone else change.name
    if change.kind != "changed":
        line(console, "  ", (f"{mark} {visible(head)}{visible(alone)}", colour))
        return
    line(console, "  ", (f"{mark} {visible(change.name or change.section)}", colour))
    for part in parts:
        old = visible(change.before.get(part, "nothing"))
        new = visible(change.after.get(part, "nothing"))
        label = f"{visible(part)}: " if part else ""
        line(console, f"      {label}", (old, "red"), " → ", (new, "green"))


def _print_log(
    console: Console,
    log: Log,
    kbs: tuple[KnowledgeBase, KnowledgeBase],
    difference: LogDifference,
    top: int,
) -> None:
    for kb in kbs:
        note_unknown(log, kb)
    moved = difference.moved
    line(
        console,
        (f"\n{len(moved)} of {difference.steps} steps moved", "bold"),
        f" in {len(difference.before)} episodes",
    )
    if not moved:
        return
    console.print(_movements(difference))
    console.print(_returns(difference))
    console.print(_steps(moved[:top]))
    worst = moved[0]
    step = log.episodes[worst.episode].steps[worst.step]
    outcomes = (worst.before, worst.after)
    for kb, outcome, title in zip(kbs, outcomes, ("before", "after"), strict=True):
        _, signals = known(step, kb)
        line(
            console,
            (f"\nThe worst step {title}", "bold"),
            f": episode {worst.episode}, step {worst.step}, under '{visible(kb.name)}'",
        )
        stdout(markup=True).print(RewardFunction(kb).explain(outcome.conclusions, **signals))


def _movements(difference: LogDifference) -> Table:
    table = Table("what moved", title="Movements", title_justify="left")
    for column in ("steps", "most"):
        table.add_column(column, justify="right")
    for name, (steps, most) in difference.movements.items():
        table.add_row(visible(name), str(steps), f"{most:+.4g}")
    return table


def _returns(difference: LogDifference) -> Table:
    table = Table("episode", "ending", title="Returns", title_justify="left")
    for column in ("before", "after", "difference"):
        table.add_column(column, justify="right")
    pairs = zip(difference.before, difference.after, strict=True)
    for old, new in sorted(pairs, key=lambda pair: -abs(pair[1].value - pair[0].value)):
        table.add_row(
            str(old.episode.number),
            visible(old.episode.ending or "–"),
            f"{old.value:.4g}",
            f"{new.value:.4g}",
            f"{new.value - old.value:+.4g}",
        )
    return table


def _steps(moved: Sequence[MovedStep]) -> Table:
    table = Table(title="Steps, worst first", title_justify="left")
    for column in ("episode", "step", "time s"):
        table.add_column(column, justify="right")
    table.add_column("before → after")
    for step in moved:
        moves = [f"{name} {old:.4g} → {new:.4g}" for name, (old, new) in step.moves.items()]
        table.add_row(
            str(step.episode),
            str(step.step),
            f"{step.time:.2f}",
            "\n".join(map(visible, moves)),
        )
    return table
