"""`aeb demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from env.cli.app import app
from env.cli.options import RulesOption


@app.command()
def demo(
    rules: RulesOption = "crossing",
    output: Annotated[Path, typer.Option(help="Folder for report.html.")] = Path("runs/demo"),
    seed: Annotated[int, typer.Option(min=0, help="Added to the seeds of the episodes.")] = 0,
) -> None:
    """Drive five episodes, explain the most dangerous moment, write a report.

    At every step the camera image is segmented, entities and facts are found, the rules are
    applied and the reward is computed. The report is one page that needs no network; the log beside
    it is for `sfol diff --log` and `sfol replay`.

    Example: `aeb demo --rules my_rules.yaml --output runs/mine`
    """
    from env.demo.demo import run_demo

    run_demo(rules, output, seed, Console(highlight=False))
