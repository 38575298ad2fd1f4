"""Textures of the street, made by code: uint8 pictures (height, width, 3) in RGB."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from numpy.random import Generator

from env.world.meshes import Swatch

Picture = npt.NDArray[np.uint8]
Colour = tuple[float, float, float]

_SKINS: tuple[Colour, ...] = ((236, 196, 168), (214, 168, 132), (170, 116, 82), (104, 68, 48))
_HAIR: tuple[Colour, ...] = ((38, 30, 26), (70, 48, 34), (132, 96, 56), (168, 166, 162))
# Clothes are light or dark, hardly between: the camera sees no colour.
_CLOTHES: tuple[Colour, ...] = (
    (236, 234, 226),
    (24, 26, 34),
    (250, 214, 60),
    (150, 24, 30),
    (24, 52, 104),
    (246, 176, 190),
    (168, 214, 240),
    (248, 150, 60),
    (250, 250, 252),
    (28, 66, 44),
)
_TROUSERS: tuple[Colour, ...] = (
    (28, 34, 58),
    (18, 18, 20),
    (196, 178, 142),
    (48, 52, 60),
    (120, 150, 190),
)
_PAINTS: tuple[Colour, ...] = (
    (186, 28, 34),
    (28, 66, 136),
    (206, 208, 210),
    (232, 198, 60),
    (56, 104, 78),
    (132, 136, 142),
)
_LOADS: tuple[Colour, ...] = ((238, 238, 234), (222, 214, 190), (236, 196, 60), (150, 186, 214))
_WALLS: tuple[Colour, ...] = (
    (176, 108, 84),
    (214, 198, 166),
    (196, 176, 160),
    (150, 146, 140),
    (222, 216, 206),
    (188, 152, 108),
)


def palette(colours: Mapping[Swatch, Colour]) -> Picture:
    """Return a palette texture; fields that `colours` leaves out are black."""
    fields = np.zeros((1, len(Swatch), 3), np.uint8)
    for swatch, colour in colours.items():
        fields[0, swatch] = np.clip(colour, 0, 255)
    return np.repeat(fields, 4, axis=0)


def outfit(rng: Generator) -> Picture:
    """Return the palette of a person: skin, hair, clothes that differ in brightness."""
    shirt = _pick(rng, _CLOTHES)
    return palette(
        {
            Swatch.SKIN: _pick(rng, _SKINS),
            Swatch.HAIR: _pick(rng, _HAIR),
            Swatch.SHIRT: shirt,
            Swatch.TROUSERS: _pick(rng, _TROUSERS),
            Swatch.SHOES: (30, 28, 28) if rng.random() < 0.6 else (220, 220, 220),
            Swatch.BAG: _pick(rng, _CLOTHES),
        }
    )


def paintwork(rng: Generator, truck: bool) -> Picture:
    """Return the palette of a vehicle."""
    return palette(
        {
            Swatch.PAINT: _pick(rng, _LOADS if truck else _PAINTS),
            Swatch.TRIM: _pick(rng, _PAINTS) if truck else (44, 44, 46),
            Swatch.GLASS: (34, 42, 52),
            Swatch.RUBBER: (22, 22, 24),
            Swatch.METAL: (168, 170, 174),
            Swatch.TAIL_LIGHT: (226, 44, 34),
            Swatch.HEAD_LIGHT: (250, 248, 232),
            Swatch.PLATE: (244, 244, 236),
            Swatch.BAG: _pick(rng, _PAINTS),
        }
    )


def furniture(rng: Generator) -> Picture:
    """Return the palette of trees, lamps and poles."""
    green = rng.uniform(0.8, 1.15)
    return palette(
        {
            Swatch.BARK: (84, 64, 46),
            Swatch.LEAVES: (80 * green, 132 * green, 58 * green),
            Swatch.METAL: (96, 100, 104),
            Swatch.PLATE: (226, 226, 214),
        }
    )


def asphalt(rng: Generator, across: float, centre: float, strip: float) -> Picture:
    """Return 6 m of road: asphalt, a dashed centre line, a line along the parking strip.

    Args:
        rng: source of chance.
        across: width of the road in m; 5 cm a pixel, the near kerb in the first row.
        centre: distance of the centre line from the near kerb, in m.
        strip: width of the parking strip, in m.
    """
    rows = 0.05 * (np.arange(round(across / 0.05)) + 0.5)
    columns = 6.0 * (np.arange(96) + 0.5) / 96
    shade = _speckled(rng, (len(rows), 96), rng.uniform(66, 84), 5.0)
    # tyres polish two tracks in each lane
    for lane in (strip + 0.5 * (centre - strip), centre + 0.5 * (across - centre)):
        for track in (lane - 0.75, lane + 0.75):
            shade -= 7.0 * np.exp(-(((rows - track) / 0.3) ** 2))[:, None]
    shade[rows < strip] += 9.0
    shade[(rows < 0.3) | (rows > across - 0.3)] -= 14.0
    paint = rng.uniform(214, 236)
    shade[np.abs(rows - strip) < 0.075] = paint
    dashes = (np.abs(rows - centre) < 0.09)[:, None] & (columns < 3.0)
    shade[dashes] = paint
    return _tinted(shade, (1.0, 1.0, 1.03))


def zebra(rng: Generator) -> Picture:
    """Return 1 m by 1 m of crosswalk: a white stripe and a dark one, each 0.5 m wide."""
    shade = _speckled(rng, (32, 32), rng.uniform(60, 72), 4.0)
    shade[:16] = _speckled(rng, (16, 32), rng.uniform(232, 246), 6.0)
    return _tinted(shade, (1.0, 1.0, 1.0))


def paving(rng: Generator) -> Picture:
    """Return 2 m by 2 m of pavement: slabs of 1 m with joints."""
    shade = _speckled(rng, (64, 64), rng.uniform(150, 174), 4.0)
    shade[:32, :32] -= 5.0
    shade[32:, 32:] += 4.0
    shade[[0, 32]] -= 22.0
    shade[:, [0, 32]] -= 22.0
    return _tinted(shade, (1.0, 0.98, 0.94))


def kerbstone(rng: Generator) -> Picture:
    """Return 2 m of kerb."""
    shade = _speckled(rng, (8, 64), rng.uniform(186, 206), 5.0)
    shade[:, [0, 32]] -= 60.0
    return _tinted(shade, (1.0, 1.0, 0.99))


def grass(rng: Generator) -> Picture:
    """Return 4 m by 4 m of ground beyond the pavement."""
    return _tinted(_speckled(rng, (32, 32), 105, 8.0), (0.85, 1.0, 0.7))


FACADE_COLUMNS, FACADE_FLOORS = 4, 4
_CELL = 32


def facade(rng: Generator) -> Picture:
    """Return a house front: four floors of four windows, the ground floor with shop and door."""
    height, width = FACADE_FLOORS * _CELL, FACADE_COLUMNS * _CELL
    wall = np.asarray(_pick(rng, _WALLS)) * rng.uniform(0.85, 1.1)
    picture = wall * (_speckled(rng, (height, width), 100, 3.0) / 100)[..., None]
    frame = np.clip(wall * (1.35 if rng.random() < 0.6 else 0.55), 0, 245)
    tall = int(rng.integers(16, 22))
    for floor in range(FACADE_FLOORS - 1):
        top = floor * _CELL
        picture[top + _CELL - 2 : top + _CELL] = frame * 0.9
        for column in range(FACADE_COLUMNS):
            left = column * _CELL + 7
            _window(picture[top + 4 : top + tall + 8, left : left + 18], rng, frame)
    _ground_floor(picture, rng, (FACADE_FLOORS - 1) * _CELL, frame)
    return np.clip(picture, 0, 255).astype(np.uint8)


def crosswalk_sign() -> Picture:
    """Return the sign of a crosswalk: white triangle and walking person on blue."""
    picture = np.full((32, 32, 3), (24, 76, 168), np.uint8)
    rows, columns = np.mgrid[:32, :32]
    inside = (rows > 4) & (rows < 27) & (np.abs(columns - 15.5) < (rows - 4) * 0.56)
    picture[inside] = 245
    person = (np.abs(columns - 15.5) < 1.6) & (rows > 13) & (rows < 20)
    head = (columns - 15.5) ** 2 + (rows - 11.5) ** 2 < 4
    legs = (np.abs(np.abs(columns - 15.5) - (rows - 19) * 0.6) < 1.1) & (rows >= 19) & (rows < 26)
    picture[person | head | legs] = 20
    return picture


def _window(wall: npt.NDArray[np.float64], rng: Generator, frame: npt.NDArray[np.float64]) -> None:
    """Paint a window on a piece of wall, which is the frame's outer size."""
    wall[:] = frame
    panes = wall[2:-2, 2:-2]
    panes[:] = np.asarray((46, 56, 70)) * rng.uniform(0.6, 1.5)
    if rng.random() < 0.4:
        panes[: len(panes) // 2] = (205, 198, 182)
    panes[:, panes.shape[1] // 2] = frame


def _ground_floor(
    picture: npt.NDArray[np.float64],
    rng: Generator,
    top: int,
    frame: npt.NDArray[np.float64],
) -> None:
    picture[top : top + 3] = frame
    door = int(rng.integers(FACADE_COLUMNS))
    shop = rng.random() < 0.5
    for column in range(FACADE_COLUMNS):
        left = column * _CELL
        if column == door:
            picture[top + 7 : top + _CELL, left + 8 : left + 24] = frame
            leaf = np.asarray(_pick(rng, _PAINTS)) * 0.6
            picture[top + 9 : top + _CELL, left + 10 : left + 22] = leaf
            picture[top + 11 : top + 17, left + 13 : left + 19] = (180, 200, 214)
        elif shop:
            picture[top + 9 : top + 29, left + 2 : left + 30] = (58, 72, 84)
            picture[top + 4 : top + 9, left : left + _CELL] = _pick(rng, _PAINTS)
        else:
            _window(picture[top + 7 : top + 25, left + 7 : left + 25], rng, frame)


def _pick(rng: Generator, colours: tuple[Colour, ...]) -> Colour:
    return colours[int(rng.integers(len(colours)))]


def _speckled(
    rng: Generator, shape: tuple[int, int], mean: float, spread: float
) -> npt.NDArray[np.float64]:
    """Return grey values of a rough surface; coarse blots weigh more than single pixels."""
    coarse = rng.normal(0.0, spread, (shape[0] // 8 + 1, shape[1] // 8 + 1))
    blots = np.kron(coarse, np.ones((8, 8)))[: shape[0], : shape[1]]
    return mean + 0.6 * blots + rng.normal(0.0, 0.4 * spread, shape)


def _tinted(shade: npt.NDArray[np.float64], tint: Colour) -> Picture:
    return np.clip(shade[..., None] * np.asarray(tint), 0, 255).astype(np.uint8)
