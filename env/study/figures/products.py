"""All tables and figures of a study, each made if there is data for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from env.evaluation.results import ResultFolder, write_csv
from env.study.figures import collision_test, driving
from env.study.figures.contenders import Contenders, gather, groups, in_order
from env.study.figures.curves import draw_curves
from env.study.figures.fluctuation import draw_fluctuation, weights_of
from env.study.figures.paper import Paper, load_paper
from env.study.figures.radar import draw_radar
from env.study.figures.style import save
from env.study.figures.trajectory import draw_trajectory
from env.study.study_results import StudyFolder
from env.world.cells import CELLS
from sfol.cli.output import escaped
from sfol.errors import UsageError
from sfol.writing import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Product:
    """A table or a figure, if there is data for it.

    Attributes:
        name: of its file.
        write: makes it at a path; None without data.
        needs: what is missing then.
    """

    name: str
    write: Callable[[Path], None] | None
    needs: str = ""


def make_products(study: Path, drivers: Path, output: Path, console: Console) -> None:
    """Write every table and figure for which there is data, and print the tables in short.

    Args:
        study: folder of a study's results.
        drivers: folder with drives of scripted drivers.
        output: folder of tables and figures.
        console: where they are printed.

    Raises:
        UsageError: there is no result in either folder.
    """
    folder, paper = StudyFolder(study), load_paper()
    contenders = gather(folder.drive_results(), ResultFolder(drivers).all())
    products = [*_of_drives(contenders, paper), *_of_study(folder, paper)]
    if not any(product.write for product in products):
        raise UsageError(
            f"there is no result in '{study}' or '{drivers}'",
            name=str(study),
            suggestion="`aeb study` makes them, and `aeb evaluate --output results/drivers` those "
            "of scripted drivers",
        )
    _print(console, collision_test.collision_rows(contenders, paper))
    for product in products:
        _write(console, product, output)


def _of_drives(contenders: Contenders, paper: Paper) -> list[Product]:
    """Return what is made of drives."""
    sets = groups(paper, contenders.setups)
    setups = [contenders.setups[s] for s in in_order(sets) if s in contenders.setups]
    drivers = list(contenders.drivers.values())
    rows = collision_test.collision_rows(contenders, paper) if setups or drivers else []
    driven = driving.driving_rows(setups)
    compared = [*driven, *driving.driving_rows(drivers)]
    text = partial(_write_text, rows, compared, paper)
    level = "has driven both cells of any traffic"
    fluctuation = partial(draw_fluctuation, driven, sets)
    return [
        Product("collision_test.md", text if rows else None, "nobody has driven"),
        _table("collision_test.csv", collision_test.csv_rows(rows), "nobody has driven"),
        _table("driving.csv", driving.csv_rows(compared), f"nobody {level}"),
        _figure("radar.png", partial(draw_radar, driven, sets), driven, f"no setup {level}"),
        _figure("fluctuation.png", fluctuation, weights_of(driven), f"no setup {level}"),
    ]


def _of_study(folder: StudyFolder, paper: Paper) -> list[Product]:
    """Return what is made of trainings and trajectories."""
    trained = folder.trainings()
    sets = groups(paper, [training.setup for training in trained])
    trajectories = folder.trajectories()
    curves = partial(draw_curves, trained, sets)
    return [
        _figure("training_curves.png", curves, trained, "nothing is trained"),
        *(
            _figure(f"trajectory-{t.driver}.png", partial(draw_trajectory, t), [t])
            for t in trajectories
        ),
        *([] if trajectories else [Product("trajectory-….png", None, "there is no trajectory")]),
    ]


def _table(name: str, rows: Sequence[Mapping[str, Any]], needs: str) -> Product:
    def write(path: Path) -> None:
        write_csv(path, rows)

    return Product(name, write if rows else None, needs)


def _figure(
    name: str, draw: Callable[[], Figure], data: Sequence[object], needs: str = ""
) -> Product:
    def write(path: Path) -> None:
        save(draw(), path)

    return Product(name, write if data else None, needs)


def _write_text(
    rows: Sequence[collision_test.CollisionRow],
    driven: Sequence[driving.DrivingRow],
    paper: Paper,
    path: Path,
) -> None:
    parts = [collision_test.markdown(rows, paper), *([driving.markdown(driven)] if driven else [])]
    with replacing(path) as part:
        part.write_text("\n".join(parts), encoding="utf-8")


def _write(console: Console, product: Product, output: Path) -> None:
    if product.write is None:
        reason = f"{product.needs}; `aeb study` changes that"
        console.print(f"[yellow]not written[/]: {escaped(product.name)}: {reason}", soft_wrap=True)
        return
    product.write(output / product.name)
    console.print(f"written: {escaped(output / product.name)}", soft_wrap=True)


def _print(console: Console, rows: Sequence[collision_test.CollisionRow]) -> None:
    """Print the tables in short: success, collision and timeout, and the stopping distance."""
    for title, members in collision_test.tables(rows).items():
        table = Table(
            title=escaped(title),
            title_justify="left",
            box=SIMPLE_HEAD,
            padding=(0, 1, 0, 0),
        )
        table.add_column("")
        for cell in CELLS:
            table.add_column(f"{cell.traffic}\n{cell.occlusion}", justify="right", no_wrap=True)
        for label in dict.fromkeys(row.label for row in members):
            row_of = {row.cell: row for row in members if row.label == label}
            table.add_row(escaped(label), *(collision_test.short(row_of[cell]) for cell in CELLS))
            if any(row.paper for row in row_of.values()):
                printed = [collision_test.short_paper(row_of[cell]) for cell in CELLS]
                table.add_row("  paper", *printed, style="dim")
        console.print(table)
    console.print("success/collision/timeout in %; below, the mean stopping distance in m")
