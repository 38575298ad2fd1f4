"""What the commands take: files, bundled names, facts, signals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer

from sfol.errors import UsageError

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
        folder = Path(source)
        if not folder.is_dir():
            yield path_or_name(source)
            continue
        found = sorted(p for p in folder.rglob("*") if p.suffix in SUFFIXES)
        if not found:
            raise UsageError(f"no knowledge base below '{source}'", name=source)
        yield from found


def path_or_name(source: str) -> str | Path:
    """Return a file as a path, and anything else as the name of a bundled knowledge base."""
    return Path(source) if Path(source).is_file() else source


def text_argument(text: str) -> str:
    """Return a text, or the content of the file that ``@FILE`` names.

    Raises:
        UsageError: the file can't be read.
    """
    if not text.startswith("@"):
        return text
    try:
        return Path(text[1:]).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"'{text[1:]}' can't be read: {error}", name=text[1:]) from None


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
