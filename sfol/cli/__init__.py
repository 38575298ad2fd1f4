"""The command `sfol`: one module per command; each adds itself to the application."""

# ruff: noqa: I001  (the order of these imports is that of `sfol --help`)
from sfol.cli import (
    init,
    check,
    test_command,
    show,
    explain,
    lint,
    fmt,
    migrate,
    diff,
    replay,
    label,
    graph,
    schema,
    bench,
)
from sfol.cli.app import main
from sfol.cli.output import print_errors, run

__all__ = [
    "bench",
    "check",
    "diff",
    "explain",
    "fmt",
    "graph",
    "init",
    "label",
    "lint",
    "main",
    "migrate",
    "print_errors",
    "replay",
    "run",
    "schema",
    "show",
    "test_command",
]
