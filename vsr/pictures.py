"""Pictures of what the perception sees: classes, entities, facts, attention, decoded vectors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sfol.errors import UsageError
from sfol.tools.plotting import new_figure
from vsr.arrays import checked_array
from vsr.classes import CLASS_COUNT, COLOURS, DESCRIPTOR_CLASSES, SemanticClass
from vsr.entities import ClassMap, Direction, Entity, checked_classes
from vsr.hypervectors.codebook import GRID
from vsr.hypervectors.decoding import DecodedEntity

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Rgb = NDArray[np.uint8]

_BACKGROUND = (150, 150, 150)
_ARROWS = {Direction.LEFT_OF: "←", Direction.RIGHT_OF: "→", Direction.BELOW_OF: "↓"}
_WHOLE = 1.0 + 1e-4  # a share, with rounding
_SHOWN = 0.1  # parts of a cell below this are not drawn
# The colour of each class, uint8 (28, 3).
PALETTE = np.array(
    [COLOURS.get(kind, _BACKGROUND) for kind in list(SemanticClass)[:CLASS_COUNT]], np.uint8
)


def overlay(gray: NDArray[np.uint8], classes: ClassMap, strength: float = 0.45) -> Rgb:
    """Return a frame tinted with the colours of its classes.

    Args:
        gray: uint8 (H, W), grey values.
        classes: uint8 (H, W), a class map.
        strength: how strong the tint is, 0 to 1.

    Returns:
        uint8 (H, W, 3).

    Raises:
        UsageError: the arrays are not what they should be, or of two sizes.
    """
    checked_array(gray, np.uint8, checked_classes(classes).shape, "gray")
    if not 0.0 <= strength <= 1.0:
        raise UsageError(f"a strength of {strength}", name="strength", suggestion="0 to 1")
    tinted = (1.0 - strength) * gray[..., None] + strength * PALETTE[classes]
    return _rounded(tinted)


def attention_overlay(gray: NDArray[np.uint8], layers: NDArray[np.float32]) -> Rgb:
    """Return a frame in which only what the entities' layers attend to is bright.

    Args:
        gray: uint8 (H, W), grey values.
        layers: float32 (k, n, n), the share of each cell of a grid that each entity covers, such
            as a layout's attention.

    Returns:
        uint8 (H, W, 3); cells that entities cover well are also tinted.

    Raises:
        UsageError: the arrays are not what they should be, or a share is not from 0 to 1.
    """
    height, width = checked_array(gray, np.uint8, ("H", "W"), "gray").shape
    count, side = (*layers.shape, 0, 0)[:2] if isinstance(layers, np.ndarray) else (0, 0)
    checked_array(layers, np.float32, (count, side, side), "layers")
    if layers.size and not (layers.min() >= 0.0 and layers.max() <= _WHOLE):
        raise UsageError("a share of a cell is not from 0 to 1", name="layers")
    cells = layers.max(axis=0, initial=0.0)
    rows, columns = (np.arange(size) * cells.shape[0] // size for size in (height, width))
    attention = np.sqrt(cells[np.ix_(rows, columns)])[..., None]  # small shares are seen, too
    bright = 0.4 * gray[..., None] + 0.6 * np.array(COLOURS[SemanticClass.PEDESTRIAN])
    dark = 0.45 * gray[..., None] * np.ones(3)
    return _rounded((1.0 - attention) * dark + attention * bright)


def draw_scene(
    gray: NDArray[np.uint8],
    classes: ClassMap,
    entities: Sequence[Entity],
    layers: NDArray[np.float32],
    facts: Iterable[object] = (),
) -> Figure:
    """Draw a frame with its classes and entities, what SF attends to, and the facts.

    Args:
        gray: uint8 (H, W), grey values.
        classes: uint8 (H, W), the class map.
        entities: what was found.
        layers: float32 (k, n, n), as for `attention_overlay`.
        facts: atoms, or anything else that says in one line what it is.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    figure = _figure(12.0, 4.4)
    seen, attended, text = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 0.7))
    seen.imshow(overlay(gray, classes))
    seen.set_title("classes and entities")
    for entity in entities:
        _draw_box(seen, entity)
    attended.imshow(attention_overlay(gray, layers))
    attended.set_title("attention")
    _write(text, [str(fact) for fact in facts])
    text.set_title("facts")
    for axis in (seen, attended, text):
        axis.set_axis_off()
    return figure


