"""`aeb sweep`."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

import sfol
from env.cli.app import app
from env.cli.options import DriverOption, PerceptionOption, RulesOption, TrustOption, WorkersOption
from env.cli.progress import counting
from sfol.cli.output import escaped
from sfol.writing import check_writable


@app.command("sweep")
def sweep_command(  # noqa: PLR0913 (each is an option)
    *,
    driver: DriverOption = None,
    perception: PerceptionOption = "simulator",
    rules: RulesOption = "crossing",
    seed: Annotated[int, typer.Option(min=0, help="Of the street's looks.")] = 0,
    workers: WorkersOption = None,
    output: Annotated[Path, typer.Option(help="Folder of sweep.json.")] = Path("runs/sweep"),
    trust: TrustOption = False,
) -> None:
    """Let a child cross from behind parked vehicles at 10 to 60 km/h, as in Euro NCAP's CPNCO.

    A child walks at 5 km/h from behind a car that is parked before the crosswalk, with a box truck
    behind it, and stops for nobody. Ego comes at a test speed that full throttle just holds, and
    without braking would hit the child 4 s later with 25, 50 or 75 % of its width. The table says
    whether it stopped, passed, or hit the child, and how fast.

    Example: `aeb sweep --driver ttc_brake --driver cautious`
    """
    from env.cli import tables
    from env.driving.policies import make_driver
    from env.evaluation.parallel import cores
    from env.evaluation.results import SweepResult, versions, write_json
    from env.evaluation.sweep import APPROACHES, Sweep, run_sweeps
    from sfol.locking import locked_folder

    console = Console(highlight=False)
    kb = sfol.KnowledgeBase.load(rules)
    names = driver or ["cautious"]
    for name in names:
        make_driver(name, trust=trust)  # so that a mistake shows before anybody drives
    sweeps = [Sweep(name, kb, perception=perception, seed=seed, trust=trust) for name in names]
    file, results = output / "sweep.json", []
    with locked_folder(output):
        check_writable(file)
        with counting(console, len(sweeps) * len(APPROACHES), "approaches") as bar:
            driven = run_sweeps(sweeps, workers or cores())
            for name in names:
                results.append(list(bar.count(name, islice(driven, len(APPROACHES)))))
                console.print(tables.sweep_table(name, results[-1]))
        approaches = tuple(result for some in results for result in some)
        write_json(file, SweepResult(perception, seed, kb.name, kb.hash, versions(), approaches))
    console.print(f"Results: {escaped(file)}", soft_wrap=True)
