"""`aeb figures`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from env.cli.app import app
from env.cli.options import DriversOption


@app.command("figures")
def figures_command(
    *,
    study: Annotated[Path, typer.Option(help="Folder of a study's results.")] = Path(
        "results/study"
    ),
    drivers: DriversOption = Path("results/drivers"),
    output: Annotated[Path, typer.Option(help="Folder of tables and figures.")] = Path(
        "results/figures"
    ),
) -> None:
    """Make the paper's tables and figures from the results of a study.

    Nothing is driven or trained: files that `aeb study` and `aeb evaluate` have written are read,
    training seeds are pooled, and the paper's own numbers stand beside ours. What nobody has
    measured yet stays empty, and a figure for which there is no data is not written, so it can be
    run at any time during a study. What is there already is replaced.

    For example `aeb figures`, or `aeb figures --study runs/study --output runs/figures`
    """
    from env.study.figures.products import make_products

    make_products(study, drivers, output, Console(highlight=False))
