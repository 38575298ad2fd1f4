"""Where the time of a training goes: a flame graph, and processor time by stage.

`aeb profile` does it.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from env.driving.setup import load_setup
from sfol.errors import SfolError, missing_extra
from sfol.locking import locked_folder
from sfol.reading import text_of
from sfol.writing import check_writable, replacing

_STEPS = 512  # of all streets, for one update; three updates are recorded
_RATE = 50  # samples a second; at 200, sampling took half a processor itself

# Function and file of each stage; a sample belongs to the innermost one that it is in.
_STAGES: Mapping[str, tuple[str, str]] = {
    "camera": ("capture", "world/camera.py"),
    "people and physics": ("_drive", "street/crossing.py"),
    "reset of a street": ("reset", "street/crossing.py"),
    "perception": ("perceive", "perception/pipeline.py"),
    "encoder": ("encode", "networks/autoencoder.py"),
    "descriptor": ("__call__", "perception/description.py"),
    "reward": ("evaluate", "sfol/reward.py"),
    "policy": ("forward", "stable_baselines3/common/policies.py"),
    "update of PPO": ("train", "stable_baselines3/ppo/ppo.py"),
}
_OTHER = "all else: transport between processes, bookkeeping"
_MOST = 100_000_000  # bytes of what was sampled
_FRAME = re.compile(r"(?P<function>.+) \((?P<file>.+):\d+\)")


def record(output: Path, perception: str) -> None:
    """Sample three updates of the main setup, workers included, by py-spy.

    Writes flame.svg, to be opened in a browser, and stages.json, which is printed as a table: the
    milliseconds of processor time that each stage costs for one step of one street.

    Args:
        output: folder for the results.
        perception: ``simulator`` or ``unet``.

    Raises:
        MissingExtraError: py-spy is not installed.
        SfolError: another process has the folder, nothing can be written there, or py-spy fails.
    """
    stacks, flame, table = (output / name for name in ("stacks.txt", "flame.svg", "stages.json"))
    with locked_folder(output):
        check_writable(stacks, flame, table)
        for kind, file in (("raw", stacks), ("flamegraph", flame)):
            _sample(kind, file, perception)
        with replacing(flame) as part:
            part.write_text(without_folders(text_of(flame, most=_MOST)), encoding="utf-8")
        stages = by_stage(text_of(stacks, most=_MOST).splitlines())
        stacks.unlink()
        with replacing(table) as part:
            part.write_text(json.dumps(stages, indent=1) + "\n", encoding="utf-8")
    Console(highlight=False).print(_table(stages))


def train(perception: str) -> None:
    """Train for the updates that are sampled."""
    from env.learning.new_model import untrained_model  # noqa: PLC0415  (slow to import)
    from env.learning.vector_streets import make_streets  # noqa: PLC0415  (slow to import)

    setup = load_setup("add")
    learning = setup.learning.model_copy(update={"rollout_steps": _STEPS})
    setup = setup.model_copy(update={"perception": perception, "learning": learning})
    streets = make_streets(setup, setup.stages[-1].cells, seed=0)
    try:
        untrained_model(setup, streets).learn(3 * _STEPS)
    finally:
        streets.close()


def by_stage(stacks: Iterable[str]) -> dict[str, float]:
    """Return the processor time of each stage, in ms for a step of one street.

    Args:
        stacks: py-spy's raw output: in each line functions from the outermost to the innermost,
            divided by semicolons, and how often they were found so.
    """
    samples: Counter[str] = Counter()
    for line in stacks:
        stack, count = line.rsplit(" ", 1)
        stage = _stage(stack)
        if stage is not None:
            samples[stage] += int(count)
    milliseconds = 1000.0 / (_RATE * 3 * _STEPS)
    return {stage: round(samples[stage] * milliseconds, 2) for stage in (*_STAGES, _OTHER)}


def without_folders(picture: str) -> str:
    """Return a flame graph that names programs without their folders, so that it can be passed on.

    Args:
        picture: py-spy's SVG, which has the commands of all processes in it.
    """
    return picture.replace(f"{Path(sys.executable).parent}/", "")


def _stage(stack: str) -> str | None:
    """Return the stage of a sample; None before the training has begun."""
    matches = map(_FRAME.fullmatch, stack.split(";"))
    frames = [match.groupdict() for match in matches if match]
    for frame in reversed(frames):
        for stage, (function, file) in _STAGES.items():
            if _name(frame) == function and frame["file"].endswith(file):
                return stage
    begun = {"learn", "_worker"} & set(map(_name, frames))
    return _OTHER if begun else None


def _name(frame: Mapping[str, str]) -> str:
    """Return a function's own name; from Python 3.11 on, py-spy puts its class before it."""
    return frame["function"].rsplit(".", 1)[-1]


def _sample(kind: str, file: Path, perception: str) -> None:
    spy = shutil.which("py-spy", path=str(Path(sys.executable).parent)) or shutil.which("py-spy")
    if spy is None:
        raise missing_extra("py-spy", "a profile needs it")
    done = subprocess.run(
        [
            *(spy, "record", "--subprocesses", "--rate", str(_RATE), "--format", kind),
            *("--output", str(file), "--"),
            *(sys.executable, "-m", "env.tools.profile", perception),
        ],
        check=False,
    )
    if done.returncode:
        raise SfolError(
            f"py-spy ended with exit code {done.returncode}; it says why above", name="py-spy"
        )


def _table(stages: Mapping[str, float]) -> Table:
    table = Table(
        "stage", title="A training step, of one street", title_justify="left", box=SIMPLE_HEAD
    )
    table.add_column("ms", justify="right")
    table.add_column("share", justify="right")
    whole = sum(stages.values())
    for stage, time in sorted(stages.items(), key=lambda item: -item[1]):
        table.add_row(stage, f"{time:.2f}", f"{time / whole:.0%}")
    table.add_row("all, of both processors", f"{whole:.2f}", "")
    return table


if __name__ == "__main__":  # what py-spy samples
    train(sys.argv[1])
