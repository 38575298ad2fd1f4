"""The paper's own numbers, and which setups it compares, from ``env/paper.json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from env.evaluation.results import read_json

_FILE = Path(__file__).resolve().parents[2] / "paper.json"


@dataclass(frozen=True)
class PaperCell:
    """The paper's collision test of a setup in a cell.

    Attributes:
        success: in percent of 100 episodes.
        collision: likewise.
        timeout: likewise.
        stopping_distance: in m.
    """

    success: float
    collision: float
    timeout: float
    stopping_distance: float


@dataclass(frozen=True)
class PaperSetup:
    """A row of one of the paper's tables.

    Attributes:
        name: of the setup in this project.
        label: its name in the paper.
        cells: such as ``low/partial`` → what the paper measured.
    """

    name: str
    label: str
    cells: Mapping[str, PaperCell]


@dataclass(frozen=True)
class PaperSet:
    """One of the paper's tables: setups that are compared with each other."""

    title: str
    setups: tuple[PaperSetup, ...]


@dataclass(frozen=True)
class Paper:
    """The paper's tables.

    Attributes:
        source: where the numbers stand.
        units: of the numbers.
        remarks: on what is odd about them.
        sets: the tables.
    """

    source: str
    units: str
    remarks: tuple[str, ...]
    sets: tuple[PaperSet, ...]


def load_paper() -> Paper:
    """Read the paper's numbers."""
    return read_json(_FILE, Paper)
