"""Logs: recorded facts and signals of every step, as Parquet files of a versioned format.

A row is a step. Its columns are ``episode`` and ``step`` (numbers from 0), ``time`` in s, ``facts``
(a list of atom, lower and upper bound, so that every bound comes back exactly), ``signals`` (name →
number) and ``ending``, how the episode ended, the same in all its rows. Where the knowledge base
has attributes there is a column ``values``, a list of atom and value, and the format has version 2;
otherwise it has version 1, which older versions of sfol read. The file's metadata hold the version
of the format, that of sfol, the name and hash of the knowledge base, and a digest of all bytes of
the file but its own. A log has what a reward needs, so that any other knowledge base can be put to
the same episodes.

What is read is what was written: the digest is checked first, and then every value of every row.
Other programs write logs without a digest, which are read only if one asks for that.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from sfol.errors import FileError, Place, SfolError, SignalError, UsageError, missing_extra
from sfol.facts import Facts
from sfol.knowledge_base import KnowledgeBase
from sfol.locking import locked
from sfol.reading import opened
from sfol.syntax import Atom, parse_ground_atom
from sfol.writing import replacing

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

LOG_VERSION = 2  # of a log with values; one without has the first
MAXIMUM_ROWS = 500_000
_KEY, _DIGEST_KEY, _DIGITS = b"sfol", b"sfol_digest", 64
# A key of the metadata, and of its value that it is a text and how long; source: Thrift's compact
# protocol, in which Parquet has its metadata.
_PARQUET = b"PAR1"
_MARK = _DIGEST_KEY + bytes([0x18, _DIGITS])
_COLUMNS = ("episode", "step", "time", "facts", "signals", "ending")
_VALUES = "values"  # from version 2 on
# For each row that may be read, on average; with 500,000 rows some GB of memory.
_MOST_VALUES, _MOST_BYTES = 20, 2_000

_WRITER = "sfol.logs.LogWriter writes logs"
_DAMAGED = "take a copy that is whole, or record it again"

_Row = Mapping[str, Any]


class LogError(FileError):
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

    Until `close` it stands beside with the ending ``.part``, and is locked: a second writer of the
    same file is refused, in this process or another. As a context manager it closes itself, and
    leaves no file behind if an exception ends the block.

    Args:
        path: the file, which is replaced if it exists.
        kb: the knowledge base in use; the log carries its name and hash.

    Raises:
        MissingExtraError: pyarrow is not installed.
        UsageError: the file can't be written, or is being written already.

    Example:
        >>> import sfol
        >>> kb = sfol.KnowledgeBase.load("aeb")
        >>> with LogWriter("drive.parquet", kb) as log:
        ...     log.step(Facts.parse("Pedestrian(p1)."), 0.0, v=6.0, v_next=5.5, d=9.0)
        ...     log.end_episode("success")
        >>> read_log("drive.parquet").episodes[0].ending
        'success'
    """

    def __init__(self, path: str | Path, kb: KnowledgeBase) -> None:
        self._arrow = _pyarrow()
        self._schema = _schema(kb)
        self._kb = kb
        self._path = Path(path)
        self._rows: list[dict[str, Any]] = []
        self._episode = 0
        with ExitStack() as opening:
            opening.enter_context(locked(self._path, "log"))
            part = opening.enter_context(replacing(self._path))
            self._file = opening.enter_context(_writing(self._arrow, part, self._schema))
            self._open = opening.pop_all()

    def step(self, facts: Facts, time: float, /, **signals: float) -> None:
        """Record a step.

        Args:
            facts: what is known before the action; later changes do not matter.
            time: seconds since the episode began.
            signals: as given to `RewardFunction.evaluate`.

        Raises:
            SignalError: the time or a signal is not a number, or NaN.
            UsageError: the log is closed, or the facts have values and the knowledge base has no
                attributes.
        """
        self._check_open()
        self._check_values(facts)
        self._rows.append(
            {
                "episode": self._episode,
                "step": len(self._rows),
                "time": _number("time", time),
                "facts": [
                    {"atom": str(atom), "lower": bound.lower, "upper": bound.upper}
                    for atom, bound in facts.items()
                ],
                "signals": [(name, _number(name, value)) for name, value in signals.items()],
                _VALUES: [
                    {"atom": str(Atom(attribute, constants)), "value": value}
                    for attribute, known in facts.values().items()
                    for constants, value in known.items()
                ],
            }
        )

    def end_episode(self, ending: str | None) -> None:
        """Write the steps since the last ending as an episode.

        Args:
            ending: how it ended, in the recorder's own words; None if it was cut short.

        Raises:
            UsageError: there was no step, the ending is no text, the file can't be written, or the
                log is closed.
        """
        self._check_open()
        if not self._rows:
            raise UsageError("an episode without a step can't be logged")
        rows = [{**row, "ending": ending} for row in self._rows]
        try:
            self._file.write_table(self._arrow.Table.from_pylist(rows, schema=self._schema))
        except (self._arrow.ArrowException, OSError, ValueError) as error:
            raise UsageError(
                f"'{self._path}' can't be written: {error}", name=str(self._path)
            ) from None
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

    def _check_values(self, facts: Facts) -> None:
        if not self._kb.attributes and (attribute := next(iter(facts.values()), None)) is not None:
            raise UsageError(
                f"the facts have a value of '{attribute}', and '{self._kb.name}' has no attributes",
                name=attribute,
                suggestion="declare it under attributes, or leave the value out",
            )

    def _check_open(self) -> None:
        if not self._file.is_open:
            raise UsageError(f"the log '{self._path}' is closed", name=str(self._path))


