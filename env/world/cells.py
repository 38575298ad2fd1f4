"""The cells of the study: each density of traffic with each kind of occlusion."""

from __future__ import annotations

from itertools import product
from typing import Literal, NamedTuple

from sfol.errors import UsageError, did_you_mean

Traffic = Literal["low", "medium", "high"]
CellOcclusion = Literal["partial", "full"]


class Cell(NamedTuple):
    """A cell; its fields are arguments of `OccludedCrossing`."""

    traffic: Traffic
    occlusion: CellOcclusion

    @classmethod
    def parse(cls, text: str) -> Cell:
        """Return the cell that a text such as ``low/full`` names.

        Raises:
            UsageError: there is none.
        """
        cells = {str(cell): cell for cell in CELLS}
        if text not in cells:
            raise UsageError(
                f"there is no cell '{text}'", name=text, suggestion=did_you_mean(text, cells)
            )
        return cells[text]

    @property
    def id(self) -> str:
        """Its street's id for `gymnasium.make`."""
        return f"OccludedCrossing-{self.traffic.capitalize()}-{self.occlusion.capitalize()}-v0"

    def __str__(self) -> str:
        return f"{self.traffic}/{self.occlusion}"


_TRAFFIC: tuple[Traffic, ...] = ("low", "medium", "high")
_OCCLUSION: tuple[CellOcclusion, ...] = ("partial", "full")
CELLS = tuple(Cell(*cell) for cell in product(_TRAFFIC, _OCCLUSION))
