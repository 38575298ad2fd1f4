"""Radar plots of the driving characteristics, outward being better.

Source: paper, section "Model Evaluation" and its figure of driving characteristic metrics.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import nan, pi
from typing import TYPE_CHECKING

from env.study.figures.contenders import TRAFFIC, Group, in_order
from env.study.figures.driving import CHARACTERISTICS, Characteristic, DrivingRow
from env.study.figures.style import WIDTH, Look, caption, looks
from env.study.figures.texts import plain
from sfol.tools.plotting import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.projections.polar import PolarAxes

HALFWAY = 0.5  # where everybody is drawn on an axis on which all are equal

_HOLE = 0.3  # inner radius, so that the worst don't all meet in one point
_TURN = 2 * pi / len(CHARACTERISTICS)
_ANGLES = [number * _TURN for number in range(len(CHARACTERISTICS))]
_SHADES = {"safety": "0.93", "efficiency": "0.82", "comfort": "1.0"}


@dataclass(frozen=True)
class Axis:
    """The range of a characteristic, over all setups and all traffic.

    Attributes:
        worst: is drawn innermost; None where nobody has the number.
        best: is drawn outermost; None likewise.
    """

    worst: float | None
    best: float | None

    @classmethod
    def over(cls, values: Iterable[float | None], *, starred: bool) -> Axis:
        """Return the axis on which all these values lie.

        Args:
            values: None stands for "it has none".
            starred: whether less is better.
        """
        known = [value for value in values if value is not None]
        if not known:
            return cls(None, None)
        ends = (max(known), min(known)) if starred else (min(known), max(known))
        return cls(*ends)

    @property
    def flat(self) -> bool:
        """Whether there is a range at all, and it is a single number."""
        return self.worst is not None and self.worst == self.best

    def outward(self, value: float | None) -> float:
        """Return where a value lies: 0 the worst, 1 the best, nan where there is none."""
        if value is None or self.worst is None or self.best is None:
            return nan
        return HALFWAY if self.flat else (value - self.worst) / (self.best - self.worst)


def axes_of(rows: Sequence[DrivingRow]) -> dict[str, Axis]:
    """Return the axis of each characteristic, by its name."""
    return {
        c.name: Axis.over([row.value(c) for row in rows], starred=c.starred)
        for c in CHARACTERISTICS
    }


def draw_radar(rows: Sequence[DrivingRow], groups: Sequence[Group]) -> Figure:
    """Draw a row of three plots, low, medium and high traffic, for each group of setups.

    Args:
        rows: of setups, at least one.
        groups: of setups; one of whom nobody has driven is left out.
    """
    axes = axes_of(rows)
    driven = {row.contender.name for row in rows}
    shown = [group for group in groups if driven & set(group.labels)]
    look = looks(in_order(groups))
    figure = new_figure(WIDTH, 0.9 + 3.0 * len(shown))
    parts = figure.subfigures(len(shown), 1, squeeze=False)[:, 0]
    for part, group in zip(parts, shown, strict=True):
        plots = part.subplots(1, len(TRAFFIC), subplot_kw={"projection": "polar"})
        for plot, traffic in zip(plots, TRAFFIC, strict=True):
            here = {row.contender.name: row for row in rows if row.traffic == traffic}
            _frame(plot, f"{traffic} traffic")
            _draw(plot, {name: here[name] for name in group.labels if name in here}, axes, look)
        part.suptitle(plain(group.title), fontsize=9)
        _legend(
            part, {plain(group.labels[name]): look[name] for name in group.labels if name in driven}
        )
    caption(figure, _caption(rows, axes))
    return figure


def _frame(plot: PolarAxes, title: str) -> None:
    """Draw what is the same in every plot: rings, groups and names of characteristics."""
    plot.set_theta_zero_location("N")
    plot.set_theta_direction(-1)
    plot.set_ylim(0.0, 1.05)
    plot.set_rorigin(-_HOLE)
    plot.set_yticks([0.0, 0.5, 1.0], labels=[])
    labels = [c.label.replace(" ", "\n", 1) for c in CHARACTERISTICS]
    plot.set_xticks(_ANGLES, labels=labels, fontsize=6)
    plot.tick_params(pad=3)
    plot.grid(color="0.7", linewidth=0.5)
    for edge in ("polar", "inner"):
        plot.spines[edge].set_color("0.7")
    plot.set_title(title, fontsize=8, pad=8)
    for angle, characteristic in zip(_ANGLES, CHARACTERISTICS, strict=True):
        plot.bar(angle, 1.05, width=_TURN, color=_SHADES[characteristic.group], zorder=0)


def _draw(
    plot: PolarAxes,
    rows: Mapping[str, DrivingRow],
    axes: Mapping[str, Axis],
    look: Mapping[str, Look],
) -> None:
    for name, row in rows.items():
        values = [axes[c.name].outward(row.value(c)) for c in CHARACTERISTICS]
        style = look[name]
        plot.plot(
            [*_ANGLES, _ANGLES[0]],
            [*values, values[0]],
            color=style.color,
            linestyle=style.linestyle,
            marker=style.marker,
            markersize=3.5,
            linewidth=1.2,
            clip_on=False,
        )


def _legend(part: SubFigure, look: Mapping[str, Look]) -> None:
    from matplotlib.lines import Line2D  # noqa: PLC0415  (an extra, and slow to import)

    lines = [
        Line2D([], [], color=x.color, linestyle=x.linestyle, marker=x.marker, markersize=4)
        for x in look.values()
    ]
    part.legend(
        lines,
        list(look),
        fontsize=7,
        ncols=len(lines),
        loc="outside lower center",
        frameon=False,
        handlelength=3.5,
    )


def _caption(rows: Sequence[DrivingRow], axes: Mapping[str, Axis]) -> str:
    ranges = [_range(c, axes[c.name]) for c in CHARACTERISTICS]
    lines = [
        "Outward is better: axes marked * are inverted. Inner ring → outer ring, the worst and the "
        "best of all setups in all traffic:",
        ";  ".join(ranges[:4]) + ";",
        ";  ".join(ranges[4:]) + ".",
        "Light grey: safety. Dark grey: efficiency. White: comfort. Both occlusions and all seeds "
        "together.",
        "Near misses leave collisions out: whoever always collides has none.",
    ]
    flat = [c.label for c in CHARACTERISTICS if axes[c.name].flat]
    if flat:
        lines.append(f"All are equal, and drawn halfway: {', '.join(flat)}.")
    missing = _missing(rows)
    if missing:
        lines.append(f"A gap in a line: no episode has the number. {missing}")
    absent = _absent(rows)
    if absent:
        lines.append(f"Not drawn, since both occlusions were not driven yet: {absent}.")
    return "\n".join(lines)


def _range(characteristic: Characteristic, axis: Axis) -> str:
    if axis.worst is None or axis.best is None:
        return f"{characteristic.label} has nobody"
    return f"{characteristic.label} {axis.worst:.3g} → {axis.best:.3g} {characteristic.unit}"


def _missing(rows: Sequence[DrivingRow]) -> str:
    """Return who has no value of what, in which traffic."""
    parts = []
    for characteristic in CHARACTERISTICS:
        lacking = [
            f"{row.contender.name} ({row.traffic})"
            for row in rows
            if row.value(characteristic) is None
        ]
        if lacking:
            parts.append(f"{characteristic.label}: {', '.join(lacking)}.")
    return " ".join(parts)


def _absent(rows: Sequence[DrivingRow]) -> str:
    """Return who has driven in some traffic, but not in this one."""
    driven = {(row.contender.name, row.traffic) for row in rows}
    names = dict.fromkeys(row.contender.name for row in rows)
    places = [(name, traffic) for name in names for traffic in TRAFFIC]
    absent = [place for place in places if place not in driven]
    return ", ".join(f"{name} ({traffic})" for name, traffic in absent)
