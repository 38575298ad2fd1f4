"""`aeb imitate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from env.cli.app import app
from env.cli.progress import counters
from env.driving.setup import changed, load_setup, setup_names, training_name
from sfol.cli.output import escaped


@app.command()
def imitate(  # noqa: PLR0913, PLR0917 (each is an option)
    setup: Annotated[
        str, typer.Option(help=f"A YAML file, or one of {', '.join(setup_names())}.")
    ] = "add",
    teacher: Annotated[
        str, typer.Option(help="A scripted driver, such as cautious or oracle.")
    ] = "cautious",
    rounds: Annotated[int, typer.Option(min=1, help="Of driving and learning.")] = 8,
    decisions: Annotated[int, typer.Option(min=64, help="In a round.")] = 4096,
    observation: Annotated[
        Literal["vsr", "state"] | None, typer.Option(help="Instead of the setup's.")
    ] = None,
    fusion: Annotated[
        Literal["add", "multiply", "ssi", "sf"] | None, typer.Option(help="Instead of the setup's.")
    ] = None,
    speed: Annotated[
        bool | None, typer.Option("--speed/--no-speed", help="Whether ego's speed is added.")
    ] = None,
    frames: Annotated[int | None, typer.Option(help="Given together.")] = None,
    unit_rms: Annotated[
        bool | None,
        typer.Option("--unit-rms/--no-unit-rms", help="Whether entities' vectors are scaled."),
    ] = None,
    linear: Annotated[bool, typer.Option("--linear", help="A network without layers.")] = False,
    seed: Annotated[int | None, typer.Option(help="Instead of the setup's.")] = None,
    streets: Annotated[int | None, typer.Option(help="Driven at once.")] = None,
    output: Annotated[
        Path | None, typer.Option(help="Folder. [default: runs/imitate/SETUP-seedN]")
    ] = None,
) -> None:
    """Find out how well a setup's policy could drive at best: show it what to do.

    A teacher drives first, then the learner, and at every decision the learner is shown what the
    teacher would have done. What it can't learn so, its observation does not tell, or its network
    can't hold; what reinforcement learning does not reach of it is due to the learning.

    The table says how many decisions the learner was shown, the mean squared error of its pedal on
    these and on unseen ones, and how it drove.

    The folder gets the policy, which `aeb evaluate --driver` and `aeb train --start` take, and how
    it drove after each round.

    Example: `aeb imitate --setup add --speed --frames 3 --output runs/imitate/more`
    """
    from env.learning.imitation import Lessons
    from env.learning.imitation import imitate as run

    options: dict[str, Any] = {
        "observation": observation,
        "fusion": fusion,
        "speed": speed,
        "frames": frames,
        "unit_rms": unit_rms,
        "seed": seed,
        "streets": streets,
    }
    given = {name: value for name, value in options.items() if value is not None}
    chosen = load_setup(setup)
    if linear:
        given["learning"] = chosen.learning.model_dump() | {"layers": []}
    chosen = changed(chosen, **given)
    lessons = Lessons(teacher=teacher, rounds=rounds, decisions=decisions)
    folder = output or Path("runs/imitate") / training_name(chosen.name, chosen.seed)
    console = Console(highlight=False)
    with counters(console, "decisions") as bars:
        task = bars.add_task(chosen.name, total=rounds * decisions)
        imitated = run(
            chosen,
            folder,
            lessons,
            progress=lambda done, what: bars.update(task, completed=done, description=what),
        )
    console.print(_table(imitated.rounds))
    console.print(f"The policy: {escaped(imitated.policy)}", soft_wrap=True)


def _table(rounds: tuple[dict[str, float], ...]) -> Table:
    table = Table(title="After each round", title_justify="left", box=SIMPLE)
    shares = ("success", "collision", "timeout")
    for name in ("seen", "error", "unseen", *shares, "return", "length"):
        table.add_column(name, justify="right")
    for row in rounds:
        errors = (f"{row[name]:.3f}" for name in ("error", "held_back_error"))
        parts = (f"{row[name]:.0%}" for name in shares)
        ends = (f"{row['return']:.1f}", f"{row['length']:.0f}")
        table.add_row(f"{row['steps']:,}", *errors, *parts, *ends)
    return table
