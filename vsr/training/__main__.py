"""``python -m vsr.training``: the commands of the networks, for those who have no street."""

from sfol.cli import run
from vsr.training.cli import app

if __name__ == "__main__":
    run(app, prog_name="python -m vsr.training")
