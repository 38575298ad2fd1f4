"""What recorded steps are to whoever labels them, whatever files they stand in."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from sfol.errors import FileError, Place
from sfol.reading import first_reason

if TYPE_CHECKING:
    import pyarrow as pa


BATCH_ROWS = 16_384  # of what is in memory at a time; more are not faster


@dataclass(frozen=True)
class Piece:
    """Some of the data, whose labels go to one file.

    Attributes:
        source: the file, or the folder of a data set.
        members: which of its row groups, or of its episodes.
        first: the number of their first row in the source.
        rows: how many they have.
    """

    source: Path
    members: tuple[int, ...]
    first: int
    rows: int


@dataclass(frozen=True)
class Batch:
    """Some B rows of a piece.

    Attributes:
        columns: what stands beside their labels.
        step: returns what `RewardFunction.transitions` takes of them, in its order.
        signals: name → array (B,), of those that the knowledge base does not say how to read.
    """

    columns: pa.RecordBatch
    step: Callable[[], Sequence[Any]]
    signals: Mapping[str, Any] = field(default_factory=dict)


class StepSource(Protocol):
    """Recorded steps, in an order that does not change."""

    def about(self) -> list[dict[str, Any]]:
        """Return what tells these data from others, as JSON has it."""
        ...

    def pieces(self, part_rows: int) -> Iterator[Piece]:
        """Yield all of the data, in pieces that are full with so many rows."""
        ...

    def schema(self, piece: Piece) -> pa.Schema:
        """Return that of the columns of a piece's batches."""
        ...

    def batches(self, piece: Piece) -> Iterator[Batch]:
        """Yield a piece, a bounded number of rows at a time."""
        ...


def together(sizes: Sequence[int], rows: int) -> Iterator[tuple[int, ...]]:
    """Yield the numbers of neighbours that have so many rows together; the last may have less.

    Args:
        sizes: how many rows each has.
        rows: so many are enough.
    """
    members: list[int] = []
    found = 0
    for number, size in enumerate(sizes):
        members.append(number)
        found += size
        if found >= rows or number == len(sizes) - 1:
            yield tuple(members)
            members, found = [], 0


def unreadable(path: Path, error: Exception) -> FileError:
    """Return the error for data that a library can't read.

    Args:
        path: of the data.
        error: what the library says.
    """
    return FileError(
        f"the data can't be read: {first_reason(error)}", name=path.name, place=Place(str(path))
    )
