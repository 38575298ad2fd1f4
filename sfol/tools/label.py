"""Recorded steps, labelled with what a knowledge base makes of each.

Steps stand in Parquet files (`sfol.tools.label_parquet`) or in a data set of Minari
(`sfol.tools.label_minari`). The labels are written to a folder in parts: Parquet files with what
tells whose row it is and, as float64, ``rule_reward``, ``reward_<term>``, ``weight_<name>`` and
``confidence_<head>``. A part appears whole or not at all; parts that are there already are not made
again.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sfol import arrays
from sfol.errors import SfolError, UsageError, expect, missing_extra
from sfol.locking import locked_folder
from sfol.outcome import log_items
from sfol.reading import text_of
from sfol.reward import RewardFunction
from sfol.tools.label_minari import MinariEpisodes, folder_of
from sfol.tools.label_parquet import ParquetFiles
from sfol.tools.label_sources import Batch, Piece, StepSource
from sfol.tools.ray_cluster import on_ray
from sfol.writing import replacing

if TYPE_CHECKING:
    import pyarrow as pa

PART_ROWS = 250_000
ABOUT = "label.json"
_FORMAT = 1


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
        data: a Parquet file, or a folder of such, in the order of their names; or ``minari:NAME``,
            or the folder of a data set of Minari.
        folder: where the parts go, which is made.
        reward: the reward function.
        part_rows: row groups, or episodes, are put together until a part has so many rows.
        ray: address of a Ray cluster, whose processes label parts side by side; they must see both
            folders. None: this process does.
        on_rows: is told after each batch, or each part of a cluster's, how many rows are labelled,
            of how many.

    Raises:
        MissingExtraError: pyarrow is not installed, or Minari for its data, or Ray, where it is
            asked for.
        FileError: a file can't be read.
        UsageError: an argument is of another type, there is no data, the folder has labels of
            other data or rules, the rules speak of steps that have passed, a column has the name of
            a label, or the folder can't be written to.
        SfolError: rows have no reward; the error says which, and why.
    """
    for path in (data, folder):
        expect(path, (str, Path), "a path", "give a text or a pathlib.Path")
    expect(reward, RewardFunction, "the reward", "give a sfol.RewardFunction")
    if reward.kb.has_memory:
        raise UsageError(
            f"'{reward.kb.name}' has rules over time, and rows are labelled each for itself",
            name=reward.kb.name,
            suggestion="take the steps of each episode in order: reward.episode()",
        )
    _check_pyarrow()
    source, folder = _source(data), Path(folder)
    parts = {folder / f"part-{i:05}.parquet": p for i, p in enumerate(source.pieces(part_rows))}
    rows = sum(piece.rows for piece in parts.values())
    with locked_folder(folder):
        _check_same(folder, _about(source, reward, part_rows))
        for left in folder.glob("part-*.parquet.*.part"):  # by a process that was killed
            left.unlink()
        missing = {path: piece for path, piece in parts.items() if not path.exists()}
        new = sum(piece.rows for piece in missing.values())
        done = rows - new
        on_rows(done, rows)
        for count in _written(missing, source, reward, ray):
            done += count
            on_rows(done, rows)
    return Labelled(rows, tuple(parts), new)


def _check_pyarrow() -> None:
    if find_spec("pyarrow") is None:
        raise missing_extra("pyarrow", "data in Parquet files needs it", extra="parquet")


def _source(data: str | Path) -> StepSource:
    found = folder_of(data)
    return ParquetFiles(Path(data)) if found is None else MinariEpisodes(found.resolve())


def _about(source: StepSource, reward: RewardFunction, part_rows: int) -> dict[str, Any]:
    """Return what decides the content of parts."""
    return {
        "format": _FORMAT,
        "sfol": version("sfol"),
        "knowledge_base": reward.kb.name,
        "hash": reward.hash,
        "part_rows": part_rows,
        "data": source.about(),
    }


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


def _written(
    parts: Mapping[Path, Piece], source: StepSource, reward: RewardFunction, ray: str | None
) -> Iterator[int]:
    """Write parts, and yield now and then how many rows were labelled since."""
    if ray is None:
        for path, piece in parts.items():
            yield from _write(path, piece, source, reward)
        return
    there = [
        (path.resolve(), replace(piece, source=piece.source.resolve()))
        for path, piece in parts.items()
    ]
    yield from on_ray(partial(_write_whole, source, reward), there, ray)


def _write_whole(source: StepSource, reward: RewardFunction, part: tuple[Path, Piece]) -> int:
    return sum(_write(*part, source, reward))


def _write(path: Path, piece: Piece, source: StepSource, reward: RewardFunction) -> Iterator[int]:
    """Write a part, and yield after each batch how many rows it had."""
    import pyarrow as pa  # noqa: PLC0415  (an extra, and slow to import)
    import pyarrow.parquet as pq  # noqa: PLC0415

    row = piece.first
    schema = _labelled_schema(source.schema(piece), reward, piece.source)
    with replacing(path) as part, pq.ParquetWriter(part, schema, compression="zstd") as writer:
        for batch in source.batches(piece):
            columns = batch.columns
            labels = _labels(batch, reward, piece.source, row)
            new = [pa.array(labels[name]) for name in schema.names[columns.num_columns :]]
            writer.write_batch(pa.record_batch([*columns.columns, *new], schema=schema))
            row += columns.num_rows
            yield columns.num_rows


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
    batch: Batch, reward: RewardFunction, path: Path, row: int
) -> dict[str, npt.NDArray[np.float64]]:
    """Return the labels of a batch by name."""
    kb = reward.kb
    try:
        given = {
            name: batch.signals[name]
            for name in kb.signals
            if name in batch.signals and name not in kb.observed_signals
        }
        outcome = reward.transitions(*batch.step(), **given)
    except SfolError as error:
        last = row + batch.columns.num_rows - 1
        raise SfolError(
            f"rows {row} to {last} of '{path}': {error.message}",
            name=error.name,
            suggestion=error.suggestion,
        ) from None
    values = {"rule_reward": outcome.reward, **log_items(outcome)}
    return {name: arrays.plain(array).astype(np.float64) for name, array in values.items()}
