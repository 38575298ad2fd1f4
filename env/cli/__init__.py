"""The command `aeb`: the bundled street from the command line.

A module declares what a command is called with, and imports what it does when it is run: so
`aeb --help` is quick and loads neither torch nor pybullet.
"""

# Importing a command adds it to the application; the help lists them in this order.
from env.cli import demo, evaluate, sweep, train, imitate, study, figures, bench, tools  # noqa: F401, I001
from env.cli.app import app, main
from vsr.training.cli import app as networks

app.add_typer(networks, name="networks")

__all__ = ["app", "main"]
