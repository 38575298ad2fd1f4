"""The application itself: what the command `sfol` is, and how it ends."""

from __future__ import annotations

from typing import Annotated

import typer

import sfol
from sfol.cli.output import run

app = typer.Typer(
    help="""Rewards for reinforcement learning as logic that people write in YAML.

    A knowledge base is a YAML file with predicates, Horn rules, weights and reward terms.
    Name one by its path (rules/aeb.yaml), or a bundled one by its name (aeb).
    """,
    epilog="Exit codes: 0 all is well · 1 a test failed, or something was found · "
    "2 an error in the input.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Run the command line; errors of ours end with exit code 2 and no traceback."""
    run(app, prog_name="sfol")


def _version(wanted: bool) -> None:
    if wanted:
        print(sfol.__version__)
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None: ...
