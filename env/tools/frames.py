"""Renders sets of frames of the street, to train and to test networks on.

`aeb frames` does it. The streets of the three sets are disjoint: a set's streets
are numbered from its first seed on (`env.street.seeds`), and a seed decides everything in a street.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt
from numpy.random import Generator
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from env.street.crossing import OccludedCrossing
from env.street.seeds import FRAMES
from env.world.actors import Ego
from env.world.camera import RENDERERS, DashCamera, Renderer
from env.world.cells import CELLS, Cell
from sfol.errors import UsageError
from sfol.locking import locked_folder
from sfol.reading import content_of
from sfol.writing import replacing
from vsr.segmentation import Frame
from vsr.training.frames import CARD, FrameSet, read_shard, write_shard

Split = Literal["train", "validation", "test"]

FRAMES_PER_STREET = 10
STREETS_PER_FILE = 6 * len(CELLS)

_HZ = 10
_LAST_START = 86.0  # m; farther on, nothing but the goal is ahead
_LONGEST_WAIT = 24.0  # s, in which people spread over the street before ego comes


def render(
    split: str,
    output: Path,
    *,
    frames: int = 600,
    pairs: bool = False,
    renderer: Renderer = "street",
) -> None:
    """Render a set of frames, or go on with one that was stopped.

    Args:
        split: ``train``, ``validation`` or ``test``: streets of their own.
        output: folder for the frames.
        frames: how many, rounded up to whole streets.
        pairs: whether each is followed by the frame one control step later.
        renderer: what draws them.

    Raises:
        UsageError: there is no such split, its streets have not so many frames, or the folder holds
            others.
        SfolError: another process has the folder.
    """
    chosen = _split(split)
    count, first = math.ceil(frames / FRAMES_PER_STREET), FRAMES[chosen].start
    if not 0 < count <= len(FRAMES[chosen]):
        most = FRAMES_PER_STREET * len(FRAMES[chosen])
        raise UsageError(
            f"{frames} frames can't be rendered", name="frames", suggestion=f"1 to {most:,}"
        )
    seeds = range(first, first + count)
    with locked_folder(output), _Streets(renderer) as streets:
        card = _card(streets.of(first).camera, chosen, seeds, pairs)
        _write_card(output / CARD, card)
        with _progress() as progress:
            task = progress.add_task(f"{chosen} streets", total=count)
            for start in seeds[::STREETS_PER_FILE]:
                part = range(start, min(start + STREETS_PER_FILE, seeds.stop))
                file = output / f"{part.start}-{part[-1]}.npz"
                if not _is_complete(file):
                    write_shard(file, _columns(streets, part, pairs))
                progress.update(task, completed=part.stop - first)


def frame_set(seeds: range, *, pairs: bool, renderer: Renderer) -> FrameSet:
    """Render frames of some streets, ten of each, and keep them in memory.

    Args:
        seeds: of the streets; cells take turns.
        pairs: whether each is followed by the frame one control step later.
        renderer: what draws them.
    """
    with _Streets(renderer) as streets:
        return FrameSet(**_columns(streets, seeds, pairs), card={"renderer": RENDERERS[renderer]})


def frames_of_street(
    street: OccludedCrossing, seed: int, count: int, pairs: bool = False
) -> Iterator[tuple[int, Frame]]:
    """Yield frames of one street and the control step at which each was taken.

    Args:
        street: of any cell; it is reset.
        seed: decides everything.
        count: how many frames.
        pairs: whether each is followed by the frame one control step later, where there is one.
    """
    # Another stream than that of the street's own draws.
    rng = np.random.default_rng([seed, 1])
    street.reset(seed=seed)
    start = _start(rng)
    people, dt = street.people, 1.0 / _HZ
    for _ in range(int(_HZ * rng.uniform(0.0, _LONGEST_WAIT))):
        people.decide(start, dt)
        people.advance(dt)

    drive = _Drive(street, start, rng)
    while count:
        for _ in range(int(rng.integers(5, 11))):
            drive.step(dt)
        yield drive.steps, drive.capture()
        count -= 1
        if pairs:
            drive.step(dt)
            yield drive.steps, drive.capture()


class _Drive:
    """Ego on its way among the people of a street; mostly it brakes for them."""

    def __init__(self, street: OccludedCrossing, ego: Ego, rng: Generator) -> None:
        self.steps = 0
        self._street = street
        self._ego = ego
        self._rng = rng
        self._choose_manner()

    def step(self, dt: float) -> None:
        people = self._street.people
        people.decide(self._ego, dt)
        people.advance(dt)
        self._ego = self._ego.after(self._pedal(), dt)
        self.steps += 1
        if self.steps % (2 * _HZ) == 0:
            self._choose_manner()
        while self._ego.position > self._street.world.geometry.goal or self._touches():
            self._ego = _start(self._rng)
            self.steps += 1  # what is seen next does not follow on what was seen before

    def capture(self) -> Frame:
        people, street = self._street.people, self._street
        street.world.place_people(people.positions, people.headings, people.phases, people.speeds)
        return street.camera.capture(self._ego.position)

    def _choose_manner(self) -> None:
        rng = self._rng
        self._cruise = 0.0 if rng.random() < 0.15 else rng.uniform(1.0, 11.0)
        self._gap = rng.uniform(0.5, 3.0)
        self._attentive = rng.random() < 0.85

    def _pedal(self) -> float:
        ego, people = self._ego, self._street.people
        ahead = self._street.corridor.distances(
            np.array([ego.position]), people.positions[None], people.velocities
        ).min()
        if self._attentive and ahead < self._gap + 0.3 * ego.speed + ego.speed**2 / 10.0:
            return -1.0
        return float(np.clip(self._cruise - ego.speed, -1.0, 1.0))

    def _touches(self) -> bool:
        ego, lane = self._ego, self._street.corridor
        x, y = self._street.people.positions.T
        beside = np.abs(y - lane.centre) < lane.width / 2 + 0.4
        along = (x > ego.rear - 0.4) & (x < ego.position + 0.4)
        return bool((beside & along).any())


class _Streets:
    """One environment of each cell, built when it is first asked for."""

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer

    def __enter__(self) -> _Streets:
        self._built: dict[Cell, OccludedCrossing] = {}
        return self

    def __exit__(self, *error: object) -> None:
        for street in self._built.values():
            street.close()

    def of(self, seed: int) -> OccludedCrossing:
        """Return the street of a seed's cell; cells take turns."""
        cell = CELLS[seed % len(CELLS)]
        if cell not in self._built:
            self._built[cell] = OccludedCrossing(**cell._asdict(), renderer=self._renderer)
        return self._built[cell]


