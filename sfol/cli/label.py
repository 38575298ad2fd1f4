"""`sfol label`: recorded steps, each with its reward under a knowledge base."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from sfol.cli.app import app
from sfol.cli.inputs import path_or_name
from sfol.cli.output import line, stdout
from sfol.reward import RewardFunction
from sfol.tools.label import PART_ROWS
from sfol.tools.label import label as labelled
from sfol.tools.label_minari import PREFIX
from sfol.tools.ray_cluster import HELP
from sfol.tools.texts import visible


@app.command()
def label(
    data: Annotated[
        str,
        typer.Argument(
            help="A Parquet file, a folder of such, or minari:NAME.",
            show_default=False,
        ),
    ],
    rules: Annotated[
        str, typer.Option(help="A file, or a bundled name.", metavar="FILE", show_default=False)
    ],
    folder: Annotated[
        Path | None,
        typer.Option(help="Where the labels go; beside the data, with the ending .labelled."),
    ] = None,
    part_rows: Annotated[
        int, typer.Option(min=1, help="Rows from which on a part is full.")
    ] = PART_ROWS,
    ray: Annotated[str | None, typer.Option(help=HELP, metavar="ADDRESS")] = None,
) -> None:
    """Label recorded steps with their rewards, terms, weights and confidences.

    They stand in Parquet files, or in a data set of Minari: minari:NAME, or its folder.

    The knowledge base must say how facts and signals are read. Rows stream through, so that data
    may be larger than the memory; the same command again goes on where it was stopped.

    Example: `sfol label steps.parquet --rules my_rules.yaml`
    """  # fmt: skip
    target = folder or _beside(data)
    reward = RewardFunction(path_or_name(rules))
    start = time.perf_counter()
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("rows"), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("rows", total=None)

        def show(done: int, rows: int) -> None:
            progress.update(task, completed=done, total=rows)

        result = labelled(data, target, reward, part_rows=part_rows, ray=ray, on_rows=show)
    pace = result.new_rows / (time.perf_counter() - start)
    line(
        stdout(),
        f"{visible(target)}: {result.rows} rows in {len(result.parts)} parts; "
        f"{result.new_rows} of them labelled now, {pace:.0f} a second",
    )


def _beside(data: str) -> Path:
    """Return where labels go by default: beside a path, or here if Minari has the data."""
    where = Path() if data.startswith(PREFIX) else Path(data).parent
    return where / f"{Path(data).stem.removeprefix(PREFIX)}.labelled"