def _draw_box(axis: Axes, entity: Entity) -> None:
    from matplotlib.patches import Rectangle  # noqa: PLC0415  (an extra, and slow to import)
    from matplotlib.patheffects import withStroke  # noqa: PLC0415

    top, left, bottom, right = entity.box
    colour = _colour(entity.kind)
    corner = (left - 0.5, top - 0.5)
    axis.add_patch(
        Rectangle(corner, right - left, bottom - top, fill=False, edgecolor=colour, linewidth=1.2)
    )
    # slanted, so that the names of people who stand side by side can be read
    name = axis.text(*corner, entity.name, color="w", fontsize=7, rotation=50, va="bottom")
    name.set(path_effects=[withStroke(linewidth=2, foreground="k")], in_layout=False)


def draw_decoded(entities: Sequence[DecodedEntity], title: str = "decoded") -> Figure:
    """Draw what was read from a vector: cells in the colours of classes, and neighbours.

    Args:
        entities: what `Decoder.decode` returned.
        title: what the picture is called.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    figure = _figure(11.0, 5.0)
    grid, text = figure.subplots(1, 2, width_ratios=(1.0, 1.1))
    grid.imshow(_cells(entities), extent=(0, GRID, GRID, 0))
    grid.set_xticks(range(GRID + 1), minor=True)
    grid.set_yticks(range(GRID + 1), minor=True)
    grid.grid(which="minor", color="0.85", linewidth=0.4)
    grid.set_title(title)
    lines = []
    for number, entity in enumerate(entities, start=1):
        row, column = entity.centre
        grid.text(column, row, str(number), ha="center", va="center", weight="bold", fontsize=9)
        lines.append(f"{number:2} {_describe(entity)}")
    _write(text, lines or ["nothing is read"])
    text.set_axis_off()
    return figure


def _write(axis: Axes, lines: Sequence[str]) -> None:
    size = min(9.0, 240.0 / max(len(lines), 1))
    axis.text(0.0, 1.0, "\n".join(lines), va="top", fontsize=size, in_layout=False)


def _cells(entities: Sequence[DecodedEntity]) -> NDArray[np.float32]:
    """Return the grid as RGB, white where nothing is; each cell shows who covers most of it."""
    picture = np.ones((GRID, GRID, 3), np.float32)
    covered = np.zeros((GRID, GRID), np.float32)
    for entity in entities:
        shares = entity.coverage / entity.coverage.max(initial=1e-9)
        here = (shares > _SHOWN) & (shares > covered)
        covered[here] = shares[here]
        tint = np.minimum(shares[here], 1.0)[:, None]
        picture[here] = (1.0 - tint) + tint * np.array(_colour(entity.kind), np.float32)
    return picture


def _describe(entity: DecodedEntity) -> str:
    """Return one line, such as ``pedestrian (29)  ← truck  ↓ road, sidewalk``."""
    beside = [
        (arrow, [k.name.lower() for k in DESCRIPTOR_CLASSES if (k, side) in entity.neighbours])
        for side, arrow in _ARROWS.items()
    ]
    sides = [f"{arrow} {', '.join(names)}" for arrow, names in beside if names]
    return "  ".join([f"{entity.kind.name.lower()} ({entity.score:.0f})", *sides])


def as_rgb(figure: Figure) -> Rgb:
    """Return a figure as a picture, uint8 (H, W, 3)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415

    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    rgba: Rgb = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    return rgba[..., :3].copy()


def _rounded(picture: NDArray[np.floating[Any]]) -> Rgb:
    rounded: Rgb = picture.round().astype(np.uint8)
    return rounded


def _figure(width: float, height: float) -> Figure:
    figure = new_figure(width, height)
    figure.set_dpi(120)
    return figure


def _colour(kind: SemanticClass) -> tuple[float, float, float]:
    red, green, blue = COLOURS.get(kind, _BACKGROUND)
    return red / 255, green / 255, blue / 255
