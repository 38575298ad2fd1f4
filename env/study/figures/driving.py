"""Driving characteristics per setup and density of traffic, both occlusions together.

Source: paper, section "Model Evaluation", list of driving characteristic metrics.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from env.evaluation.statistics import Share
from env.study.figures.contenders import TRAFFIC, Contender, Pooled, level, metric
from env.study.figures.texts import as_cell


@dataclass(frozen=True)
class Characteristic:
    """One of the paper's eight.

    Attributes:
        name: of the metric, a row of `env.evaluation.metrics.METRICS`.
        label: what figures and tables call it; starred where less is better.
        unit: of the number as shown.
        group: of the paper.
        starred: whether less is better, so that figures invert it.
        scale: what a number is multiplied with to be shown.
    """

    name: str
    label: str
    unit: str
    group: Literal["safety", "efficiency", "comfort"]
    starred: bool
    scale: float = 1.0


CHARACTERISTICS = (
    Characteristic("min_ttc", "min TTC", "s", "safety", False),
    Characteristic("impact_speed", "impact speed*", "m/s", "safety", True),
    Characteristic("near_miss", "near misses*", "%", "safety", True, 100.0),
    Characteristic("false_braking", "false braking*", "%", "safety", True, 100.0),
    Characteristic("time_to_goal", "time to goal*", "s", "efficiency", True),
    Characteristic("rms_speed", "RMS speed", "m/s", "comfort", False),
    Characteristic("rms_acceleration", "RMS accel.*", "m/s²", "comfort", True),
    Characteristic("rms_jerk", "RMS jerk*", "m/s³", "comfort", True),
)


@dataclass(frozen=True)
class DrivingRow:
    """How somebody drives in some traffic.

    Attributes:
        contender: who.
        traffic: density.
        measured: of each characteristic, by its name.
    """

    contender: Contender
    traffic: str
    measured: dict[str, Pooled]

    def value(self, characteristic: Characteristic) -> float | None:
        """Return a characteristic as shown; None where no episode has it."""
        value = self.measured[characteristic.name].value
        return None if value is None else characteristic.scale * value


def driving_rows(contenders: Iterable[Contender]) -> list[DrivingRow]:
    """Return a row for everybody who has driven both cells with some traffic."""
    rows = []
    for contender in contenders:
        for traffic in TRAFFIC:
            measured = {
                c.name: contender.measured(level(traffic), metric(c.name)) for c in CHARACTERISTICS
            }
            complete = {name: pooled for name, pooled in measured.items() if pooled is not None}
            if complete:
                rows.append(DrivingRow(contender, traffic, complete))
    return rows


def csv_rows(rows: Sequence[DrivingRow]) -> list[dict[str, Any]]:
    """Return the rows for a CSV file, in SI units; shares are fractions."""
    return [
        {
            "driver": row.contender.name,
            "traffic": row.traffic,
            "perception": row.contender.perception,
            "seeds": len(row.measured["min_ttc"].seeds),
            **{key: x for c in CHARACTERISTICS for key, x in _csv_cells(c, row.measured[c.name])},
        }
        for row in rows
    ]


def markdown(rows: Sequence[DrivingRow]) -> str:
    """Return a table for each density of traffic."""
    header = " | ".join(f"{c.label} {c.unit}" for c in CHARACTERISTICS).replace("*", r"\*")
    parts = [
        "## Driving characteristics",
        "Means over the episodes that have the number, both occlusions and all seeds together; "
        "near misses in percent of episodes, false braking in percent of steps. Less is better "
        r"where \* stands. `driving.csv` has intervals, counts and the range over seeds.",
    ]
    for traffic in TRAFFIC:
        lines = [_markdown_row(row) for row in rows if row.traffic == traffic]
        if lines:
            title = f"### {traffic.capitalize()} traffic, driving"
            rule = "|---|--:" + "|--:" * len(CHARACTERISTICS) + "|"
            parts += [title, "\n".join([f"| | seeds | {header} |", rule, *lines])]
    return "\n\n".join(parts) + "\n"


def _csv_cells(characteristic: Characteristic, pooled: Pooled) -> list[tuple[str, Any]]:
    name, whole = characteristic.name, pooled.whole
    least, most = pooled.range or (None, None)
    about = (
        [("low", whole.low), ("high", whole.high), ("of", whole.of)]
        if isinstance(whole, Share)
        else [("episodes", whole.episodes)]
    )
    cells = [("", pooled.value), *about, ("least_seed", least), ("most_seed", most)]
    return [(f"{name}_{what}".rstrip("_"), value) for what, value in cells]


def _markdown_row(row: DrivingRow) -> str:
    values = [row.value(c) for c in CHARACTERISTICS]
    shown = ["–" if value is None else f"{value:.2f}" for value in values]
    seeds = str(len(row.measured["min_ttc"].seeds))
    return f"| {' | '.join([as_cell(row.contender.name), seeds, *shown])} |"
