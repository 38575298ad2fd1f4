"""How the commands print."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Collection

from rich.console import Console
from rich.markup import escape

from sfol.errors import InvalidKnowledgeBase, SfolError
from sfol.knowledge_base import KnowledgeBase
from sfol.logs import Log
from sfol.tools.replay import unknown_names


def stdout() -> Console:
    """Return a console for standard output; colours stand only where the program asks for them."""
    return Console(highlight=False)


def singles(error: SfolError) -> tuple[SfolError, ...]:
    """Return the errors that an error is made of."""
    return error.errors if isinstance(error, InvalidKnowledgeBase) else (error,)


def run(command: Callable[..., object], **arguments: object) -> None:
    """Run a command line; errors of ours end with exit code 2 and no traceback.

    Args:
        command: a typer application, or `typer.run`.
        arguments: what it is called with.
    """
    for stream in (sys.stdout, sys.stderr):  # a console that lacks a character shows another
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        command(**arguments)
    except SfolError as error:
        print_errors(error)
        sys.exit(2)


def print_errors(error: SfolError, *, but: Collection[str] = ()) -> None:
    """Print an error, or all errors of a knowledge base, to standard error.

    Args:
        error: what went wrong.
        but: texts of errors that were shown already.
    """
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    for single in singles(error):
        if str(single) in but:
            continue
        place = f"{escaped(single.place)}: " if single.place else ""
        hint = f" — {escaped(single.suggestion)}" if single.suggestion else ""
        console.print(f"{place}[red]error:[/] {escaped(single.message)}{hint}")


def note_unknown(log: Log, kb: KnowledgeBase) -> None:
    """Say on standard error what of a log a knowledge base does not know and leaves out."""
    names = unknown_names(log, kb)
    if names:
        note(f"'{kb.name}' does not know {', '.join(names)}; left out")


def note(text: str) -> None:
    """Say something on standard error that is no error."""
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    console.print(f"[yellow]note:[/] {escaped(text)}")


def escaped(text: object) -> str:
    """Return a text as it is printed: no markup, and no control characters but line ends."""
    visible = (c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in str(text))
    return escape("".join(visible))
