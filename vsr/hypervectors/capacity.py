"""How many entities a descriptor holds before they can't be told apart.

`aeb capacity` measures it. Random scenes are encoded and decoded again, from
each SSI_i alone and from the bundle of all, and what comes out is compared with what went in.
Beside it stands what theory expects.

Source of the theory: T. A. Plate, "Holographic Reduced Representations", IEEE Transactions on
Neural Networks 6(3), 1995; E. P. Frady, D. Kleyko and F. T. Sommer, "A Theory of Sequence Indexing
and Working Memory in Recurrent Neural Networks", Neural Computation 30(6), 2018.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn
from scipy import stats
from scipy.optimize import linear_sum_assignment

from sfol.errors import UsageError
from sfol.reading import text_of
from sfol.tools.plotting import new_figure
from sfol.writing import replacing
from vsr.classes import DESCRIPTOR_CLASSES, DYNAMIC_CLASSES, SemanticClass
from vsr.entities import Box, Direction, Entity
from vsr.hypervectors.codebook import GRID, VERSION, Codebook
from vsr.hypervectors.decoding import (
    BLOCK_SIDES,
    LEAST_SCORE,
    SWEEPS,
    DecodedEntity,
    Decoder,
    block_likeness,
    template_count,
)
from vsr.hypervectors.descriptor import Layout, SceneDescriptor, attention_layers, cell_shares

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RESULTS = Path("results/capacity.json")
PICTURE = Path("docs/images/capacity.png")
PAGE = Path("docs/explanation/descriptor.md")

SIDE = 224  # of the picture, in px
# Something is always beside an entity, if only the ground below it.
LEAST_NEIGHBOURS, MOST_NEIGHBOURS = 1, 3
# Heights and widths of entities in px, smallest and largest.
SIZES: Mapping[SemanticClass, tuple[tuple[int, int], tuple[int, int]]] = {
    SemanticClass.PEDESTRIAN: ((8, 84), (4, 42)),
    SemanticClass.VEHICLE: ((14, 84), (14, 84)),
    SemanticClass.TRUCK: ((14, 84), (14, 84)),
}
DIMENSIONS = (1024, 2048, 4096, 8192)
COUNTS = (1, 2, 3, 5, 7, 10, 15, 20, 30, 40, 50)
_DRAWS = 100  # of a rectangle, on average, until a place is found
_BEGIN, _END = "<!-- capacity: begin -->", "<!-- capacity: end -->"


@dataclass(frozen=True)
class Share:
    """Which share of entities is read correctly, 0 to 1.

    Attributes:
        place: the decoded centre is less than a grid cell away in rows and in columns.
        kind: the class too.
        neighbours: and all neighbours, neither more nor fewer.
    """

    place: float
    kind: float
    neighbours: float


@dataclass(frozen=True)
class Cell:
    """One cell of the study: scenes with so many entities, in vectors of this dimension.

    Attributes:
        dimension: D.
        entities: how many there are in a scene.
        scenes: how many scenes were drawn.
        alone: read from each SSI_i by itself.
        bundle: read from VSR = Σ E_i.
        spurious: entities read from the bundle that are none, for each that is there.
        expected: what theory expects for the bundle, from and to.
    """

    dimension: int
    entities: int
    scenes: int
    alone: Share
    bundle: Share
    spurious: float
    expected: tuple[float, float]


def draw_scene(rng: np.random.Generator, count: int) -> tuple[list[Entity], Layout]:
    """Draw rectangles of random class, size and place, each with 1 to 3 random neighbours.

    As in any map, those of one class do not overlap.

    Raises:
        UsageError: so many find no place.
    """
    entities: list[Entity] = []
    for _ in range(_DRAWS * count):
        entity = _draw_entity(rng, str(len(entities)))
        if not any(_overlap(entity, other) for other in entities):
            entities.append(entity)
        if len(entities) == count:
            break
    else:
        raise UsageError(f"{count} entities find no place in one scene", name="count")
    neighbours = np.zeros((count, len(DESCRIPTOR_CLASSES) * len(Direction)), np.bool_)
    for found in neighbours:
        found[
            rng.choice(
                found.size, rng.integers(LEAST_NEIGHBOURS, MOST_NEIGHBOURS + 1), replace=False
            )
        ] = True
    layout = Layout(
        names=tuple(entity.name for entity in entities),
        kinds=np.array([DESCRIPTOR_CLASSES.index(entity.kind) for entity in entities]),
        neighbours=neighbours.reshape(count, len(DESCRIPTOR_CLASSES), len(Direction)),
        coverage=cell_shares(entities, (SIDE, SIDE), GRID),
        attention=attention_layers(entities, (SIDE, SIDE)),
    )
    return entities, layout


def _draw_entity(rng: np.random.Generator, name: str) -> Entity:
    kind = DYNAMIC_CLASSES[rng.integers(len(DYNAMIC_CLASSES))]
    height, width = (int(rng.integers(least, most + 1)) for least, most in SIZES[kind])
    top, left = int(rng.integers(SIDE - height + 1)), int(rng.integers(SIDE - width + 1))
    box = Box(top, left, top + height, left + width)
    return Entity(name, kind, 1.0, box, np.ones((height, width), np.bool_))


def _overlap(first: Entity, second: Entity) -> bool:
    return first.kind is second.kind and bool(first.on(second.box.area).any())


def measure(dimension: int, entities: int, scenes: int, seed: int = 0) -> Cell:
    """Encode and decode random scenes; every entity weighs the same, E_i = SSI_i, scaled.

    Args:
        dimension: D.
        entities: how many entities a scene has.
        scenes: how many scenes are drawn; the same for every dimension.
        seed: of the scenes.
    """
    codebook = Codebook(dimension)
    descriptor, decoder = SceneDescriptor(codebook), Decoder(codebook)
    rng = np.random.default_rng([seed, entities])
    alone, bundle, spurious, expected = [], [], [], []
    for _ in range(scenes):
        truth, layout = draw_scene(rng, entities)
        vectors = descriptor.entities([layout])
        singly = [decoder.decode(vector) for vector in vectors]
        alone += [
            compare(truth[index : index + 1], layout.neighbours[index : index + 1], found)
            for index, found in enumerate(singly)
        ]
        found = decoder.decode(vectors.sum(dim=0), most=entities)
        bundle.append(compare(truth, layout.neighbours, found))
        spurious.append(len(found) - np.count_nonzero(bundle[-1][:, 0]))
        expected.append(expectation(dimension, layout))
    low, high = np.mean(expected, axis=0)
    return Cell(
        dimension=dimension,
        entities=entities,
        scenes=scenes,
        alone=_share(alone),
        bundle=_share(bundle),
        spurious=round(float(np.mean(spurious)) / entities, 3),
        expected=(round(float(low), 3), round(float(high), 3)),
    )


def compare(
    truth: Sequence[Entity], neighbours: NDArray[np.bool_], decoded: Sequence[DecodedEntity]
) -> NDArray[np.bool_]:
    """Tell of each entity whether its place, then also its class, then all of it was read.

    Every entity is compared with one decoded entity at most; they are paired so that in all as
    many as possible are near each other and of one class.

    Args:
        truth: k entities in a picture of 224×224 px.
        neighbours: bool (k, 6, 3), as in `Layout`.
        decoded: what was read.

    Returns:
        bool (k, 3), as in `Share`.
    """
    correct = np.zeros((len(truth), 3), np.bool_)
    if not decoded:
        return correct
    centres = np.array([entity.centre for entity in truth]) * GRID / SIDE
    seen = np.array([entity.centre for entity in decoded])
    near = np.abs(centres[:, None] - seen).max(axis=-1) < 1.0
    alike = np.array([[one.kind is other.kind for other in decoded] for one in truth])
    for one, other in zip(*linear_sum_assignment(-(near * (1.0 + alike))), strict=True):
        place = near[one, other]
        kind = place and alike[one, other]
        correct[one] = place, kind, kind and _named(neighbours[one]) == decoded[other].neighbours
    return correct


def expectation(dimension: int, layout: Layout) -> tuple[float, float]:
    """Return which share of entities theory expects to be read from the sum of their vectors.

    An entity is read if its template scores higher than all M − 1 others, whose scores are noise:
    P = ∫ φ(t − μ) Φ(t)^(M−1) dt. Its own score has the mean

        μ = √(D/k) · q · (√π/2) · E|t| / √E|t|²,

    for k entities whose vectors have one length. t is a product of symbols at one frequency, where
    a symbol is a complex normal number with E|h| = √π/2, E|h|² = 1 and E|h|⁴ = 2: so
    E|t| / √E|t|² is (√π/2)³ / √2 for h_c² h_k h_d G. The first √π/2 is what comparing phases
    leaves of a term in a sum of many, and q the cosine between what the entity covers and the
    block most like it. M counts classes, blocks and sets of up to three neighbours.

    The k−1 others are noise for the first entity that is found; if each is then taken away without
    trace, the last has none. So the truth should lie between two values: all others stay, and the
    mean over 1 to k that are left.

    Args:
        dimension: D.
        layout: k entities, each with a neighbour.

    Returns:
        The lower and the upper value, 0 to 1.
    """
    half = math.sqrt(math.pi) / 2
    signal = half**4 / math.sqrt(2) * block_likeness(layout.coverage) * math.sqrt(dimension)
    left = np.arange(1, len(signal) + 1)
    best = _chance_of_best(signal / np.sqrt(left[:, None]), template_count(MOST_NEIGHBOURS))
    return float(best[-1].mean()), float(best.mean())


def _chance_of_best(means: NDArray[Any], templates: int) -> NDArray[np.float64]:
    """Return ∫ φ(t − μ) Φ(t)^(M−1) dt for each μ."""
    noise = np.linspace(-8.0, 8.0, 801)
    beaten = np.exp((templates - 1) * stats.norm.logcdf(means[..., None] + noise))
    chance: NDArray[np.float64] = np.trapezoid(stats.norm.pdf(noise) * beaten, noise, axis=-1)
    return chance


def _named(neighbours: NDArray[np.bool_]) -> set[tuple[SemanticClass, Direction]]:
    directions = list(Direction)
    return {(DESCRIPTOR_CLASSES[k], directions[d]) for k, d in np.argwhere(neighbours)}


def _share(correct: Sequence[NDArray[np.bool_]]) -> Share:
    place, kind, neighbours = np.concatenate(correct).mean(axis=0)
    return Share(*(round(float(share), 3) for share in (place, kind, neighbours)))


def table(cells: Sequence[Cell]) -> str:
    """Return the study as a Markdown table."""
    lines = [
        "| D | entities | one by one: all right | bundle: place | + class | + neighbours | theory "
        "| spurious |",
        "| ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for cell in cells:
        bundle = (cell.bundle.place, cell.bundle.kind, cell.bundle.neighbours)
        shares = " | ".join(f"{100 * share:.0f} %" for share in bundle)
        low, high = (100 * share for share in cell.expected)
        lines.append(
            f"| {cell.dimension} | {cell.entities} | {100 * cell.alone.neighbours:.0f} % "
            f"| {shares} | {low:.0f} – {high:.0f} % | {100 * cell.spurious:.0f} % |"
        )
    return "\n".join(lines)


def plot(cells: Sequence[Cell], path: Path) -> None:
    """Draw the shares over the number of entities, one picture for each dimension.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    dimensions = sorted({cell.dimension for cell in cells})
    figure = new_figure(3.2 * len(dimensions), 3.2)
    axes = figure.subplots(1, len(dimensions), squeeze=False, sharey=True)[0]
    for axis, dimension in zip(axes, dimensions, strict=True):
        _draw(axis, [cell for cell in cells if cell.dimension == dimension])
        axis.set_title(f"D = {dimension}")
        axis.set_xlabel("entities in the scene")
    axes[0].set_ylabel("share of entities read")
    axes[-1].legend(loc="lower left", fontsize="small")
    with replacing(path) as part:
        figure.savefig(part, format="png", dpi=110)


