"""`aeb bench`."""

import json

from env.cli.app import app


@app.command()
def bench() -> None:
    """Measure the speed of every stage from camera to reward, in one run; prints JSON."""
    from env.tools.bench import measure

    print(json.dumps(measure(), indent=2))
