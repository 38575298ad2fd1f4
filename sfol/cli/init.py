"""`sfol init`: a file to start from."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Annotated

import typer
import yaml

from sfol.cli.app import app
from sfol.cli.inputs import SUFFIXES
from sfol.cli.output import line, stdout
from sfol.errors import UsageError
from sfol.tools.texts import visible
from sfol.writing import replacing


@app.command()
def init(
    file: Annotated[Path, typer.Argument(help="The new file.", show_default=False)],
    force: Annotated[bool, typer.Option("--force", help="Replace a file that exists.")] = False,
) -> None:
    """Write a small knowledge base with comments, to start from.

    Example: `sfol init my_rules.yaml && sfol test my_rules.yaml`
    """
    if file.suffix not in SUFFIXES:
        raise UsageError(
            f"'{file}' is no YAML file", name=str(file), suggestion=f"such as {file.stem}.yaml"
        )
    if file.exists() and not force:
        raise UsageError(f"'{file}' exists", name=str(file), suggestion="--force replaces it")
    text = files("sfol").joinpath("starter.yaml").read_text(encoding="utf-8")
    name = yaml.safe_dump({"name": file.stem}, allow_unicode=True)
    with replacing(file) as part:
        part.write_text(text.replace("name: starter\n", name, 1), encoding="utf-8")
    line(stdout(), f"{visible(file)}: written. Next: sfol test {visible(file)}")
