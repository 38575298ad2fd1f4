"""Training curves: mean return and share of successes over the steps of the training.

Source: paper, section "Training Performance".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from env.study.figures.contenders import Group, in_order
from env.study.figures.style import WIDTH, Look, caption, looks
from env.study.figures.texts import plain
from env.study.study_results import CurvePoint, TrainingResult
from sfol.tools.plotting import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]
Curve = tuple[Array, Array]  # steps, and what is drawn over them

SMOOTHING = 0.05  # of a training's steps are averaged at each point


def smoothed(points: Sequence[CurvePoint], window: float) -> Curve:
    """Return the mean return around each point, over the episodes of all points near it.

    Args:
        points: in order.
        window: in steps; a point counts that is at most half of it away.

    Returns:
        Steps and returns of those points in which episodes ended.
    """
    ended = [point for point in points if point.episodes]
    steps = np.array([point.steps for point in ended], float)
    episodes = np.array([point.episodes for point in ended], float)
    totals = np.array([point.total for point in ended], float)
    near = (np.abs(steps[:, None] - steps) <= window / 2) * episodes
    return steps, near @ totals / near.sum(axis=1)


def mean_curve(curves: Sequence[Curve]) -> Curve:
    """Return the mean of several curves over the steps that all of them have been through.

    Between its points a curve is taken for straight.

    Args:
        curves: at least one, none of them empty.
    """
    first = max(steps[0] for steps, _ in curves)
    last = min(steps[-1] for steps, _ in curves)
    every = np.unique(np.concatenate([steps for steps, _ in curves]))
    common = every[(every >= first) & (every <= last)]
    return common, np.mean([np.interp(common, steps, values) for steps, values in curves], axis=0)


def draw_curves(trainings: Sequence[TrainingResult], groups: Sequence[Group]) -> Figure:
    """Draw a column for each group of setups, returns above, successes below.

    Args:
        trainings: at least one.
        groups: of setups; one of which nothing was trained is left out.
    """
    by_setup: dict[str, list[TrainingResult]] = {}
    for training in trainings:
        by_setup.setdefault(training.setup, []).append(training)
    shown = [group for group in groups if set(by_setup) & set(group.labels)]
    look = looks(in_order(groups))
    figure = new_figure(WIDTH, 5.4)
    grid = figure.subplots(2, len(shown), squeeze=False, sharex=True, sharey="row")
    for (above, below), group in zip(grid.T, shown, strict=True):
        for name in group.labels:
            runs = by_setup.get(name, [])
            _lines(above, [_returns(run) for run in runs], plain(group.labels[name]), look[name])
            _lines(below, [_successes(run) for run in runs], plain(group.labels[name]), look[name])
        above.set_title(plain(group.title), fontsize=9)
        # A short training may have no episode of its own, but it has been evaluated.
        below.legend(fontsize=7, frameon=False, loc="lower right", handlelength=3.5)
        below.set_xlabel("steps", fontsize=8)
        below.locator_params(axis="x", nbins=4)
        below.xaxis.set_major_formatter("{x:,.0f}")
        below.set_ylim(-0.03, 1.03)
    grid[0, 0].set_ylabel("return of an episode", fontsize=8)
    grid[1, 0].set_ylabel("share of successes in evaluations", fontsize=8)
    for axis in grid.flat:
        axis.grid(color="0.9", linewidth=0.6)
        axis.tick_params(labelsize=7)
    caption(figure, _caption(by_setup))
    return figure


def _returns(training: TrainingResult) -> Curve:
    return smoothed(training.curve, SMOOTHING * training.steps)


def _successes(training: TrainingResult) -> Curve:
    found = training.evaluations
    steps = np.array([evaluation["steps"] for evaluation in found], float)
    return steps, np.array([evaluation["success"] for evaluation in found], float)


def _lines(axis: Axes, curves: Sequence[Curve], label: str, look: Look) -> None:
    """Draw each seed as a thin line, and their mean as a bold one."""
    known = [curve for curve in curves if curve[0].size]
    if not known:
        return
    if len(known) > 1:
        for steps, values in known:
            axis.plot(steps, values, color=look.color, linewidth=0.6, alpha=0.45)
    steps, values = mean_curve(known)
    axis.plot(
        steps,
        values,
        label=label,
        color=look.color,
        linestyle=look.linestyle,
        marker=look.marker,
        markersize=4,
        markevery=max(steps.size // 8, 1),
        linewidth=1.5,
    )


def _caption(by_setup: Mapping[str, Sequence[TrainingResult]]) -> str:
    seeds = {name: len(runs) for name, runs in by_setup.items()}
    return (
        "Returns: mean over the episodes that ended in the "
        f"{100 * SMOOTHING:.0f} % of the steps around a point. Successes: unsmoothed.\n"
        "Thin lines are seeds, bold ones their mean; seeds: "
        + ", ".join(f"{name} {count}" for name, count in seeds.items())
        + ".\nSetups with other rules have other rewards: their returns can't be compared, their "
        "successes can."
    )
