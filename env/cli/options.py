"""Options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

PerceptionOption = Annotated[
    Literal["simulator", "truth", "unet"],
    typer.Option(
        help="Where facts come from: the renderer's class map, the world's state without any "
        "picture (fast), or a trained network."
    ),
]
RulesOption = Annotated[str, typer.Option(help="A knowledge base: a path, or a bundled name.")]
WorkersOption = Annotated[
    int | None, typer.Option(min=1, help="Processes that drive.", show_default="one per core")
]
TrustOption = Annotated[
    bool, typer.Option("--trust", help="Load policy files from outside the project's folder, too.")
]
CellOption = Annotated[
    list[str] | None,
    typer.Option(help="A cell, such as low/full. May be given several times.", show_default="all"),
]
DriverOption = Annotated[
    list[str] | None,
    typer.Option(
        "--driver",
        help="full_throttle, never_moves, crawl, ttc_brake, cautious, oracle; trained or beyond, "
        "the policies beside the networks' weights; or a policy file (.safetensors, or .zip of "
        "stable-baselines3). May be given several times.",
        show_default="cautious",
    ),
]
DriversOption = Annotated[Path, typer.Option(help="Folder with drives of scripted drivers.")]
