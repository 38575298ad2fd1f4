"""The paper's two tables of the collision test, ours beside the paper's numbers.

Source: paper, section "Results", the two tables of collision tests.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from env.evaluation.statistics import Share
from env.study.figures.contenders import TRAFFIC, Contender, Contenders, Pooled, groups, metric
from env.study.figures.paper import Paper, PaperCell
from env.study.figures.texts import as_cell
from env.world.cells import CELLS, Cell

OUTCOMES = ("success", "collision", "timeout")
ANCHORS = "Scripted drivers"
NOTHING = "–"

_COLUMNS = (*OUTCOMES, "stopping_distance")
_HEADER = (
    "| | occlusion | seeds | success % | paper | collision % | paper | timeout % | paper "
    "| stop m | of | paper |\n" + "|---|---|--:" + 9 * "|--:" + "|"
)


@dataclass(frozen=True)
class CollisionRow:
    """A contender in a cell.

    Attributes:
        table: which one it belongs to.
        name: of the setup or driver.
        label: what it is called in that table.
        cell: of the street.
        contender: who drove; None if that setup has no results at all.
        measured: success, collision, timeout and stopping_distance; empty without results.
        paper: what the paper measured there, if it did.
    """

    table: str
    name: str
    label: str
    cell: Cell
    contender: Contender | None
    measured: Mapping[str, Pooled]
    paper: PaperCell | None

    @property
    def seeds(self) -> int:
        """How many training seeds, or drives of a scripted driver, were pooled."""
        return len(self.measured["success"].seeds) if self.measured else 0


def collision_rows(contenders: Contenders, paper: Paper) -> list[CollisionRow]:
    """Return all rows of all tables; scripted drivers come last."""
    # By table, since one setup stands in both of the paper's, by two labels.
    printed = {(s.title, setup.name): setup.cells for s in paper.sets for setup in s.setups}
    places = [
        (group.title, name, label, contenders.setups.get(name))
        for group in groups(paper, contenders.setups)
        for name, label in group.labels.items()
    ]
    places += [(ANCHORS, name, name, driver) for name, driver in contenders.drivers.items()]
    return [
        CollisionRow(
            table=table,
            name=name,
            label=label,
            cell=cell,
            contender=contender,
            measured=_measured(contender, cell) if contender else {},
            paper=printed.get((table, name), {}).get(str(cell)),
        )
        for table, name, label, contender in places
        for cell in CELLS
    ]


def tables(rows: Sequence[CollisionRow]) -> dict[str, list[CollisionRow]]:
    """Return the rows of each table, in order."""
    titles = dict.fromkeys(row.table for row in rows)
    return {title: [row for row in rows if row.table == title] for title in titles}


def csv_rows(rows: Sequence[CollisionRow]) -> list[dict[str, Any]]:
    """Return the rows for a CSV file: shares as fractions, the paper's as well, and metres."""
    return [
        {
            "table": row.table,
            "setup": row.name,
            "label": row.label,
            "traffic": row.cell.traffic,
            "occlusion": row.cell.occlusion,
            "perception": row.contender.perception if row.measured and row.contender else None,
            "seeds": row.seeds,
            "episodes": _episodes(row),
            **{key: value for name in _COLUMNS for key, value in _csv_cells(row, name)},
        }
        for row in rows
    ]


def markdown(rows: Sequence[CollisionRow], paper: Paper) -> str:
    """Return the tables as a text for people, one for each set and density of traffic."""
    parts = [
        "# Collision test",
        "Made by `aeb figures` from result files. Shares are in percent, with Wilson's 95 % "
        "interval in brackets; episodes of several training seeds are pooled, and the smallest and "
        "largest share of a seed follow in braces. The interval takes episodes for independent and "
        "so says nothing of how trainings differ: the braces do. *stop* is the mean stopping "
        "distance over those episodes, *of* so many, that have such a stop. "
        f"{NOTHING} stands where nothing was measured. *paper*: {paper.source}.",
        "  \n".join([*_perceptions(rows), *paper.remarks]),
    ]
    for title, table in tables(rows).items():
        parts.append(f"## {as_cell(title)}")
        for traffic in TRAFFIC:
            lines = [_markdown_row(row) for row in table if row.cell.traffic == traffic]
            parts += [f"### {traffic.capitalize()} traffic", "\n".join([_HEADER, *lines])]
    return "\n\n".join(part for part in parts if part) + "\n"