def read_log(path: str | Path, *, maximum_rows: int = MAXIMUM_ROWS, foreign: bool = False) -> Log:
    """Read a log.

    Args:
        path: the file.
        maximum_rows: the most steps that are read, with 20 facts and signals each on average; the
            default takes some GB of memory.
        foreign: whether a log may be one that another program has written, without a digest. Only
            a file of your own should be: one that is damaged in certain ways ends the process,
            within pyarrow.

    Raises:
        LogError: it can't be read, is no log, is damaged or too long, or has a newer format.
        MissingExtraError: pyarrow is not installed.
    """
    arrow, place = _pyarrow(), Place(str(path))
    most_bytes = maximum_rows * _MOST_BYTES
    try:
        with opened(Path(path), "log") as file:
            content = file.read(most_bytes + 1)
        _check_size("bytes", len(content), most_bytes)
        _check_digest(content, foreign=foreign)
        return _log(_parquet_file(arrow, content), maximum_rows)
    except OSError as error:
        raise LogError(f"the log can't be read: {error.strerror}", place=place) from None
    except SfolError as error:
        raise LogError(error.message, suggestion=error.suggestion, place=place) from None


def _pyarrow() -> Any:
    try:
        import pyarrow  # noqa: PLC0415  (an extra, and slow to import)
        import pyarrow.parquet  # noqa: PLC0415
    except ImportError:
        raise missing_extra("pyarrow", "logs need it", extra="parquet") from None
    return pyarrow


def _schema(kb: KnowledgeBase) -> pa.Schema:
    import pyarrow as pa  # noqa: PLC0415

    number = LOG_VERSION if kb.attributes else 1
    about = {"version": number, "sfol": version("sfol"), "name": kb.name, "hash": kb.hash}
    return pa.schema(_kinds(number), metadata={_KEY: json.dumps(about)})


def _kinds(number: int) -> dict[str, pa.DataType]:
    """Return the columns of a version of the format."""
    import pyarrow as pa  # noqa: PLC0415

    text = pa.dictionary(pa.int32(), pa.string())
    fact = pa.struct([("atom", text), ("lower", pa.float64()), ("upper", pa.float64())])
    kinds = (
        pa.int32(),
        pa.int32(),
        pa.float64(),
        pa.list_(fact),
        pa.map_(pa.string(), pa.float64()),
        text,
    )
    columns = dict(zip(_COLUMNS, kinds, strict=True))
    value = pa.struct([("atom", text), ("value", pa.float64())])
    return columns if number == 1 else {**columns, _VALUES: pa.list_(value)}