def _draw(axis: Axes, cells: Sequence[Cell]) -> None:
    counts = [cell.entities for cell in cells]
    low, high = zip(*(cell.expected for cell in cells), strict=True)
    axis.fill_between(counts, low, high, color="0.85", label="theory, bundle")
    axis.plot(counts, [cell.alone.neighbours for cell in cells], "k:", label="one by one")
    axis.plot(counts, [cell.bundle.place for cell in cells], "C0-o", ms=3, label="bundle: place")
    axis.plot(counts, [cell.bundle.kind for cell in cells], "C2--", label="+ class")
    axis.plot(
        counts, [cell.bundle.neighbours for cell in cells], "C3-s", ms=3, label="+ neighbours"
    )
    axis.set_ylim(-0.02, 1.02)
    axis.grid(alpha=0.3)


def read(path: Path, settings: Mapping[str, Any]) -> list[Cell]:
    """Return the cells of a study that was begun with the same settings; else none."""
    if not path.exists():
        return []
    study = json.loads(text_of(path, "study"))
    begun = study["settings"]  # there may be more, which decides nothing
    if {**begun, **settings} != begun:
        return []
    return [_cell(fields) for fields in study["cells"]]


def _cell(fields: Mapping[str, Any]) -> Cell:
    shares = {name: Share(**fields[name]) for name in ("alone", "bundle")}
    low, high = fields["expected"]
    return Cell(**{**fields, **shares, "expected": (low, high)})


