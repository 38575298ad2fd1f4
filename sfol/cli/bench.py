"""`sfol bench`: how fast is a knowledge base?"""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from sfol.cli.app import app
from sfol.cli.inputs import Source, path_or_name
from sfol.cli.output import line, print_file, stdout
from sfol.knowledge_base import KnowledgeBase
from sfol.tools.bench import measure
from sfol.tools.texts import visible


@app.command()
def bench(
    source: Source,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Leave out PyReason's start without its cache: ten minutes."),
    ] = False,
) -> None:
    """Measure single calls, batches and gradients, both engines side by side, all in one run.

    The scene is the file's test with the most facts; the entity of which the most is said is
    repeated 1, 10, 25 and 50 times. Where facts are read off observations, so are they measured,
    on the test that observes most: single steps, arrays of many, and Gymnasium's wrappers. For
    aeb_state and cartpole, the same reward written by hand is measured in turns with the rules, on
    random steps, if both give the same. Figures are medians. With PyReason installed, it takes some
    ten minutes: once, a copy of PyReason compiles all that it has.

    Example: `sfol bench rules/aeb.yaml --quick`
    """
    kb = KnowledgeBase.load(path_or_name(source))
    with Console(stderr=True).status("measuring") as status:
        figures = measure(
            kb, quick=quick, progress=lambda stage: status.update(f"measuring: {stage}")
        )
    if as_json:
        print_file(json.dumps(figures, indent=2) + "\n")
    else:
        _print_tables(stdout(), figures)


def _print_tables(console: Console, figures: dict[str, Any]) -> None:
    line(console, f"scene: {visible(figures['scene'])}; repeated: {figures['repeated']}")
    console.print(_table("one call, by how often it is repeated", figures["single"]))
    console.print(_table("batches, by number of scenes", figures["batch"]))
    if (observed := figures["observations"]) is not None:
        line(console, f"step: {visible(observed['step'])}")
        console.print(_table("observed steps, by how many at once", observed["batch"]))
        parts = ("single", "wrappers")
        figures = {**figures, **{f"observed_{part}": observed[part] for part in parts}}
    if (compared := figures["hand_written"]) is not None:
        title = "rules and the same reward by hand, by arrays and number of steps"
        console.print(_table(title, compared))
        if any("ratio" not in row for row in compared.values()):
            line(console, "no ratio where the rewards by rules and by hand are not the same")
    names = (
        "import",
        "observed_single",
        "observed_wrappers",
        "gradient",
        "pyreason_start",
        "pyreason_start_compared",
    )
    flat = {name: figures[name] for name in names if figures.get(name)}
    for name, numbers in flat.items():
        shown = ", ".join(f"{key} {value:g}" for key, value in numbers.items())
        line(console, f"{name}: {shown}")


def _table(title: str, rows: dict[str, dict[str, float]]) -> Table:
    columns = list(dict.fromkeys(column for numbers in rows.values() for column in numbers))
    table = Table("", title=title, title_justify="left")
    for column in columns:
        table.add_column(column.replace("_", " "), justify="right")
    for name, numbers in rows.items():
        table.add_row(name, *(_cell(numbers.get(column)) for column in columns))
    return table


def _cell(number: float | None) -> str:
    return "" if number is None else f"{number:,}"
