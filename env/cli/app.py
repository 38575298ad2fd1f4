"""The application itself: what the command `aeb` is, and how it ends."""

from __future__ import annotations

import typer

from sfol.cli import run

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
    run(app, prog_name="aeb")


@app.callback()
def _options() -> None: ...