@contextmanager
def _writing(arrow: Any, part: Path, schema: pa.Schema) -> Iterator[pq.ParquetWriter]:
    options = {"compression": "zstd", "write_page_checksum": True}
    with arrow.parquet.ParquetWriter(part, schema, **options) as file:
        yield file
        file.add_key_value_metadata({_DIGEST_KEY: bytes(_DIGITS)})
    content = part.read_bytes()
    with part.open("r+b") as written:
        written.seek(content.rindex(_MARK) + len(_MARK))
        written.write(_digest(content))


def _digest(content: bytes) -> bytes:
    """Return the digest of a file without the digits of its own digest, which follow the mark."""
    start = content.rindex(_MARK) + len(_MARK)
    digest = hashlib.sha256(content[:start])
    digest.update(content[start + _DIGITS :])
    return digest.hexdigest().encode()


def _number(name: str, value: object) -> float:
    """Return a number of any type, such as numpy's, as Python's own."""
    number = math.nan
    if not isinstance(value, str | bytes):
        with suppress(TypeError, ValueError, OverflowError):
            number = float(value)  # type: ignore[arg-type]
    if math.isnan(number):
        raise SignalError(f"'{name}' is {value!r:.80}, which is no number", name=name)
    return number


# -- reading ------------------------------------------------------------------------------------


class _About(BaseModel):
    """What the metadata say of a log; those of every version have these keys."""

    model_config = ConfigDict(strict=True)

    version: int
    sfol: str
    name: str
    hash: str


def _check_digest(content: bytes, *, foreign: bool) -> None:
    """Check the bytes before anything reads them: pyarrow may crash on damaged metadata."""
    if _MARK not in content:
        if foreign or not content.startswith(_PARQUET):
            return
        raise LogError(
            "this Parquet file has no digest: it is no log of sfol, it is damaged, or another "
            "program has written it again",
            suggestion="a log of your own is read by sfol.logs.read_log(path, foreign=True)",
        )
    start = content.rindex(_MARK) + len(_MARK)
    if content[start : start + _DIGITS] != _digest(content):
        raise LogError("the log is damaged: its digest is another one", suggestion=_DAMAGED)


def _parquet_file(arrow: Any, content: bytes) -> pq.ParquetFile:
    source = arrow.BufferReader(content)
    try:
        return arrow.parquet.ParquetFile(source, page_checksum_verification=True)
    except _unreadable(arrow):
        raise LogError(
            "this is no log, since it is no Parquet file, or a damaged one", suggestion=_WRITER
        ) from None


def _unreadable(arrow: Any) -> tuple[type[Exception], ...]:
    """Return what pyarrow raises of a file that is damaged."""
    return arrow.ArrowException, OSError, ValueError, MemoryError


def _log(file: pq.ParquetFile, maximum_rows: int) -> Log:
    about = _about(file.metadata.metadata or {})
    kinds = _kinds(about.version)
    _check_columns(file.schema_arrow, kinds)
    _check_sizes(file.metadata, maximum_rows)
    return Log(
        about.name, about.hash, about.sfol, tuple(_episodes(_checked(_rows(file, [*kinds]))))
    )


def _about(metadata: Mapping[bytes, bytes]) -> _About:
    if _KEY not in metadata:
        raise LogError("this Parquet file is no log of sfol", suggestion=_WRITER)
    try:
        about = _About.model_validate_json(metadata[_KEY])
    except ValidationError as invalid:
        keys = [str(error["loc"][0]) for error in invalid.errors() if error["loc"]]
        wrong = f"'{keys[0]}' is missing or wrong in them" if keys else "they are no JSON"
        raise LogError(f"the log's metadata are damaged: {wrong}", suggestion=_DAMAGED) from None
    if about.version > LOG_VERSION:
        raise LogError(
            f"the log has format {about.version}, written by sfol {about.sfol}; "
            f"this one reads up to {LOG_VERSION}",
            suggestion="update sfol",
        )
    return about


def _check_columns(schema: pa.Schema, kinds: Mapping[str, pa.DataType]) -> None:
    for name, kind in kinds.items():
        found = [schema.field(index).type for index in schema.get_all_field_indices(name)]
        if found != [kind]:
            wrong = (
                f"its column '{name}' has the type {found[0]}, not {kind}"
                if len(found) == 1
                else f"it has two columns '{name}'"
                if found
                else f"it has no column '{name}'"
            )
            raise LogError(f"the log is damaged: {wrong}", suggestion=_DAMAGED)


