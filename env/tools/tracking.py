"""How long do names stay with whom they were given to? Against the simulator's own bodies.

`aeb tracking` drives episodes of every cell with the simulator's perception, and counts identity
switches: of the names that count within each picture, and of those that `vsr.tracking` gives.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import track as shown
from rich.table import Table

from env import CELLS
from env.driving.drivers import Cautious
from env.driving.rollout import DrivenStep, rollout
from env.street.crossing import OccludedCrossing
from vsr.classes import SemanticClass
from vsr.entities import Box, Entity
from vsr.grounding import Tracking
from vsr.segmentation import Frame
from vsr.tracking import Tracks, track


@dataclass(frozen=True)
class Sighting:
    """One entity and whom it shows.

    Attributes:
        name: that it has within its picture.
        kind: its class.
        box: in px.
        body: the simulator's number of whoever has most of its pixels.
        pixels: how many those are.
    """

    name: str
    kind: SemanticClass
    box: Box
    body: int
    pixels: int


Episode = Sequence[Sequence[Sighting]]  # what is seen in each of its pictures


def sighting(entity: Entity, frame: Frame) -> Sighting:
    """Return whom an entity shows.

    Args:
        entity: of the frame.
        frame: has the simulator's body of each pixel.
    """
    bodies, pixels = np.unique(frame.instances[entity.box.area][entity.mask], return_counts=True)
    most = int(pixels.argmax())
    return Sighting(entity.name, entity.kind, entity.box, int(bodies[most]), int(pixels[most]))


def counted_names(episode: Episode) -> list[tuple[str, ...]]:
    """Return the names that count within each picture."""
    return [tuple(one.name for one in picture) for picture in episode]


def tracked_names(
    episode: Episode, step: float, tracking: Tracking | None = None
) -> list[tuple[str, ...]]:
    """Return the names that are kept from picture to picture.

    Args:
        episode: what is seen.
        step: from one picture to the next, in s.
        tracking: how names are kept; by default as a knowledge base keeps them that says no more.
    """
    tracks, found = Tracks(), []
    for number, picture in enumerate(episode):
        tracks, names = track(tracks, picture, number * step, tracking or Tracking())
        found.append(names)
    return found


def switches(episode: Episode, names: Iterable[Sequence[str]]) -> Counter[str]:
    """Count how often names and bodies part.

    Whoever is in several entities is seen in the one with most of their pixels; whoever has most
    of none, behind somebody else, isn't seen.

    Args:
        episode: what is seen.
        names: of each picture's sightings.

    Returns:
        ``seen``, how often somebody was, once for each picture; ``renamed``, how often by another
        name than the last time; ``reused``, how often a name showed somebody else than the last
        time.

    Source: ``renamed`` are the mismatches of Bernardin and Stiefelhagen, "Evaluating Multiple
    Object Tracking Performance: The CLEAR MOT Metrics", 2008.
    """
    called: dict[int, str] = {}
    shown_by: dict[str, int] = {}
    counts: Counter[str] = Counter()
    for picture, given in zip(episode, names, strict=True):
        pairs = sorted(zip(picture, given, strict=True), key=lambda pair: pair[0].pixels)
        now = {one.body: name for one, name in pairs}  # the last is the one with most pixels
        for body, name in now.items():
            counts["seen"] += 1
            counts["renamed"] += called.get(body, name) != name
            counts["reused"] += shown_by.get(name, body) != body
        called |= now
        shown_by |= {name: body for body, name in now.items()}
    return counts


def drives(episodes: int, first_seed: int) -> Iterator[tuple[str, float, Episode]]:
    """Drive episodes through all cells with the cautious driver.

    Args:
        episodes: how many.
        first_seed: of the first one; the others count on from it.

    Yields:
        The density of the traffic, the length of a step in s, and what was seen.
    """
    streets = [OccludedCrossing(**cell, observation="none") for cell in CELLS.values()]
    try:
        for number in range(episodes):
            street = streets[number % len(streets)]
            steps = rollout(street, Cautious(), first_seed + number, frames_every=1)
            yield street.traffic, street.control_dt, [_picture(step) for step in steps]
    finally:
        for street in streets:
            street.close()


def _picture(step: DrivenStep) -> list[Sighting]:
    assert step.frame is not None
    return [sighting(entity, step.frame) for entity in step.scene.entities]


@dataclass(frozen=True)
class _Count:
    """What is counted of some of an episode's entities, by either kind of name."""

    whose: str
    seconds: float
    counted: Counter[str]
    tracked: Counter[str]


def print_switches(*, episodes: int, seed: int) -> None:
    """Print how often names and bodies part in a minute of driving.

    Args:
        episodes: how many are driven, through all cells in turn.
        seed: of the first episode.
    """
    console = Console(highlight=False)
    driven = shown(drives(episodes, seed), "driving …", console=console, total=episodes)
    console.print(_table([count for episode in driven for count in _counts(*episode)]))


def _counts(traffic: str, step: float, episode: Episode) -> Iterator[_Count]:
    for whose, walks in (("pedestrians", True), ("others", False)):
        some = [
            [one for one in picture if (one.kind is SemanticClass.PEDESTRIAN) is walks]
            for picture in episode
        ]
        counted = switches(some, counted_names(some))
        tracked = switches(some, tracked_names(some, step))
        yield _Count(f"{traffic}: {whose}", step * len(episode), counted, tracked)


def _table(counts: Sequence[_Count]) -> Table:
    table = Table(
        title="Each minute, by names that count within a picture, and by tracked ones",
        box=SIMPLE_HEAD,
        title_justify="left",
    )
    table.add_column("", no_wrap=True)
    for head in ("minutes", "seen", "renamed", "tracked", "reused", "tracked"):
        table.add_column(head, justify="right", no_wrap=True)
    for whose in dict.fromkeys(count.whose for count in counts):
        some = [count for count in counts if count.whose == whose]
        minutes = sum(count.seconds for count in some) / 60.0
        counted = sum((count.counted for count in some), Counter[str]())
        tracked = sum((count.tracked for count in some), Counter[str]())
        pairs = [n[what] for what in ("renamed", "reused") for n in (counted, tracked)]
        table.add_row(
            whose,
            f"{minutes:.1f}",
            f"{counted['seen'] / minutes:.0f}",
            *(f"{number / minutes:.1f}" for number in pairs),
        )
    return table
