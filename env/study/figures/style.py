"""How all figures look: colours that everybody can tell apart, and lines that need none."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

from env.study.figures.texts import plain
from sfol.writing import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH = 7.5  # in, that of a page's text
_DPI = 150
_CAPTION = 125  # characters of a line below a figure
_COLOURS_OF_FILE = 128

# Okabe and Ito's colours, without the yellow, which is hard to see on white.
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#000000", "#D55E00", "#56B4E9")
# Strokes and gaps of lines: solid, dashed, dash and dot, dotted, dash and two dots.
_LINES = ((), (4, 1.5), (5, 1.5, 1, 1.5), (1, 1.2), (5, 1.5, 1, 1.5, 1, 1.5))
_MARKERS = ("o", "s", "^", "D", "v", "X", "P", "*")


@dataclass(frozen=True)
class Look:
    """What a setup or a rule looks like in every panel of a figure."""

    color: str
    linestyle: tuple[int, tuple[float, ...]]
    marker: str


def looks(names: Iterable[str]) -> dict[str, Look]:
    """Return a look for each name, by its place among them."""
    return {
        name: Look(
            _COLOURS[number % len(_COLOURS)],
            (0, _LINES[number % len(_LINES)]),
            _MARKERS[number % len(_MARKERS)],
        )
        for number, name in enumerate(dict.fromkeys(names))
    }


def caption(figure: Figure, text: str) -> None:
    """Write what a figure's reader has to know below it; long lines are broken."""
    lines = [fill(line, _CAPTION) for line in plain(text).splitlines()]
    figure.supxlabel("\n".join(lines), x=0.01, ha="left", fontsize=7, color="0.25")


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all; few colours keep the file small."""
    from PIL import Image  # noqa: PLC0415  (an extra)

    drawn = BytesIO()
    figure.savefig(drawn, format="png", dpi=_DPI)
    picture = Image.open(drawn).convert("RGB").quantize(_COLOURS_OF_FILE)
    with replacing(path) as part:
        picture.save(part, format="png", optimize=True)
