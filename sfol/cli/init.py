"""`sfol init`: a file to start from."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from sfol.cli.app import app
from sfol.cli.inputs import SUFFIXES
from sfol.cli.output import line, stdout
from sfol.errors import UsageError
from sfol.tools.starting import DOMAIN, SUBJECT, parse_numbers, starting_text
from sfol.tools.texts import visible
from sfol.writing import replacing

_NAMES = "names of the observation's numbers, in order"


@app.command()
def init(
    file: Annotated[Path, typer.Argument(help="The new file.", show_default=False)],
    subject: Annotated[
        str | None, typer.Option(help=f"Whom the rules reward, in one word. [default: {SUBJECT}]")
    ] = None,
    domain: Annotated[
        str | None, typer.Option(help="What it should do, in a sentence.", show_default=False)
    ] = None,
    observe: Annotated[
        str | None,
        typer.Option(
            help=f"The {_NAMES}, such as `position=2.4,_,angle=0.2,_`: how far from 0 each may be "
            "(1 if nothing is said), and _ for what does not matter.",
            show_default=False,
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that exists.")] = False,
) -> None:
    """Write a small knowledge base with comments and tests, to start from.

    Without options it asks, if it is run in a terminal; otherwise it writes rules for a robot
    vacuum. With `--observe` facts are read off the environment's observation, so that no program
    has to make them.

    Example: `sfol init my_rules.yaml && sfol test my_rules.yaml`
    """
    if file.suffix not in SUFFIXES:
        raise UsageError(
            f"'{file}' is no YAML file", name=str(file), suggestion=f"such as {file.stem}.yaml"
        )
    if file.exists() and not force:
        raise UsageError(f"'{file}' exists", name=str(file), suggestion="--force replaces it")
    if sys.stdin.isatty() and (subject, domain, observe) == (None, None, None):
        subject, domain, observe = _asked()
    numbers, width = parse_numbers(observe) if observe else ((), 0)
    text = starting_text(
        file.stem,
        subject=subject or SUBJECT,
        domain=domain or DOMAIN,
        numbers=numbers,
        width=width,
    )
    with replacing(file) as part:
        part.write_text(text, encoding="utf-8")
    line(stdout(), f"{visible(file)}: written. Next: sfol test {visible(file)}")


def _asked() -> tuple[str, str, str]:
    return (
        typer.prompt("Whom do the rules reward, in one word?", default=SUBJECT),
        typer.prompt("What should it do, in a sentence?", default=DOMAIN),
        typer.prompt(
            f"The {_NAMES}, such as position=2.4,_,angle=0.2,_\n"
            "(nothing, if your program makes the facts)",
            default="",
            show_default=False,
        ),
    )
