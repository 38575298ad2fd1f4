"""Recorded steps, as Parquet files, labelled with what a knowledge base makes of each.

A row is a step. Its column ``observation`` is a struct, a list or a number; ``action`` and
``next_observation`` likewise; ``reward``, ``terminated`` and ``truncated`` are what the environment
said. A table without a column ``observation`` has the parts of the observation as columns of its
own, and those of the next one as ``next.<name>``. Signals that are not read stand in columns of
their names.

The labels are written to a folder in parts, each some row groups of one file with all its columns
and, as float64, ``rule_reward``, ``reward_<term>``, ``weight_<name>`` and ``confidence_<head>``. A
part appears whole or not at all; parts that are there already are not made again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sfol import arrays
from sfol.errors import FileError, Place, SfolError, UsageError, expect, missing_extra
from sfol.locking import locked_folder
from sfol.outcome import log_items
from sfol.reading import first_reason, opened, text_of
from sfol.reward import RewardFunction
from sfol.tools.ray_cluster import on_ray
from sfol.writing import replacing

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

PART_ROWS = 250_000
BATCH_ROWS = 16_384  # of what is in memory at a time; more are not faster
ABOUT = "label.json"
_BUFFER = 1 << 20  # bytes of a column that are read at once, however large a row group is
_FORMAT = 1
_FOOTER_END = 8  # bytes: the length of the footer, and PAR1; source: the Parquet format
_NEXT = "next."


@dataclass(frozen=True)
class Part:
    """Some row groups of a file, and where their labels go.

    Attributes:
        source: the file.
        groups: which row groups.
        first: the number of their first row in the file.
        rows: how many they have.
        path: of the part.
    """

    source: Path
    groups: tuple[int, ...]
    first: int
    rows: int
    path: Path


@dataclass(frozen=True)
class Labelled:
    """What a labelling came to.

    Attributes:
        rows: how many there are.
        parts: the files, in the order of the rows.
        new_rows: how many of the rows were labelled now.
    """

    rows: int
    parts: tuple[Path, ...]
    new_rows: int


def label(  # noqa: PLR0913 (options)
    data: str | Path,
    folder: str | Path,
    reward: RewardFunction,
    *,
    part_rows: int = PART_ROWS,
    ray: str | None = None,
    on_rows: Callable[[int, int], None] = lambda done, rows: None,
) -> Labelled:
    """Label recorded steps, or go on with it.

    Args:
        data: a Parquet file, or a folder of such, in the order of their names.
        folder: where the parts go, which is made.
        reward: the reward function.
        part_rows: row groups are put together until a part has so many rows.
        ray: address of a Ray cluster, whose processes label parts side by side; they must see both
            folders. None: this process does.
        on_rows: is told after each batch, or each part of a cluster's, how many rows are labelled,
            of how many.

    Raises:
        MissingExtraError: pyarrow is not installed, or Ray, where it is asked for.
        FileError: a file can't be read.
        UsageError: an argument is of another type, there is no data, the folder has labels of
            other data or rules, a column has the name of a label, or the folder can't be written
            to.
        SfolError: rows have no reward; the error says which, and why.
    """
    for path in (data, folder):
        expect(path, (str, Path), "a path", "give a text or a pathlib.Path")
    expect(reward, RewardFunction, "the reward", "give a sfol.RewardFunction")
    files, folder = _files(Path(data)), Path(folder)
    parts = list(_parts(files, folder, part_rows))
    rows = sum(part.rows for part in parts)
    with locked_folder(folder):
        _check_same(folder, _about(files, reward, part_rows))
        for left in folder.glob("part-*.parquet.*.part"):  # by a process that was killed
            left.unlink()
        missing = [part for part in parts if not part.path.exists()]
        done = rows - sum(part.rows for part in missing)
        on_rows(done, rows)
        for count in _written(missing, reward, ray):
            done += count
            on_rows(done, rows)
    new = sum(part.rows for part in missing)
    return Labelled(rows, tuple(part.path for part in parts), new)


# -- what there is to do ------------------------------------------------------------------------


def _files(data: Path) -> list[Path]:
    if not data.is_dir():
        return [data]
    found = sorted(data.glob("*.parquet"))
    if not found:
        raise UsageError(f"no Parquet file in '{data}'", name=str(data))
    return found


def _parts(files: Sequence[Path], folder: Path, part_rows: int) -> Iterator[Part]:
    number = 0
    for source in files:
        first = 0
        for groups, rows in _group(source, part_rows):
            yield Part(source, groups, first, rows, folder / f"part-{number:05}.parquet")
            first += rows
            number += 1


def _group(source: Path, part_rows: int) -> Iterator[tuple[tuple[int, ...], int]]:
    """Yield row groups of a file that make a part together, and how many rows they have."""
    with opened(source, "data") as file:
        metadata = _parquet(file, source).metadata
    sizes = [metadata.row_group(i).num_rows for i in range(metadata.num_row_groups)]
    groups: list[int] = []
    for group in range(len(sizes)):
        groups.append(group)
        rows = sum(sizes[i] for i in groups)
        if rows >= part_rows or group == len(sizes) - 1:
            yield tuple(groups), rows
            groups = []


def _about(files: Sequence[Path], reward: RewardFunction, part_rows: int) -> dict[str, Any]:
    """Return what decides the content of parts."""
    return {
        "format": _FORMAT,
        "sfol": version("sfol"),
        "knowledge_base": reward.kb.name,
        "hash": reward.hash,
        "part_rows": part_rows,
        "data": [{"file": file.name, "footer": _footer_digest(file)} for file in files],
    }


def _footer_digest(path: Path) -> str:
    """Return a digest of a file's footer, which says where everything is and how large."""
    with opened(path, "data") as file:
        end = file.seek(0, 2)
        file.seek(max(end - _FOOTER_END, 0))
        length = int.from_bytes(file.read(4), "little")
        file.seek(max(end - _FOOTER_END - length, 0))
        return hashlib.sha256(end.to_bytes(8, "little") + file.read()).hexdigest()


