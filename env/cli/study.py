"""`aeb study`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import TaskID

from env.cli.app import app
from env.cli.options import CellOption, DriversOption, WorkersOption
from env.cli.progress import counters
from env.driving.setup import load_setup
from env.world.cells import CELLS, Cell
from sfol.cli.output import escaped
from sfol.tools.ray_cluster import HELP
from sfol.writing import check_writable

if TYPE_CHECKING:
    from env.study.study import StudyPlan


@app.command()
def study(  # noqa: PLR0913 (each is an option)
    *,
    setup: Annotated[
        list[str] | None,
        typer.Option(
            help="A YAML file or a bundled name. May be given several times.",
            show_default="the paper's eight",
        ),
    ] = None,
    seed: Annotated[
        list[int] | None,
        typer.Option(help="Of a training. May be given several times.", show_default="0"),
    ] = None,
    cell: CellOption = None,
    episodes: Annotated[
        int | None, typer.Option(min=1, help="In each cell. [default: 100; 1 with --quick]")
    ] = None,
    in_short: Annotated[
        bool,
        typer.Option("--quick", help="Three updates of PPO each: shows that everything works."),
    ] = False,
    workers: WorkersOption = None,
    output: Annotated[
        Path | None,
        typer.Option(help="Folder of the results. [default: runs/study; runs/quick with --quick]"),
    ] = None,
    drivers: DriversOption = Path("results/drivers"),
    ray: Annotated[str | None, typer.Option(help=HELP, metavar="ADDRESS")] = None,
    trainings: Annotated[
        Path | None,
        typer.Option(
            help="Folder of checkpoints and policies. [default: runs/train, which `aeb train` "
            "uses, too; runs/quick/trainings with --quick]"
        ),
    ] = None,
) -> None:
    """Train setups, drive with each in all cells, and draw the paper's tables and figures.

    Each setup is trained with each seed; the policy that did best in the evaluations on the way
    drives the collision test. All of it is resumable: what has a result, made with the same setup,
    rules and episodes, is not done again, and a training goes on from its last checkpoint.
    In the end all is drawn, as by `aeb figures`.

    For example `aeb study --quick`, in some ten minutes, or

    `aeb study --setup add --setup ssi --seed 0 --seed 1`, in many hours
    """
    from env.evaluation.parallel import cores
    from env.study.figures.products import make_products
    from env.study.study import StudyPlan
    from env.study.study_results import StudyFolder
    from sfol.locking import locked_folder

    console = Console(highlight=False)
    folder = output or Path("runs/quick" if in_short else "runs/study")
    kept = trainings or (folder / "trainings" if in_short else Path("runs/train"))
    plan = StudyPlan(
        setups={source: load_setup(source) for source in setup or _papers()},
        seeds=tuple(seed or [0]),
        cells=tuple(map(Cell.parse, cell)) if cell else CELLS,
        episodes=episodes or (1 if in_short else 100),
        in_short=in_short,
        workers=workers or cores(),
        trainings=kept.resolve() if ray else kept,
        results=StudyFolder(folder.resolve() if ray else folder),
        ray=ray,
    )
    figures = folder / "figures"
    with locked_folder(folder):
        check_writable(figures / "collision_test.md")
        _run(plan, console)
        console.print(f"Results: {escaped(folder)}", soft_wrap=True)
        make_products(folder, drivers, figures, console)


def _run(plan: StudyPlan, console: Console) -> None:
    """Run a study, with a bar for each of its parts."""
    from env.study.study import run_study

    with counters(console, "") as bars:
        tasks: dict[str, TaskID] = {}

        def show(what: str, done: int, total: int) -> None:
            if what not in tasks:
                for task in tasks.values():
                    bars.stop_task(task)
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done)

        run_study(plan, show)


def _papers() -> list[str]:
    """Return the paper's setups, each once; one is in both of its tables."""
    from env.study.figures.paper import load_paper

    tables = load_paper().sets
    return list(dict.fromkeys(setup.name for table in tables for setup in table.setups))
