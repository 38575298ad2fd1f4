"""How restless the weights are, which the paper names as its reward's weak point.

Source: paper, sections "Trajectory Analysis" and "Discussion".
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from env.evaluation.evaluate import Summary
from env.evaluation.statistics import Mean
from env.study.figures.contenders import TRAFFIC, Group, in_order, level
from env.study.figures.driving import DrivingRow
from env.study.figures.style import WIDTH, caption
from env.study.figures.texts import plain
from sfol.tools.plotting import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_EDGE: dict[str, Any] = {"edgecolor": "black", "linewidth": 0.5}
_LOOKS: dict[str, dict[str, Any]] = {
    "low": {"facecolor": "#56B4E9", "hatch": "", **_EDGE},
    "medium": {"facecolor": "#E69F00", "hatch": "///", **_EDGE},
    "high": {"facecolor": "#D55E00", "hatch": "xxx", **_EDGE},
}
_BAR = 0.27  # width of one; setups stand 1 apart


def draw_fluctuation(rows: Sequence[DrivingRow], groups: Sequence[Group]) -> Figure:
    """Draw a panel for each weight, with bars for each setup and density of traffic.

    Args:
        rows: of setups, with at least one weight.
        groups: give the order of the setups.
    """
    driven = {row.contender.name for row in rows}
    setups = [name for name in in_order(groups) if name in driven]
    weights = weights_of(rows)
    figure = new_figure(WIDTH, 0.9 + 2.2 * len(weights))
    panels = figure.subplots(len(weights), 1, squeeze=False, sharex=True, sharey=True)[:, 0]
    for axis, weight in zip(panels, weights, strict=True):
        for row in rows:
            _draw_bar(axis, setups.index(row.contender.name), row, weight)
        axis.set_title(plain(f"weight of {weight}"), fontsize=9)
        axis.set_ylabel("total variation in 1/s", fontsize=8)
        axis.grid(axis="y", color="0.9", linewidth=0.6)
        axis.set_axisbelow(True)
        axis.tick_params(labelsize=7)
    panels[-1].set_xticks(range(len(setups)), labels=list(map(plain, setups)), fontsize=8)
    _legend(figure)
    caption(
        figure,
        "Mean over episodes of Σ |w[k+1] − w[k]| / T, both occlusions and all seeds together; "
        "whiskers: smallest and largest mean of a seed.",
    )
    return figure


def weights_of(rows: Sequence[DrivingRow]) -> list[str]:
    """Return the names of all weights that were measured."""
    summaries = [s for row in rows for runs in row.contender.seeds.values() for s in runs.values()]
    return sorted({weight for summary in summaries for weight in summary.fluctuation})


def _of_summary(weight: str, summary: Summary) -> Mean:
    return summary.fluctuation.get(weight, Mean.over(()))


def _draw_bar(axis: Axes, place: int, row: DrivingRow, weight: str) -> None:
    pooled = row.contender.measured(level(row.traffic), partial(_of_summary, weight))
    if pooled is None or pooled.value is None:
        return
    x = place + (TRAFFIC.index(row.traffic) - 1) * _BAR
    axis.bar(x, pooled.value, width=_BAR, **_LOOKS[row.traffic])
    if pooled.range is not None:
        axis.vlines(x, *pooled.range, color="black", linewidth=1.2)


def _legend(figure: Figure) -> None:
    from matplotlib.patches import Patch  # noqa: PLC0415  (an extra, and slow to import)

    figure.legend(
        [Patch(**look) for look in _LOOKS.values()],
        [f"{traffic} traffic" for traffic in _LOOKS],
        fontsize=7,
        ncols=3,
        loc="outside upper center",
        frameon=False,
    )
