"""`sfol fmt`: regular blanks in clauses."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from sfol.cli.app import app
from sfol.cli.inputs import Sources, paths
from sfol.cli.output import line, print_errors, stdout
from sfol.errors import SfolError
from sfol.knowledge_base import KnowledgeBase
from sfol.knowledge_base.formatting import format_file
from sfol.reading import text_of
from sfol.tools.texts import visible
from sfol.writing import replacing

_COLOURS = {"+": "green", "-": "red", "@": "cyan"}


@app.command()
def fmt(
    sources: Sources,
    check: Annotated[
        bool, typer.Option("--check", help="Write nothing; exit with 1 if a file would change.")
    ] = False,
    diff: Annotated[
        bool, typer.Option("--diff", help="Write nothing; print what would change.")
    ] = False,
) -> None:
    """Format the clauses of knowledge bases.

    `a(X):-B( X ) .` becomes `a(X) :- B(X).` Comments, order, line breaks and everything that is
    no clause stay as they are. A file with errors is not touched.

    Example: `sfol fmt rules/ --diff`
    """
    console = stdout()
    changed, broken = 0, 0
    for path in paths(sources, "fmt"):
        try:
            old, new = _formatted(path)
        except SfolError as error:
            print_errors(error)
            broken += 1
            continue
        if new == old:
            continue
        changed += 1
        if diff:
            _print_diff(console, path, old, new)
        if check or diff:
            line(console, f"{visible(path)}: would be formatted")
            continue
        with replacing(path, follow_link=True) as part:
            part.write_bytes(new.encode())
        line(console, f"{visible(path)}: formatted")
    if broken:
        raise typer.Exit(2)
    if changed and (check or diff):
        raise typer.Exit(1)


def _formatted(path: Path) -> tuple[str, str]:
    """Return the text of a valid file, and the same formatted; line breaks are not translated."""
    KnowledgeBase.load(path)
    text = text_of(path)
    return text, format_file(text)


def _print_diff(console: Console, path: Path, old: str, new: str) -> None:
    changes = difflib.unified_diff(
        old.splitlines(), new.splitlines(), str(path), f"{path} formatted", lineterm=""
    )
    for change in changes:
        line(console, (visible(change), _COLOURS.get(change[:1], "default")))
