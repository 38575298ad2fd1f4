"""How the commands print."""

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.text import Text

from sfol.errors import InvalidKnowledgeBase, SfolError, SilentZeroWarning, UsageError
from sfol.knowledge_base import KnowledgeBase
from sfol.logs import Log
from sfol.tools.replay import unknown_names
from sfol.tools.texts import visible

# A text as it stands, or with a style.
Part = str | tuple[str, str]


def stdout(*, markup: bool = False) -> Console:
    """Return a console for standard output; colours stand only where the program asks for them.

    Args:
        markup: whether texts in brackets are styles, as in renderables that sfol itself makes.
    """
    return Console(highlight=False, markup=markup, emoji=False)


def _stderr() -> Console:
    return Console(stderr=True, highlight=False, markup=False, emoji=False)


def escaped(text: object) -> str:
    """Return a text as a console that reads markup has to get it, to show it as it stands."""
    return escape(visible(text))


def line(console: Console, *parts: Part) -> None:
    """Print a line of texts, however long, some of them with a style such as ``green``."""
    console.print(Text.assemble(*parts), soft_wrap=True)


def print_file(text: str) -> None:
    """Print what is the content of a file, in UTF-8 like every file, unless it goes to a screen."""
    if isinstance(sys.stdout, io.TextIOWrapper) and not sys.stdout.isatty():
        sys.stdout.reconfigure(encoding="utf-8")
    print(text, end="")


def singles(error: SfolError) -> tuple[SfolError, ...]:
    """Return the errors that an error is made of."""
    return error.errors if isinstance(error, InvalidKnowledgeBase) else (error,)


def run(command: Callable[..., object], **arguments: object) -> None:
    """Run a command line; errors of ours, and of the system, end with exit code 2 in one line.

    Args:
        command: a typer application, or `typer.run`.
        arguments: what it is called with.
    """
    for stream in (sys.stdout, sys.stderr):  # a console that lacks a character shows another
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        with _warnings_in_lines():
            _run_to_its_end(command, arguments)
    except SfolError as error:
        print_errors(error)
        sys.exit(2)
    except BrokenPipeError:  # whoever reads has read enough, as head does
        _drop_output()
        sys.exit(1)
    except OSError as error:
        _drop_output()
        what = f"'{error.filename}'" if error.filename else "the output"
        print_errors(UsageError(f"{what} can't be read or written: {error.strerror or error}"))
        sys.exit(2)


class WarningLines:
    """Shows our own warnings as a line on standard error, each text once; others as before.

    It takes the place of `warnings.showwarning`. What the caller's filters make an error stays one.
    """

    def __init__(self) -> None:
        self._others = warnings.showwarning
        self._told: set[str] = set()

    def __call__(
        self, message: Warning | str, category: type[Warning], *place: Any, **named: Any
    ) -> None:
        """Show a warning; all else is where it was given, as Python knows it."""
        text = str(message)
        if not issubclass(category, SilentZeroWarning):
            self._others(message, category, *place, **named)
        elif text not in self._told:
            self._told.add(text)
            line(_stderr(), ("warning:", "yellow"), f" {visible(text)}")


@contextmanager
def _warnings_in_lines() -> Iterator[None]:
    before, warnings.showwarning = warnings.showwarning, WarningLines()
    try:
        yield
    finally:
        warnings.showwarning = before


def _run_to_its_end(command: Callable[..., object], arguments: Mapping[str, object]) -> None:
    try:
        command(**arguments)
    finally:  # here what can't be written is still told
        if sys.stdout is not None:
            sys.stdout.flush()


def _drop_output() -> None:
    """Let nothing complain again, at the end of the process, about output that goes nowhere."""
    with suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_errors(error: SfolError, *, but: Collection[str] = ()) -> None:
    """Print an error, or all errors of a knowledge base, to standard error.

    Args:
        error: what went wrong.
        but: texts of errors that were shown already.
    """
    console = _stderr()
    for single in singles(error):
        if str(single) in but:
            continue
        place = f"{visible(single.place)}: " if single.place else ""
        hint = f" — {visible(single.suggestion)}" if single.suggestion else ""
        line(console, place, ("error:", "red"), f" {visible(single.message)}{hint}")


def note_unknown(log: Log, kb: KnowledgeBase) -> None:
    """Say on standard error what of a log a knowledge base does not know and leaves out."""
    names = unknown_names(log, kb)
    if names:
        note(f"'{kb.name}' does not know {', '.join(names)}; left out")


def note(text: str) -> None:
    """Say something on standard error that is no error."""
    line(_stderr(), ("note:", "yellow"), f" {visible(text)}")