def _check_same(folder: Path, about: Mapping[str, Any]) -> None:
    """Make sure that the parts in a folder are those that would be written."""
    path = folder / ABOUT
    if path.exists():
        found = text_of(path, "description of the labels")
        if found != _text(about):
            raise UsageError(
                f"'{folder}' has labels of other data or of other rules",
                name=str(folder),
                suggestion="write to another folder, or remove this one",
            )
        return
    if any(folder.glob("part-*.parquet")):
        raise UsageError(
            f"'{folder}' has parts and no {ABOUT}, which says what they are of",
            name=str(folder),
            suggestion="write to another folder, or remove this one",
        )
    with replacing(path) as part:
        part.write_text(_text(about), encoding="utf-8")


def _text(about: Mapping[str, Any]) -> str:
    return json.dumps(about, indent=1) + "\n"


# -- parts --------------------------------------------------------------------------------------


def _written(parts: Sequence[Part], reward: RewardFunction, ray: str | None) -> Iterator[int]:
    """Write parts, and yield now and then how many rows were labelled since."""
    if ray is None:
        for part in parts:
            yield from _write(part, reward)
        return
    there = [replace(p, source=p.source.resolve(), path=p.path.resolve()) for p in parts]
    yield from on_ray(partial(_write_whole, reward), there, ray)


def _write_whole(reward: RewardFunction, part: Part) -> int:
    return sum(_write(part, reward))


def _write(part: Part, reward: RewardFunction) -> Iterator[int]:
    """Write a part, and yield after each batch how many rows it had."""
    import pyarrow as pa  # noqa: PLC0415  (an extra, and slow to import)
    import pyarrow.parquet as pq  # noqa: PLC0415

    row = part.first
    with opened(part.source, "data") as file, replacing(part.path) as path:
        source = _parquet(file, part.source)
        schema = _labelled_schema(source.schema_arrow, reward, part.source)
        with pq.ParquetWriter(path, schema, compression="zstd") as writer:
            for batch in _batches(source, part):
                labels = _labels(batch, reward, part.source, row)
                new = [pa.array(labels[name]) for name in schema.names[batch.num_columns :]]
                writer.write_batch(pa.record_batch([*batch.columns, *new], schema=schema))
                row += batch.num_rows
                yield batch.num_rows


def _batches(source: pq.ParquetFile, part: Part) -> Iterator[pa.RecordBatch]:
    import pyarrow as pa  # noqa: PLC0415

    batches = source.iter_batches(BATCH_ROWS, row_groups=list(part.groups))
    while True:
        try:
            batch = next(batches, None)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise _unreadable(part.source, error) from None
        if batch is None:
            return
        yield batch


def _labelled_schema(schema: pa.Schema, reward: RewardFunction, path: Path) -> pa.Schema:
    import pyarrow as pa  # noqa: PLC0415

    kb, heads = reward.kb, reward.engine.program.subject_heads
    names = ["rule_reward", *(f"reward_{name}" for name in kb.terms)]
    names += [*(f"weight_{name}" for name in kb.weights), *(f"confidence_{h}" for h in heads)]
    taken = [name for name in names if name in schema.names]
    if taken:
        raise UsageError(
            f"'{path}' has a column '{taken[0]}' already",
            name=taken[0],
            suggestion="it would be that of a label: rename it",
        )
    for name in names:
        schema = schema.append(pa.field(name, pa.float64()))
    return schema


def _labels(
    batch: pa.RecordBatch, reward: RewardFunction, path: Path, row: int
) -> dict[str, npt.NDArray[np.float64]]:
    """Return the labels of a batch by name."""
    columns = _Columns(dict(zip(batch.schema.names, batch.columns, strict=True)))
    given = {name: columns[name] for name in reward.kb.signals if name in columns and
             name not in reward.kb.observed_signals}  # fmt: skip
    try:
        outcome = reward.transitions(
            columns.get("observation", columns),
            columns.get("action"),
            columns.get("next_observation", columns.after() or None),
            columns.get("reward"),
            columns.get("terminated"),
            columns.get("truncated"),
            **given,
        )
    except SfolError as error:
        last = row + batch.num_rows - 1
        raise SfolError(
            f"rows {row} to {last} of '{path}': {error.message}",
            name=error.name,
            suggestion=error.suggestion,
        ) from None
    labels = {"rule_reward": outcome.reward, **log_items(outcome)}
    return {name: arrays.plain(values).astype(np.float64) for name, values in labels.items()}


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
    try:
        import pyarrow as pa  # noqa: PLC0415
        import pyarrow.parquet as pq  # noqa: PLC0415
    except ImportError:
        raise missing_extra("pyarrow", "data in Parquet files needs it", extra="parquet") from None
    try:
        return pq.ParquetFile(file, buffer_size=_BUFFER)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise _unreadable(path, error) from None


def _unreadable(path: Path, error: Exception) -> FileError:
    return FileError(
        f"the data can't be read: {first_reason(error)}", name=path.name, place=Place(str(path))
    )
