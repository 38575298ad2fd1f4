"""The command `sfol`: one module per command; each adds itself to the application."""

# The order of these imports is that of `sfol --help`.
from sfol.cli import init, check, cases, show, explain, lint, fmt, diff, replay, graph, schema  # noqa: I001
from sfol.cli.app import main
from sfol.cli.output import print_errors

__all__ = [
    "cases",
    "check",
    "diff",
    "explain",
    "fmt",
    "graph",
    "init",
    "lint",
    "main",
    "print_errors",
    "replay",
    "schema",
    "show",
]