def short(row: CollisionRow) -> str:
    """Return what was measured in two short lines: outcomes in percent, and metres."""
    if not row.measured:
        return NOTHING
    outcomes = "/".join(percent(row.measured[name].value) for name in OUTCOMES)
    return f"{outcomes}\n{metres(row.measured['stopping_distance'].value)}"


def short_paper(row: CollisionRow) -> str:
    """Return what the paper measured in the same form."""
    if row.paper is None:
        return NOTHING
    outcomes = "/".join(_printed(row.paper, name, 0) for name in OUTCOMES)
    return f"{outcomes}\n{_printed(row.paper, 'stopping_distance', 2)}"


def percent(share: float | None) -> str:
    """Return a share as people read it."""
    return NOTHING if share is None else f"{100 * share:.0f}"


def metres(value: float | None) -> str:
    """Return a length as people read it."""
    return NOTHING if value is None else f"{value:.2f}"


def _measured(contender: Contender, cell: Cell) -> dict[str, Pooled]:
    found = {name: contender.measured([cell], metric(name)) for name in _COLUMNS}
    return {name: pooled for name, pooled in found.items() if pooled is not None}


def _episodes(row: CollisionRow) -> int:
    return row.contender.episodes * row.seeds if row.contender else 0


def _csv_cells(row: CollisionRow, name: str) -> Iterator[tuple[str, float | None]]:
    pooled = row.measured.get(name)
    yield name, pooled.value if pooled else None
    whole = pooled.whole if pooled else None
    if name in OUTCOMES:
        yield f"{name}_low", whole.low if isinstance(whole, Share) else None
        yield f"{name}_high", whole.high if isinstance(whole, Share) else None
    else:
        yield f"{name}_episodes", whole.episodes if whole and not isinstance(whole, Share) else None
    least, most = pooled.range if pooled and pooled.range else (None, None)
    yield f"{name}_least_seed", least
    yield f"{name}_most_seed", most
    printed = getattr(row.paper, name) if row.paper else None
    scale = 100 if name in OUTCOMES else 1
    yield f"{name}_paper", None if printed is None else printed / scale


def _markdown_row(row: CollisionRow) -> str:
    cells = [as_cell(row.label), row.cell.occlusion, str(row.seeds) if row.measured else NOTHING]
    for name in OUTCOMES:
        cells += [_share(row.measured.get(name)), _printed(row.paper, name, 0)]
    cells += [*_stop(row.measured.get("stopping_distance"))]
    cells += [_printed(row.paper, "stopping_distance", 2)]
    return f"| {' | '.join(cells)} |"


def _share(pooled: Pooled | None) -> str:
    if pooled is None or not isinstance(pooled.whole, Share):
        return NOTHING
    whole = pooled.whole
    text = f"{percent(whole.share)} [{percent(whole.low)}–{percent(whole.high)}]"
    if pooled.range is None:
        return text
    return f"{text} {{{'–'.join(map(percent, pooled.range))}}}"


def _stop(pooled: Pooled | None) -> tuple[str, str]:
    if pooled is None or isinstance(pooled.whole, Share):
        return NOTHING, NOTHING
    text = metres(pooled.value)
    if pooled.range is not None:
        text += f" {{{'–'.join(map(metres, pooled.range))}}}"
    return text, str(pooled.whole.episodes)


def _printed(paper: PaperCell | None, name: str, digits: int) -> str:
    return f"{getattr(paper, name):.{digits}f}" if paper else NOTHING


def _perceptions(rows: Sequence[CollisionRow]) -> list[str]:
    """Return who drove with facts from where, and over how many episodes."""
    by: dict[tuple[str, int], dict[str, None]] = {}
    for row in rows:
        if row.measured and row.contender:
            key = (row.contender.perception, row.contender.episodes)
            by.setdefault(key, {})[row.name] = None
    return [
        f"Perception `{perception}`, {episodes} episodes per cell and seed: "
        f"{', '.join(map(as_cell, names))}."
        for (perception, episodes), names in by.items()
    ]
