"""Names of entities that are stable over time: whose box lies where one lay before has its name.

`track` is one step: what is remembered and what is seen go in, what is remembered then and a name
for everything that is seen come out. `Tracker` keeps what is remembered for those who want it kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from sfol.errors import UsageError
from vsr.classes import SemanticClass
from vsr.entities import Box, Entity
from vsr.grounding import Tracking


class Thing(Protocol):
    """What can be tracked, such as an `vsr.entities.Entity`."""

    @property
    def kind(self) -> SemanticClass:
        """Its class; a name never goes to another one."""
        ...

    @property
    def box(self) -> Box:
        """The smallest rectangle around it, in px."""
        ...


@dataclass(frozen=True)
class Track:
    """A name and what it was given to last.

    Attributes:
        name: such as ``pedestrian7``.
        kind: class of its bearer.
        box: where its bearer was seen last, in px.
        seen: when that was, in s.
    """

    name: str
    kind: SemanticClass
    box: Box
    seen: float


@dataclass(frozen=True)
class Tracks:
    """What is remembered from one step to the next; at an episode's start, nothing.

    Attributes:
        kept: the names that may be given again.
        time: of the last step, in s.
        given: how many names each class has had.
    """

    kept: tuple[Track, ...] = ()
    time: float = -math.inf
    given: Mapping[SemanticClass, int] = field(default_factory=dict)


def track(
    tracks: Tracks, things: Sequence[Thing], time: float, tracking: Tracking
) -> tuple[Tracks, tuple[str, ...]]:
    """Give everything that is seen its name.

    Names are assigned so that the boxes before and now have the greatest sum of intersections over
    unions, class by class; at first those of whoever was seen in the step before, then the others
    that are kept. What shares nothing with any of them gets a name that nobody has had, nearest
    first. So the names do not depend on the order of the things.

    Args:
        tracks: what is remembered.
        things: N of them that are seen now.
        time: now, in s.
        tracking: how long names are kept, and how far apart boxes may be.

    Returns:
        What is remembered now, and N names, each another.

    Raises:
        UsageError: the time is not after that of the step before.

    Source: the assignment is the Hungarian one (Kuhn, "The Hungarian Method for the Assignment
    Problem", 1955); whoever was seen last comes first in Wojke, Bewley and Paulus, "Simple Online
    and Realtime Tracking with a Deep Association Metric", 2017.
    """
    _check_time(time, tracks.time)
    oldest = min(time - tracking.lost_after, tracks.time)  # whoever was there just now isn't lost
    kept = [old for old in tracks.kept if old.seen >= oldest]
    nearest_first = sorted(range(len(things)), key=lambda i: _distance(things[i]))
    kinds = sorted({thing.kind for thing in things})
    names: dict[int, str] = {}
    for kind, recent in product(kinds, (True, False)):
        old = [old for old in kept if old.kind == kind and (old.seen == tracks.time) == recent]
        new = [i for i in nearest_first if things[i].kind == kind and i not in names]
        boxes = [things[i].box for i in new]
        for row, column in _pairs([one.box for one in old], boxes, tracking.slack):
            names[new[column]] = old[row].name
    given = dict(tracks.given)
    for i in nearest_first:
        if i not in names:
            kind = things[i].kind
            given[kind] = given.get(kind, 0) + 1
            names[i] = f"{kind.name.lower()}{given[kind]}"
    seen = [Track(names[i], things[i].kind, things[i].box, time) for i in nearest_first]
    hidden = [old for old in kept if old.name not in names.values()]
    return Tracks((*seen, *hidden), time, given), tuple(names[i] for i in range(len(things)))


class Tracker:
    """Names the entities of one episode, picture after picture.

    Args:
        tracking: how long names are kept, and how far apart boxes may be.
        step: from one picture to the next, in s.
    """

    def __init__(self, tracking: Tracking, step: float) -> None:
        self._tracking = tracking
        self._step = step
        self._steps = 0
        self._tracks = Tracks()

    def __call__(self, entities: Sequence[Entity]) -> tuple[Entity, ...]:
        """Return the entities of the next picture, in their order, with the names they keep."""
        time = self._steps * self._step
        self._tracks, names = track(self._tracks, entities, time, self._tracking)
        self._steps += 1
        return tuple(
            replace(entity, name=name) for entity, name in zip(entities, names, strict=True)
        )


def _check_time(time: float, before: float) -> None:
    if not before < time < math.inf:
        raise UsageError(
            f"a step at {time} s cannot follow one at {before} s",
            name="time",
            suggestion="seconds that grow from step to step; an episode begins with Tracks()",
        )


def _distance(thing: Thing) -> tuple[int, ...]:
    """Return what sorts things as `find_entities` does: lowest first, then leftmost."""
    return -thing.box.bottom, thing.box.left, *thing.box


def _pairs(before: Sequence[Box], now: Sequence[Box], slack: float) -> Iterator[tuple[int, int]]:
    """Yield which boxes are the same thing's, by their places in the sequences."""
    if not before or not now:
        return
    overlaps = overlap(_widened(before, slack), _widened(now, slack))
    for row, column in zip(*linear_sum_assignment(overlaps, maximize=True), strict=True):
        if overlaps[row, column] > 0.0:
            yield int(row), int(column)


def _widened(boxes: Sequence[Box], slack: float) -> NDArray[np.float64]:
    corners: NDArray[np.float64] = np.array(boxes, float)
    corners += np.array([-slack, -slack, slack, slack])
    return corners


def overlap(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the intersection over union of all pairs of boxes, from 0 to 1.

    Args:
        first: float (N, 4), top, left, bottom and right of each, in px.
        second: float (M, 4).

    Returns:
        float (N, M), 0 where both are empty.

    Source: Jaccard, "The Distribution of the Flora in the Alpine Zone", 1912.
    """
    corner = np.maximum(first[:, None, :2], second[:, :2])
    sides = np.minimum(first[:, None, 2:], second[:, 2:]) - corner
    shared: NDArray[np.float64] = np.maximum(sides, 0.0).prod(axis=-1)
    areas = [(boxes[:, 2:] - boxes[:, :2]).prod(axis=-1) for boxes in (first, second)]
    union = areas[0][:, None] + areas[1] - shared
    share: NDArray[np.float64] = np.divide(
        shared, union, out=np.zeros_like(shared), where=union > 0.0
    )
    return share
