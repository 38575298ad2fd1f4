"""`aeb bench`."""

import json

from env.bench import measure
from env.cli.app import app


@app.command()
def bench() -> None:
    """Measure the speed of every stage from camera to reward, in one run; prints JSON."""
    print(json.dumps(measure(), indent=2))