def write(path: Path, settings: Mapping[str, Any], cells: Sequence[Cell]) -> None:
    """Write a study as JSON."""
    study = {"settings": settings, "cells": [asdict(cell) for cell in cells]}
    with replacing(path) as part:
        part.write_text(json.dumps(study, indent=1) + "\n")


def insert(page: Path, text: str) -> None:
    """Put a text between the two marks of a page.

    Raises:
        UsageError: the page has no such marks.
    """
    before, begin, rest = text_of(page, "page").partition(_BEGIN)
    _, end, after = rest.partition(_END)
    if not end:
        raise UsageError(f"'{page}' has no place for the table", name=str(page), suggestion=_BEGIN)
    with replacing(page) as part:
        part.write_text(f"{before}{begin}\n{text}\n{end}{after}")


def study(
    folder: Path, *, dimensions: Sequence[int] = DIMENSIONS, entities: int = 100, seed: int = 0
) -> None:
    """Measure how many entities a descriptor holds, and write numbers, plot and table.

    A study that was stopped goes on from where it was.

    Args:
        folder: the project's; `RESULTS`, `PICTURE` and `PAGE` are in it.
        dimensions: D, each of them.
        entities: how many are drawn for each cell, at least.
        seed: of the random scenes.
    """
    settings = {
        "seed": seed,
        "entities_per_cell": entities,
        "codebook_version": VERSION,
        "least_score": LEAST_SCORE,
        "sweeps": SWEEPS,
        "block_sides": list(BLOCK_SIDES),
    }
    torch.set_num_threads(1)
    results = folder / RESULTS
    cells = {(cell.dimension, cell.entities): cell for cell in read(results, settings)}
    wanted = [(d, count) for d in dimensions for count in COUNTS]
    columns = (*Progress.get_default_columns(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns) as progress:
        for key in progress.track(wanted, description="capacity"):
            if key not in cells:
                cells[key] = measure(*key, scenes=-(-entities // key[1]), seed=seed)
                write(results, settings, _sorted(cells))
    plot(_sorted(cells), folder / PICTURE)
    insert(folder / PAGE, table(_sorted(cells)))


def _sorted(cells: Mapping[tuple[int, int], Cell]) -> list[Cell]:
    return [cells[key] for key in sorted(cells)]
