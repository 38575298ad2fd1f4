"""`aeb train`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from env.cli.app import app
from env.cli.progress import counters
from env.driving.setup import changed, load_setup, setup_names, training_name
from sfol.cli.output import escaped


@app.command()
def train(
    setup: Annotated[
        str, typer.Option(help=f"A YAML file, or one of {', '.join(setup_names())}.")
    ] = "add",
    seed: Annotated[int | None, typer.Option(help="Instead of the setup's.")] = None,
    streets: Annotated[
        int | None,
        typer.Option(help="Driven at once, each in its own process, instead of the setup's."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(
            help="A policy to start from, .safetensors or 'trained', instead of the setup's."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(help="Folder of the training. [default: runs/train/SETUP-seedN]"),
    ] = None,
) -> None:
    """Train a policy with PPO, or go on with a training that was stopped.

    A setup says what is trained: rules, observation, streets, hyperparameters. The folder holds
    checkpoints, tensorboard's files, evaluations on streets that training never sees, and the
    policy that did best in them, which `aeb evaluate --driver` takes. The same command goes on
    from the last checkpoint.

    More streets at once use more processors, and some 600 MB of memory each; an update comes
    after as many steps of all streets together.

    With `--start`, a policy that drives already is trained on, say with less noise or under a rule
    that you have changed.

    Example: `aeb train --setup state`, then `tensorboard --logdir runs/train`
    """
    from env.learning.training import train as run

    options = {"seed": seed, "streets": streets, "start": start}
    given = {name: value for name, value in options.items() if value is not None}
    chosen = changed(load_setup(setup), **given)
    folder = output or Path("runs/train") / training_name(chosen.name, chosen.seed)
    console = Console(highlight=False)
    with counters(console, "steps") as bars:
        task = bars.add_task(chosen.name, total=chosen.steps)
        trained = run(
            chosen,
            folder,
            progress=lambda steps, stage: bars.update(task, completed=steps, description=stage),
        )
    console.print(_table(trained.evaluations))
    console.print(f"The policy: {escaped(trained.policy)}", soft_wrap=True)


def _table(evaluations: tuple[dict[str, float], ...]) -> Table:
    table = Table(title="Evaluations during training", title_justify="left")
    for name in ("steps", "seconds", "success", "collision", "timeout", "return", "length"):
        table.add_column(name, justify="right")
    for row in evaluations:
        shares = (f"{row[name]:.0%}" for name in ("success", "collision", "timeout"))
        pace = (f"{row['steps']:,}", f"{row['seconds']:.0f}")
        table.add_row(*pace, *shares, f"{row['return']:.1f}", f"{row['length']:.0f}")
    return table
