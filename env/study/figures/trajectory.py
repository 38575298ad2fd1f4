"""One episode over time: speed, confidences of the rules' heads, and weights.

Source: paper, section "Trajectory Analysis".
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from math import nan
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from env.driving.setup import load_setup, setup_names
from env.study.figures.style import WIDTH, caption, looks
from env.study.figures.texts import plain
from env.study.study_results import Trajectory
from sfol.knowledge_base import KnowledgeBase
from sfol.knowledge_base.loading import bundled_names
from sfol.tools.plotting import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

UNGROUPED = "all"


def draw_trajectory(trajectory: Trajectory) -> Figure:
    """Draw speed and distance, the heads of each weight, and the weights, one above the other."""
    kb, remark = knowledge_base(trajectory)
    groups = head_groups(trajectory, kb)
    times: Array = trajectory.control_dt * np.arange(len(trajectory.speed), dtype=np.float64)
    figure = new_figure(WIDTH, 2.2 + 1.6 * (len(groups) + 1))
    speed, *heads, weights = figure.subplots(
        len(groups) + 2, 1, sharex=True, height_ratios=[1.3, *[1.0] * (len(groups) + 1)]
    )
    _draw_speed(speed, times, trajectory)
    for axis, (weight, names) in zip(heads, groups.items(), strict=True):
        _draw_lines(axis, times, {name: trajectory.confidences[name] for name in names})
        axis.set_ylabel(plain(f"confidence,\n{weight}"), fontsize=8)
    _draw_lines(weights, times, dict(sorted(trajectory.weights.items())))
    weights.set_ylabel("weight", fontsize=8)
    weights.set_xlabel("time in s", fontsize=8)
    for axis in (speed, *heads, weights):
        axis.tick_params(labelsize=7)
        axis.grid(color="0.9", linewidth=0.6)
        for begin, end in at_crosswalk(trajectory):
            axis.axvspan(begin, end, color="0.85", linewidth=0)
    figure.suptitle(
        plain(
            f"{trajectory.driver}, {trajectory.traffic}/{trajectory.occlusion}, "
            f"seed {trajectory.seed}: {trajectory.ending}"
        ),
        fontsize=9,
    )
    caption(
        figure,
        "Grey: ego's front is on the crosswalk. Dashed above: distance to the nearest in the way, "
        f"if there is anybody.\n{remark}",
    )
    return figure


def knowledge_base(trajectory: Trajectory) -> tuple[KnowledgeBase | None, str]:
    """Return the rules of an episode, and a remark if they are no longer what they were.

    Setups apply several files one after the other, so their rules are looked through first, by
    hash, and then the knowledge base of that name.
    """
    name, wanted = trajectory.knowledge_base, trajectory.knowledge_base_hash
    for sources in dict.fromkeys(load_setup(setup).rules for setup in setup_names()):
        kb = KnowledgeBase.load(*sources)
        if kb.hash == wanted:
            return kb, f"Rules: {name}."
    if name not in bundled_names():  # a path in a file leads nowhere
        return None, f"Rules: {name}, which isn't at hand, so heads aren't grouped by weight."
    kb = KnowledgeBase.load(name)
    if kb.hash == wanted:
        return kb, f"Rules: {name}."
    return kb, f"Rules: {name}, which has been changed since; heads are grouped as it is now."


def head_groups(trajectory: Trajectory, kb: KnowledgeBase | None) -> dict[str, tuple[str, ...]]:
    """Return weight → those of its heads that the episode has; heads without weight are left out.

    Without a knowledge base all heads are one group.
    """
    known = trajectory.confidences
    if kb is None:
        return {UNGROUPED: tuple(known)}
    return {
        weight: tuple(head for head in kb.weights[weight].coefficients if head in known)
        for weight in sorted(kb.weights)
    }


def at_crosswalk(trajectory: Trajectory) -> Iterator[tuple[float, float]]:
    """Yield from when till when ego's front is on the crosswalk, in s."""
    begin, end = trajectory.crosswalk
    on = [begin <= position <= end for position in trajectory.position]
    edges = np.flatnonzero(np.diff(np.array([False, *on, False], int))) * trajectory.control_dt
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _draw_speed(axis: Axes, times: Array, trajectory: Trajectory) -> None:
    look = looks(("speed", "", "", "", "", "distance"))
    speed, distance = look["speed"], look["distance"]
    axis.plot(times, trajectory.speed, color=speed.color, linewidth=1.6)
    axis.set_ylabel("speed in m/s", fontsize=8, color=speed.color)
    axis.set_ylim(bottom=0.0)
    other = axis.twinx()
    known = [nan if distance is None else distance for distance in trajectory.distance]
    other.plot(times, known, color=distance.color, linestyle="--", linewidth=1.0)
    other.set_ylabel("d in m, dashed", fontsize=8, color=distance.color)
    other.set_ylim(bottom=0.0)
    other.tick_params(labelsize=7)


def _draw_lines(axis: Axes, times: Array, lines: Mapping[str, Sequence[float]]) -> None:
    for name, look in looks(lines).items():
        axis.plot(
            times,
            lines[name],
            label=plain(name).lstrip("_"),  # what begins with _ stands in no legend
            color=look.color,
            linestyle=look.linestyle,
            linewidth=1.3,
        )
    highest = max(chain(*lines.values()), default=0.0)
    axis.set_ylim(-0.05, max(1.05, 1.05 * highest))
    if lines:
        axis.legend(
            fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, handlelength=3
        )
