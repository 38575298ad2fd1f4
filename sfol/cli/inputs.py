"""What the commands take: files, bundled names, facts, signals."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer

from sfol.errors import UsageError
from sfol.reading import text_of

Source = Annotated[str, typer.Argument(help="A file, or a bundled name.", metavar="FILE")]
Sources = Annotated[
    list[str],
    typer.Argument(help="Files, folders, or names of bundled knowledge bases.", metavar="FILE…"),
]
LogFile = Annotated[
    Path | None, typer.Option("--log", help="A log of recorded episodes, a Parquet file.")
]
SUFFIXES = (".yaml", ".yml")


def files(sources: Sequence[str]) -> Iterator[str | Path]:
    """Yield every knowledge base that the arguments name; a folder stands for all below it.

    Raises:
        UsageError: there is none in a folder.
    """
    for source in sources:
        if not os.path.isdir(source):  # unlike Path's, it takes any text
            yield path_or_name(source)
            continue
        found = sorted(p for p in Path(source).rglob("*") if p.suffix in SUFFIXES)
        if not found:
            raise UsageError(f"no knowledge base below '{source}'", name=source)
        yield from found


def paths(sources: Sequence[str], command: str) -> Iterator[Path]:
    """Yield the files of a command that takes no bundled name; a folder stands for all below it.

    Raises:
        UsageError: an argument is neither a file nor a folder with some.
    """
    for source in files(sources):
        if isinstance(source, str) and not source.endswith(SUFFIXES):
            raise UsageError(
                f"'{source}' is no file",
                name=source,
                suggestion=f"{command} takes files and folders",
            )
        yield Path(source)


def path_or_name(source: str) -> str | Path:
    """Return a file as a path, and anything else as the name of a bundled knowledge base."""
    return Path(source) if os.path.isfile(source) else source


def text_argument(text: str) -> str:
    """Return a text, or the content of the file that ``@FILE`` names.

    Raises:
        FileError: the file can't be read.
    """
    return text_of(Path(text[1:])) if text.startswith("@") else text


def signals(arguments: Sequence[str]) -> dict[str, float]:
    """Read signals written like ``v=6.0``.

    Raises:
        UsageError: one is written otherwise.
    """
    values = {}
    for argument in arguments:
        name, _, number = argument.partition("=")
        try:
            values[name.strip()] = float(number)
        except ValueError:
            raise UsageError(
                f"'{argument}' is not a signal", name=argument, suggestion="written like v=6.0"
            ) from None
    return values
