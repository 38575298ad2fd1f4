"""The application itself: what the command `aeb` is, and how it ends."""

from __future__ import annotations

import typer

from sfol.cli import run
from sfol.errors import SfolError

app = typer.Typer(
    help="""The bundled street: an occluded pedestrian crossing, driven, explained and measured.

    Rules come from a knowledge base: change rules/crossing.yaml, or name your own with `--rules`.
    """,
    epilog="Exit codes: 0 all is well · 2 an error in the input.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Run the command line; errors of ours end with exit code 2 and no traceback."""
    run(_run, prog_name="aeb")


def _run(**arguments: str) -> None:
    """Run it, and make an error of ours of what the operating system refuses.

    Raises:
        SfolError: it has refused what no other place foresees, such as a byte on a full disk.
    """
    try:
        app(**arguments)
    except OSError as error:
        where = f"'{error.filename}': " if error.filename else ""
        raise SfolError(f"{where}{error.strerror or error}") from error


@app.callback()
def _options() -> None: ...