def _check_sizes(metadata: pq.FileMetaData, maximum_rows: int) -> None:
    """Check how much there is before any of it is read."""
    groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
    longest = [max(g.column(i).num_values for i in range(g.num_columns)) for g in groups]
    size = sum(group.total_byte_size for group in groups)
    _check_size("rows", sum(group.num_rows for group in groups), maximum_rows)
    _check_size("facts or signals", sum(longest), maximum_rows * _MOST_VALUES)
    _check_size("bytes", size, maximum_rows * _MOST_BYTES)


def _check_size(what: str, count: int, limit: int) -> None:
    if count > limit:
        raise LogError(
            f"the log has more than {limit} {what}",
            suggestion="record several logs, or read more with the maximum_rows of read_log",
        )


def _rows(file: pq.ParquetFile, columns: list[str]) -> Iterator[_Row]:
    """Yield the rows, of which those of one episode are in memory at a time."""
    arrow, done = _pyarrow(), 0
    for group in range(file.num_row_groups):
        try:
            table = file.read_row_group(group, columns=columns)
            table.validate(full=True)
            rows = table.to_pylist()
        except _unreadable(arrow):
            raise LogError(f"the log is damaged from row {done} on", suggestion=_DAMAGED) from None
        yield from rows
        done += len(rows)


def _checked(rows: Iterable[_Row]) -> Iterator[_Row]:
    before: _Row | None = None
    for number, row in enumerate(rows):
        if problem := _problem(row, before):
            raise _damaged(number, problem)
        yield row
        before = row


def _problem(row: _Row, before: _Row | None) -> str | None:
    """Return what is wrong with a row, its facts apart."""
    missing = [name for name, content in row.items() if content is None and name != "ending"]
    if missing:
        return f"it has no {missing[0]}"
    if math.isnan(row["time"]):
        return "its time is NaN"
    signals = dict(row["signals"])
    if len(signals) < len(row["signals"]):
        return "a signal stands twice"
    for name, value in signals.items():
        if value is None or math.isnan(value):
            return f"its signal '{name}' is {value}"
    for what, entries in (("atom or no bound", row["facts"]), ("value", row.get(_VALUES, ()))):
        if any(entry is None or None in entry.values() for entry in entries):
            return f"a fact has no {what}"
    return _disorder(row, before)


def _disorder(row: _Row, before: _Row | None) -> str | None:
    at = row["episode"], row["step"]
    last, step = (before["episode"], before["step"]) if before else (-1, 0)
    if at not in ((last, step + 1), (last + 1, 0)):
        return f"it is step {at[1]} of episode {at[0]}, which is out of order"
    if before and at[0] == last and row["ending"] != before["ending"]:
        return "its ending is not that of the row before it"
    return None


def _damaged(number: int, problem: str) -> LogError:
    return LogError(f"row {number} of the log is damaged: {problem}", suggestion=_DAMAGED)


def _episodes(rows: Iterable[_Row]) -> Iterator[LoggedEpisode]:
    for number, group in groupby(enumerate(rows), key=lambda row: row[1]["episode"]):
        found = list(group)
        steps = tuple(_step(*numbered) for numbered in found)
        yield LoggedEpisode(number, found[0][1]["ending"], steps)


def _step(number: int, row: _Row) -> LoggedStep:
    try:
        facts = _facts(row["facts"], row.get(_VALUES, ()))
    except SfolError as error:
        raise _damaged(number, error.message) from None
    return LoggedStep(row["time"], facts, dict(row["signals"]))


def _facts(entries: Iterable[_Row], values: Iterable[_Row]) -> Facts:
    facts = Facts()
    for entry in entries:
        atom = _atom(entry["atom"])
        facts.add(atom.predicate, *atom.arguments, bound=(entry["lower"], entry["upper"]))
    for entry in values:
        atom = _atom(entry["atom"])
        facts.add(atom.predicate, *atom.arguments, value=entry["value"])
    return facts


@lru_cache(maxsize=10_000)
def _atom(text: str) -> Atom:
    return parse_ground_atom(text)
