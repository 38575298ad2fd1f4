"""A picture of the street: every cell at a few moments of one drive.

`aeb contact-sheet docs/images/cells.png` draws that of the documentation.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from PIL import Image, ImageDraw, ImageOps

from env import CELLS
from env.driving.drivers import Cautious
from env.driving.rollout import rollout
from env.street.crossing import OccludedCrossing
from env.world.camera import third_person
from sfol.errors import UsageError
from sfol.writing import replacing

_MOMENTS = (5.0, 30.0, 44.0, 52.0)  # x of ego's front, in m
_SIDE = 168  # px of a frame on the sheet
_CAPTION = 16  # px above each row
_COLOURS = 96  # of the whole sheet, to keep the file small


def contact_sheet(seed: int) -> Image.Image:
    """Return one row for each cell: frames of the dash camera, and the street from behind ego.

    Args:
        seed: of the episode, the same in every cell.
    """
    rows = [_row(name, OccludedCrossing(**cell), seed) for name, cell in CELLS.items()]
    width, height = rows[0].size
    sheet = Image.new("RGB", (width, height * len(rows)), "white")
    for number, row in enumerate(rows):
        sheet.paste(row, (0, number * height))
    return sheet


def _row(name: str, street: OccludedCrossing, seed: int) -> Image.Image:
    try:
        pictures = list(_pictures(street, seed))
    finally:
        street.close()
    row = Image.new("RGB", (sum(p.width for p in pictures), _CAPTION + _SIDE), "white")
    ImageDraw.Draw(row).text((4, 2), f"{name}, seed {seed}", "black")
    x = 0
    for picture in pictures:
        row.paste(picture, (x, _CAPTION))
        x += picture.width
    return row


def _pictures(street: OccludedCrossing, seed: int) -> Iterator[Image.Image]:
    """Yield the frames at each moment of a cautious drive, and the last one from outside."""
    drive = rollout(street, Cautious(), seed)
    for moment in _MOMENTS:
        if not any(step.info["position"] >= moment for step in drive):
            raise UsageError(
                f"with seed {seed}, a drive ends before {moment:.0f} m",
                name="seed",
                suggestion="another --seed",
            )
        frame = Image.fromarray(street.frame.gray).convert("RGB")
        yield frame.resize((_SIDE, _SIDE), Image.Resampling.LANCZOS)
    outside = Image.fromarray(third_person(street.world, street.ego.position))
    yield ImageOps.fit(outside, (_SIDE * 4 // 3, _SIDE), Image.Resampling.LANCZOS)


def save_sheet(output: Path, seed: int) -> None:
    """Draw every cell at a few moments of a cautious drive.

    Args:
        output: the PNG file, which is replaced.
        seed: of the episode in every cell.

    Raises:
        UsageError: the file can't be written, or a drive ends too early.
    """
    with replacing(output) as part:
        contact_sheet(seed).quantize(_COLOURS).save(part, format="png", optimize=True)
