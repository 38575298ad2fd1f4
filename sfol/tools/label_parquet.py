"""Recorded steps in Parquet files.

A row is a step. Its column ``observation`` is a struct, a list or a number; ``action`` and
``next_observation`` likewise; ``reward``, ``terminated`` and ``truncated`` are what the environment
said. A table without a column ``observation`` has the parts of the observation as columns of its
own, and those of the next one as ``next.<name>``. Signals that are not read stand in columns of
their names. A piece is some row groups of one file, and all its columns stand beside the labels.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sfol.errors import FileError, UsageError
from sfol.reading import opened
from sfol.tools.label_sources import BATCH_ROWS, Batch, Piece, together, unreadable

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

_BUFFER = 1 << 20  # bytes of a column that are read at once, however large a row group is
_FOOTER_END = 8  # bytes: the length of the footer, and PAR1; source: the Parquet format
_NEXT = "next."


class ParquetFiles:
    """The steps in a Parquet file, or in all of a folder.

    Args:
        data: the file, or the folder, of which the files are in the order of their names.

    Raises:
        UsageError: the folder has no such file.
    """

    def __init__(self, data: Path) -> None:
        self._files = sorted(data.glob("*.parquet")) if data.is_dir() else [data]
        if not self._files:
            raise UsageError(f"no Parquet file in '{data}'", name=str(data))

    def about(self) -> list[dict[str, Any]]:
        """Return the files' names and digests of their footers."""
        return [{"file": file.name, "footer": _footer_digest(file)} for file in self._files]

    def pieces(self, part_rows: int) -> Iterator[Piece]:
        """Yield row groups of a file that make a part together."""
        for path in self._files:
            with opened(path, "data") as file:
                metadata = _parquet(file, path).metadata
            sizes = [metadata.row_group(i).num_rows for i in range(metadata.num_row_groups)]
            first = 0
            for groups in together(sizes, part_rows):
                rows = sum(sizes[i] for i in groups)
                yield Piece(path, groups, first, rows)
                first += rows

    def schema(self, piece: Piece) -> pa.Schema:
        """Return that of a piece's file."""
        with opened(piece.source, "data") as file:
            return _parquet(file, piece.source).schema_arrow

    def batches(self, piece: Piece) -> Iterator[Batch]:
        """Yield a piece."""
        with opened(piece.source, "data") as file:
            for batch in _batches(_parquet(file, piece.source), piece):
                columns = _Columns(dict(zip(batch.schema.names, batch.columns, strict=True)))
                yield Batch(batch, partial(_step, columns), columns)


def _step(columns: _Columns) -> Sequence[Any]:
    return (
        columns.get("observation", columns),
        columns.get("action"),
        columns.get("next_observation", columns.after() or None),
        columns.get("reward"),
        columns.get("terminated"),
        columns.get("truncated"),
    )


def _footer_digest(path: Path) -> str:
    """Return a digest of a file's footer, which says where everything is and how large."""
    with opened(path, "data") as file:
        end = file.seek(0, 2)
        file.seek(max(end - _FOOTER_END, 0))
        length = int.from_bytes(file.read(4), "little")
        file.seek(max(end - _FOOTER_END - length, 0))
        return hashlib.sha256(end.to_bytes(8, "little") + file.read()).hexdigest()


def _batches(source: pq.ParquetFile, piece: Piece) -> Iterator[pa.RecordBatch]:
    import pyarrow as pa  # noqa: PLC0415

    batches = source.iter_batches(BATCH_ROWS, row_groups=list(piece.members))
    while True:
        try:
            batch = next(batches, None)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise unreadable(piece.source, error) from None
        if batch is None:
            return
        yield batch


class _Columns(Mapping[str, Any]):
    """Columns by name, as arrays with an axis B before all others; made when they are asked for.

    Args:
        columns: of pyarrow.
        prefix: of their names, for messages.
    """

    def __init__(self, columns: Mapping[str, pa.Array], prefix: str = "") -> None:
        self._columns = columns
        self._prefix = prefix

    def after(self) -> _Columns:
        """Return the columns of the next observation, where they stand beside all others."""
        own = {n.removeprefix(_NEXT): c for n, c in self._columns.items() if n.startswith(_NEXT)}
        return _Columns(own, _NEXT)

    def __getitem__(self, name: str) -> Any:
        return _values(self._columns[name], f"{self._prefix}{name}")

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)


def _values(column: pa.Array, name: str) -> Any:
    """Return a column as an array, or as columns by name.

    Raises:
        FileError: it holds something else, nothing in some row, or lists of different lengths.
    """
    import pyarrow.types as kinds  # noqa: PLC0415

    kind = column.type
    if column.null_count:
        raise FileError(f"the column '{name}' has rows without a value", name=name)
    if kinds.is_struct(kind):
        names = [kind.field(i).name for i in range(kind.num_fields)]
        return _Columns({n: column.field(n) for n in names}, f"{name}.")
    if kinds.is_list(kind) or kinds.is_large_list(kind) or kinds.is_fixed_size_list(kind):
        lengths = np.unique(np.asarray(column.value_lengths())) if len(column) else np.zeros(1, int)
        if len(lengths) > 1:
            raise FileError(
                f"the lists in the column '{name}' have different lengths: "
                f"{lengths[0]} to {lengths[-1]}",
                name=name,
                suggestion="fill them up, and say beside them which of their rows are present",
            )
        inner = _values(column.flatten(), name)
        return inner.reshape(len(column), int(lengths[0]), *inner.shape[1:])
    if not (kinds.is_floating(kind) or kinds.is_integer(kind) or kinds.is_boolean(kind)):
        raise FileError(f"the column '{name}' is of {kind}, and no number", name=name)
    return column.to_numpy(zero_copy_only=False)


def _parquet(file: Any, path: Path) -> pq.ParquetFile:
    import pyarrow as pa  # noqa: PLC0415
    import pyarrow.parquet as pq  # noqa: PLC0415

    try:
        return pq.ParquetFile(file, buffer_size=_BUFFER)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise unreadable(path, error) from None