def _columns(streets: _Streets, seeds: range, pairs: bool) -> dict[str, npt.NDArray[Any]]:
    rows = [
        (seed, step, frame)
        for seed in seeds
        for step, frame in frames_of_street(streets.of(seed), seed, FRAMES_PER_STREET, pairs)
    ]
    numbers, steps, frames = zip(*rows, strict=True)
    return {
        "gray": np.stack([frame.gray for frame in frames]),
        "classes": np.stack([frame.classes for frame in frames]),
        "instances": np.stack([frame.instances for frame in frames]),
        "streets": np.array(numbers),
        "steps": np.array(steps),
    }


def _card(camera: DashCamera, split: Split, seeds: range, pairs: bool) -> dict[str, Any]:
    frames = f"--frames {FRAMES_PER_STREET * len(seeds)}" + (" --pairs" if pairs else "")
    if camera.renderer != "street":
        frames += f" --renderer {camera.renderer}"
    lens = camera.parameters
    return {
        "source": "env.tools.frames",
        "split": split,
        "renderer": RENDERERS[camera.renderer],
        "camera": {"size": lens.size, "fov": lens.fov, "height": lens.height},
        "seeds": [seeds.start, seeds[-1]],
        "frames_per_street": FRAMES_PER_STREET * (2 if pairs else 1),
        "command": f"aeb frames {split} {frames}",
    }


def _write_card(file: Path, card: dict[str, Any]) -> None:
    """Write the card, or see that the folder holds a part of the same frames.

    Raises:
        UsageError: the folder holds others.
    """
    content = json.dumps(card, indent=2) + "\n"
    if file.exists() and content_of(file, "card") != content.encode():
        raise UsageError(
            f"{file.parent} holds other frames",
            name=str(file.parent),
            suggestion=f"name another folder, or delete it; its {file.name} says what they are",
        )
    with replacing(file) as part:
        part.write_text(content, encoding="utf-8")


def _start(rng: Generator) -> Ego:
    return Ego(position=rng.uniform(0.0, _LAST_START), speed=rng.uniform(0.0, 9.0))


def _is_complete(file: Path) -> bool:
    if not file.exists():
        return False
    try:
        read_shard(file)
    except UsageError:
        return False
    return True


def _split(name: str) -> Split:
    for split in get_args(Split):
        if name == split:
            return split
    raise UsageError(
        f"there are no {name!r} streets", name=name, suggestion=", ".join(get_args(Split))
    )


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    )
