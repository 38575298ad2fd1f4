"""The command `aeb`: the bundled street from the command line."""

# Importing a command adds it to the application; the help lists them in this order.
from env.cli import demo, evaluate, sweep, train, study, figures, bench  # noqa: F401, I001
from env.cli.app import app, main

__all__ = ["app", "main"]
