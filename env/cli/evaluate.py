"""`aeb evaluate`."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from itertools import islice, product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

import sfol
from env.cli.app import app
from env.cli.options import (
    CellOption,
    DriverOption,
    PerceptionOption,
    RulesOption,
    TrustOption,
    WorkersOption,
)
from env.cli.progress import counting
from env.driving.setup import DISCOUNT
from env.street.seeds import FINAL_TEST
from env.world.cells import CELLS, Cell, CellOcclusion, Traffic
from sfol.cli.output import escaped
from sfol.errors import UsageError
from vsr.json_files import valid_text

if TYPE_CHECKING:
    from env.evaluation.evaluate import Drive
    from env.evaluation.results import DriveResult


@app.command("evaluate")
def evaluate_command(  # noqa: PLR0913 (each is an option)
    *,
    driver: DriverOption = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes per cell.")] = 100,
    cell: CellOption = None,
    traffic: Annotated[Traffic | None, typer.Option(help="Only cells with it.")] = None,
    occlusion: Annotated[CellOcclusion | None, typer.Option(help="Only cells with it.")] = None,
    perception: PerceptionOption = "simulator",
    rules: RulesOption = "crossing",
    seed: Annotated[
        int, typer.Option(min=0, help="Of the first episode; the others follow.")
    ] = FINAL_TEST.start,
    hazard: Annotated[
        bool, typer.Option(help="Without hazard nobody crosses, and whoever brakes errs.")
    ] = True,
    workers: WorkersOption = None,
    output: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("runs/evaluate"),
    record: Annotated[
        bool, typer.Option("--record", help="Log facts and signals of every step, as Parquet.")
    ] = False,
    again: Annotated[
        bool, typer.Option("--again", help="Drive even what is in the folder already.")
    ] = False,
    returns: Annotated[
        bool,
        typer.Option(
            "--returns",
            help="Drive the reference behaviours instead, and tell whether the reward pays for "
            "the right one.",
        ),
    ] = False,
    discount: Annotated[
        float, typer.Option(min=0.0, max=1.0, help="γ of discounted returns, for each step.")
    ] = DISCOUNT,
    trust: TrustOption = False,
) -> None:
    """Drive the collision test and measure how it is driven.

    Every driver drives the same episodes in six cells, three densities of traffic times two kinds
    of occlusion. What comes of them is printed and written: a JSON with all measures of a cell, a
    CSV with its episodes. A cell that is there already, with the same settings, is not driven
    again, so a run that was stopped goes on with the same command.

    For example `aeb evaluate --driver cautious --driver oracle --episodes 20`, or

    `aeb evaluate --driver cautious --cell high/full --rules my_rules.yaml --record`, or

    `aeb evaluate --returns --rules my_rules.yaml --episodes 10 --perception truth`
    """
    from env.cli import tables
    from env.driving.policies import make_driver
    from env.evaluation.evaluate import Drive, evaluate
    from env.evaluation.parallel import cores
    from env.evaluation.results import ResultFolder
    from env.evaluation.returns import REFERENCE_BEHAVIOURS
    from sfol.locking import locked_folder

    console = Console(highlight=False)
    kb = sfol.KnowledgeBase.load(rules)
    names = (
        [behaviour.driver for behaviour in REFERENCE_BEHAVIOURS]
        if returns
        else (driver or ["cautious"])
    )
    for name in names:
        make_driver(name, trust=trust)  # so that a mistake shows before anybody drives
    drives = [
        Drive(name, where, kb, episodes, seed, perception, hazard, trust, discount=discount)
        for name, where in product(names, _cells(cell, traffic, occlusion))
    ]
    folder = ResultFolder(output)
    with locked_folder(output):
        folder.check(drives)
        results = {drive: None if again else folder.find(drive, log=record) for drive in drives}
        missing = [drive for drive, result in results.items() if result is None]
        if len(missing) < len(drives):
            console.print(f"{len(drives) - len(missing)} of {len(drives)} cells are there already.")
        with counting(console, sum(drive.episodes for drive in missing), "episodes") as bar:
            driven = evaluate(missing, workers=workers or cores(), logs=record)
            for drive in missing:
                counted = bar.count(f"{drive.driver}, {drive.cell}", islice(driven, drive.episodes))
                results[drive] = folder.write(drive, counted, _command(drive, rules), log=record)
    complete = [result for result in results.values() if result is not None]
    tables.print_results(console, complete)
    if returns:
        _print_returns(console, complete)
    console.print(f"Results: {escaped(output)}", soft_wrap=True)


def _cells(
    named: Sequence[str] | None, traffic: Traffic | None, occlusion: CellOcclusion | None
) -> list[Cell]:
    if named and (traffic or occlusion):
        raise UsageError(
            "--cell names cells, and --traffic and --occlusion choose from all: use one way",
            name="cell",
        )
    if named:
        return [Cell.parse(text) for text in named]
    return [
        cell
        for cell in CELLS
        if traffic in (None, cell.traffic) and occlusion in (None, cell.occlusion)
    ]


def _command(drive: Drive, rules: str) -> str:
    words = [
        "aeb", "evaluate", "--driver", drive.driver, "--cell", str(drive.cell),
        "--episodes", str(drive.episodes), "--seed", str(drive.seed),
        "--perception", drive.perception, "--rules", rules, "--discount", str(drive.discount),
    ]  # fmt: skip
    flags = {"--no-hazard": not drive.hazard, "--trust": drive.trust}
    return valid_text(shlex.join([*words, *(flag for flag, wanted in flags.items() if wanted)]))


def _print_returns(console: Console, results: Sequence[DriveResult]) -> None:
    from env.cli import tables
    from env.evaluation.returns import REFERENCE_BEHAVIOURS, faults, return_of

    returns = [
        return_of(behaviour, [r.summary for r in results if r.settings.driver == behaviour.driver])
        for behaviour in REFERENCE_BEHAVIOURS
    ]
    console.print(tables.returns_table(returns))
    wrong = faults(returns)
    if wrong:
        console.print("[red]exploitable[/]: " + "; ".join(wrong), soft_wrap=True)
    else:
        console.print("[green]in order[/]: collision < standing still < goal, and crawling < goal")
