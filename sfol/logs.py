"""Logs: recorded facts and signals of every step, as Parquet files of a versioned format.

A row is a step. Its columns are ``episode`` and ``step`` (numbers from 0), ``time`` in s,
``facts`` (a list of atom, lower and upper bound, so that every bound comes back exactly),
``signals`` (name → number) and ``ending``, how the episode ended, the same in all its rows. The
file's metadata hold the version of the format, that of sfol, and the name and hash of the
knowledge base. A log has what a reward needs, so that any other knowledge base can be put to the
same episodes.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO, Self

from sfol.errors import Place, SfolError, UsageError, missing_extra
from sfol.facts import Facts
from sfol.knowledge_base import KnowledgeBase
from sfol.syntax import Atom, parse_ground_atom
from sfol.writing import replacing

if TYPE_CHECKING:
    import pyarrow as pa

LOG_VERSION = 1
_KEY = b"sfol"
_COLUMNS = ("episode", "step", "time", "facts", "signals", "ending")


class LogError(SfolError):
    """A file is not a log that this version of sfol can read."""


@dataclass(frozen=True)
class LoggedStep:
    """What was recorded of a step.

    Attributes:
        time: seconds since the episode began.
        facts: what was known before the action.
        signals: name → number.
    """

    time: float
    facts: Facts
    signals: Mapping[str, float]


@dataclass(frozen=True)
class LoggedEpisode:
    """A recorded episode.

    Attributes:
        number: from 0, in the order of recording.
        ending: how it ended, such as ``collision``; None if it was cut short.
        steps: in order.
    """

    number: int
    ending: str | None
    steps: tuple[LoggedStep, ...]


@dataclass(frozen=True)
class Log:
    """A log that was read.

    Attributes:
        name: of the knowledge base that was in use.
        hash: of that knowledge base.
        sfol_version: of the sfol that wrote it.
        episodes: in the order of recording.
    """

    name: str
    hash: str
    sfol_version: str
    episodes: tuple[LoggedEpisode, ...]


class LogWriter:
    """Writes a log, step by step; the file appears when it is whole.

    Until `close` it stands beside with the ending ``.part``. As a context manager it closes
    itself, and leaves no file behind if an exception ends the block.

    Args:
        path: the file, which is replaced if it exists.
        kb: the knowledge base in use; the log carries its name and hash.

    Raises:
        MissingExtraError: pyarrow is not installed.
        UsageError: the file can't be written.

    Example:
        >>> import sfol
        >>> kb = sfol.KnowledgeBase.load("aeb")
        >>> with LogWriter("drive.parquet", kb) as log:
        ...     log.step(Facts.parse("Pedestrian(p1)."), time=0.0, v=6.0, v_next=5.5, d=9.0)
        ...     log.end_episode("success")
        >>> read_log("drive.parquet").episodes[0].ending
        'success'
    """

    def __init__(self, path: str | Path, kb: KnowledgeBase) -> None:
        self._arrow = _pyarrow()
        self._schema = _schema(kb)
        self._rows: list[dict[str, Any]] = []
        self._episode = 0
        with ExitStack() as opening:
            part = opening.enter_context(replacing(Path(path)))
            self._file = opening.enter_context(
                self._arrow.parquet.ParquetWriter(part, self._schema, compression="zstd")
            )
            self._open = opening.pop_all()

    def step(self, facts: Facts, *, time: float, **signals: float) -> None:
        """Record a step.

        Args:
            facts: what is known before the action; later changes do not matter.
            time: seconds since the episode began.
            signals: as given to `RewardFunction.evaluate`.
        """
        self._rows.append(
            {
                "episode": self._episode,
                "step": len(self._rows),
                "time": float(time),
                "facts": [
                    {"atom": str(atom), "lower": bound.lower, "upper": bound.upper}
                    for atom, bound in facts.items()
                ],
                "signals": [(name, float(value)) for name, value in signals.items()],
            }
        )

    def end_episode(self, ending: str | None) -> None:
        """Write the steps since the last ending as an episode.

        Args:
            ending: how it ended, in the recorder's own words; None if it was cut short.

        Raises:
            UsageError: there was no step.
        """
        if not self._rows:
            raise UsageError("an episode without a step can't be logged")
        rows = [{**row, "ending": ending} for row in self._rows]
        self._file.write_table(self._arrow.Table.from_pylist(rows, schema=self._schema))
        self._rows = []
        self._episode += 1

    def close(self) -> None:
        """Write what is left, as an episode that was cut short, and put the file in its place."""
        if self._rows:
            self.end_episode(None)
        self._open.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if error is None:
            self.close()
        else:
            self._open.__exit__(kind, error, traceback)


def read_log(path: str | Path) -> Log:
    """Read a log.

    Args:
        path: the file.

    Raises:
        LogError: it can't be read, is no log, or has a newer format.
        MissingExtraError: pyarrow is not installed.
    """
    arrow = _pyarrow()
    place = Place(str(path))
    try:
        with Path(path).open("rb") as file:
            table = _table(arrow, file, place)
    except OSError as error:
        raise LogError(f"the log can't be read: {error.strerror}", place=place) from None
    about = _about(table.schema, place)
    try:
        episodes = tuple(_episodes(table.to_pylist()))
    except SfolError as error:
        raise LogError(f"the log is damaged: {error.message}", place=place) from None
    return Log(about["name"], about["hash"], about["sfol"], episodes)


def _table(arrow: Any, file: BinaryIO, place: Place) -> pa.Table:
    try:
        return arrow.parquet.read_table(file)
    except (arrow.ArrowException, OSError, ValueError):
        raise LogError(
            "this is no log, since it is no Parquet file",
            suggestion="sfol.logs.LogWriter writes logs",
            place=place,
        ) from None


def _pyarrow() -> Any:
    try:
        import pyarrow  # noqa: PLC0415  (an extra, and slow to import)
        import pyarrow.parquet  # noqa: PLC0415
    except ImportError:
        raise missing_extra("pyarrow", "logs need it", extra="parquet") from None
    return pyarrow


def _schema(kb: KnowledgeBase) -> pa.Schema:
    import pyarrow as pa  # noqa: PLC0415

    text = pa.dictionary(pa.int32(), pa.string())
    fact = pa.struct([("atom", text), ("lower", pa.float64()), ("upper", pa.float64())])
    about = {"version": LOG_VERSION, "sfol": version("sfol"), "name": kb.name, "hash": kb.hash}
    kinds = (
        pa.int32(),
        pa.int32(),
        pa.float64(),
        pa.list_(fact),
        pa.map_(pa.string(), pa.float64()),
        text,
    )
    columns = list(zip(_COLUMNS, kinds, strict=True))
    return pa.schema(columns, metadata={_KEY: json.dumps(about)})


def _about(schema: pa.Schema, place: Place) -> dict[str, Any]:
    """Return what the metadata say, if they are those of a log that can be read."""
    text = (schema.metadata or {}).get(_KEY)
    if text is None:
        raise LogError(
            "this Parquet file is no log of sfol",
            suggestion="sfol.logs.LogWriter writes logs",
            place=place,
        )
    missing = sorted({*_COLUMNS} - {*schema.names})
    if missing:
        raise LogError(f"the log is damaged: it has no column '{missing[0]}'", place=place)
    about: dict[str, Any] = json.loads(text)
    if about["version"] > LOG_VERSION:
        raise LogError(
            f"the log has format {about['version']}, written by sfol {about['sfol']}; "
            f"this one reads up to {LOG_VERSION}",
            suggestion="update sfol",
            place=place,
        )
    return about


def _episodes(rows: Iterable[Mapping[str, Any]]) -> Iterator[LoggedEpisode]:
    for number, (_, group) in enumerate(groupby(rows, key=lambda row: row["episode"])):
        found = list(group)
        steps = tuple(
            LoggedStep(row["time"], _facts(row["facts"]), dict(row["signals"])) for row in found
        )
        yield LoggedEpisode(number, found[-1]["ending"], steps)


def _facts(entries: Iterable[Mapping[str, Any]]) -> Facts:
    facts = Facts()
    for entry in entries:
        atom = _atom(entry["atom"])
        facts.add(atom.predicate, *atom.arguments, bound=(entry["lower"], entry["upper"]))
    return facts


@lru_cache(maxsize=10_000)
def _atom(text: str) -> Atom:
    return parse_ground_atom(text)
