"""Results of evaluations as files: written whole or not at all, found again, and read back.

A drive makes ``<driver>/<traffic>-<occlusion>.json``, settings, command, versions and summary, and
beside it a ``.csv`` with a row per episode and, if asked for, a ``.parquet`` log. ``summary.csv``
has a row for every drive in the folder.
"""

from __future__ import annotations

import csv
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BeforeValidator, Field, PlainSerializer, TypeAdapter

from env.driving.names import checked_name
from env.driving.policies import file_hash
from env.evaluation.evaluate import (
    Drive,
    DrivenEpisode,
    EpisodeResult,
    Settings,
    Summary,
    summarize,
)
from env.evaluation.metrics import METRICS, Pooled
from env.evaluation.statistics import Mean, Share
from env.evaluation.sweep import ApproachResult
from sfol.knowledge_base import KnowledgeBase
from sfol.logs import LogWriter
from sfol.writing import check_writable, replacing
from vsr import json_files

Content = TypeVar("Content")

# 1: without a version. 2: the same, with it. 3: with the hashes of the files beside it.
SCHEMA_VERSION = 3
_BESIDE = (".csv", ".parquet")  # the files of a drive beside its result
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")
_MOST = 50_000_000  # bytes of a file
_PACKAGES = ("sfol", "numba", "numpy", "openvino", "pybullet", "stable-baselines3", "torch")


# In a file, metrics stand beside the summary's other parts.
_BESIDE_METRICS = {field.name for field in fields(Summary)} - {"measured"}


def _nested(summary: Any) -> Any:
    """Put the metrics of a file's summary together, those that are unknown here too."""
    if not isinstance(summary, dict):
        return summary
    measured = {name: part for name, part in summary.items() if name not in _BESIDE_METRICS}
    return {"measured": measured} | {n: summary[n] for n in _BESIDE_METRICS & summary.keys()}


def _flat(summary: Summary) -> dict[str, Any]:
    parts = {field.name: getattr(summary, field.name) for field in fields(summary)}
    return {"steps": parts.pop("steps"), **parts.pop("measured"), **parts}


@dataclass(frozen=True)
class DriveResult:
    """What a result file holds.

    Attributes:
        schema_version: of the file's form; files from before it was written down have 1.
        settings: what decides the result.
        command: makes it again.
        versions: of the software that made it.
        summary: what was measured.
        files: ending → hash of the file that was written with it, ``.csv`` and ``.parquet``.
    """

    settings: Settings
    command: str
    versions: Mapping[str, str]
    summary: Annotated[Summary, BeforeValidator(_nested), PlainSerializer(_flat)]
    schema_version: Annotated[int, Field(ge=1, le=SCHEMA_VERSION)] = 1
    files: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class SweepResult:
    """What the file of a sweep holds.

    Attributes:
        perception: where facts came from.
        seed: of the street's looks.
        knowledge_base: its name.
        knowledge_base_hash: of its content.
        versions: of the software that made it.
        approaches: what came of each.
    """

    perception: str
    seed: int
    knowledge_base: str
    knowledge_base_hash: str
    versions: Mapping[str, str]
    approaches: tuple[ApproachResult, ...]


class ResultFolder:
    """A folder of results.

    Args:
        path: of the folder; it is made when something is written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def file(self, drive: Drive, suffix: str = ".json") -> Path:
        """Return the path of a file of a drive.

        Raises:
            UsageError: the driver has no name that could be a folder's.
        """
        street = "-".join(drive.cell) + ("" if drive.hazard else "-no-hazard")
        return self._path / checked_name(drive.settings.driver) / f"{street}{suffix}"

    def find(self, drive: Drive, *, log: bool = False) -> DriveResult | None:
        """Return the result of a drive if it is there, made with the very same settings.

        It is not if a file beside it is missing, or is another drive's.

        Args:
            drive: a driver in a cell.
            log: whether its log has to be there as well.
        """
        if not self.file(drive).exists():
            return None
        result = read_json(self.file(drive), DriveResult)
        if result.settings != drive.settings or (log and ".parquet" not in result.files):
            return None
        return result if result.files.items() <= self._hashes(drive).items() else None

    def check(self, drives: Iterable[Drive]) -> None:
        """Make sure that results can be written here, before anybody drives.

        Raises:
            UsageError: a file can't be written, or one that is there can't be read.
        """
        files = [self.file(drive, suffix) for drive in drives for suffix in (".json", *_BESIDE)]
        check_writable(self._path / "summary.csv", *files)
        self.all()

    def write(
        self, drive: Drive, episodes: Iterable[DrivenEpisode], command: str, *, log: bool = False
    ) -> DriveResult:
        """Write the files of a drive as its episodes come, the result itself last.

        Args:
            drive: a driver in a cell.
            episodes: all of them.
            command: makes the same result again.
            log: whether the log is written.
        """
        results = (
            _logged(episodes, self.file(drive, ".parquet"), drive.rules)
            if log
            else [episode.result for episode in episodes]
        )
        if not log:  # one that is there is of another drive
            self.file(drive, ".parquet").unlink(missing_ok=True)
        write_csv(self.file(drive, ".csv"), [_episode_row(one) for one in results])
        result = DriveResult(
            settings=drive.settings,
            command=command,
            versions=versions(),
            summary=summarize(results),
            schema_version=SCHEMA_VERSION,
            files=self._hashes(drive),
        )
        write_json(self.file(drive), result)
        self._write_table()
        return result

    def all(self) -> list[DriveResult]:
        """Return all results, by driver and cell."""
        return [read_json(file, DriveResult) for file in sorted(self._path.glob("*/*.json"))]

    def _hashes(self, drive: Drive) -> dict[str, str]:
        """Return the hashes of the files that are there beside the result."""
        files = {suffix: self.file(drive, suffix) for suffix in _BESIDE}
        return {suffix: file_hash(file) for suffix, file in files.items() if file.exists()}

    def _write_table(self) -> None:
        write_csv(self._path / "summary.csv", [_summary_row(result) for result in self.all()])


def write_json(path: Path, content: Any) -> None:
    """Write a dataclass as JSON, whole or not at all; no number is null."""
    text = TypeAdapter(type(content)).dump_json(content, indent=1)
    with replacing(path) as part:
        part.write_bytes(text + b"\n")


def read_json(path: Path, kind: type[Content]) -> Content:
    """Read what `write_json` has written.

    Raises:
        FileError: the file holds something else.
    """
    suggestion = "remove it, or name another --output"
    return json_files.read_json(path, kind, "result", most=_MOST, suggestion=suggestion)


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as CSV, whole or not at all; None and what a row lacks are empty fields.

    A text that a spreadsheet would take for a formula has a ' before it.
    """
    with replacing(path) as part, part.open("w", newline="", encoding="utf-8") as file:
        names = list(dict.fromkeys(name for row in rows for name in row))
        writer = csv.writer(file)
        writer.writerow(map(_shown, names))
        writer.writerows([_shown(row.get(name)) for name in names] for row in rows)


def versions() -> dict[str, str]:
    """Return the versions of what results depend on."""
    return {"python": platform.python_version(), **{name: version(name) for name in _PACKAGES}}


def _logged(
    episodes: Iterable[DrivenEpisode], path: Path, kb: KnowledgeBase
) -> list[EpisodeResult]:
    results = []
    with LogWriter(path, kb) as log:
        for episode in episodes:
            for step in episode.log:
                log.step(step.facts, step.time, **step.signals)
            log.end_episode(episode.result.ending)
            results.append(episode.result)
    return results


def _episode_row(result: EpisodeResult) -> dict[str, Any]:
    row = {field.name: getattr(result, field.name) for field in fields(result)}
    fluctuation, measured = row.pop("fluctuation"), row.pop("measured")
    del row["heads"], row["rules"]
    return {
        **row,
        **{
            name: int(value) if isinstance(value, bool) else value
            for name, value in measured.items()
        },
        **{f"fluctuation_{weight}": value for weight, value in fluctuation.items()},
    }


def _summary_row(result: DriveResult) -> dict[str, Any]:
    row: dict[str, Any] = asdict(result.settings) | {"steps": result.summary.steps}
    for metric in METRICS:
        row |= _columns(metric.name, result.summary.measured.get(metric.name))
    # What is by weight, head, rule or ending stands in the result itself.
    return row


def _columns(name: str, pooled: Pooled | None) -> dict[str, Any]:
    if isinstance(pooled, Share):
        return {f"{name}{end}": x for end, x in _share_columns(pooled).items()}
    if isinstance(pooled, Mean):
        return {name: pooled.mean, f"{name}_episodes": pooled.episodes}
    return {name: pooled}


def _share_columns(share: Share) -> dict[str, float | None]:
    return {"": share.share, "_low": share.low, "_high": share.high}


def _shown(value: Any) -> Any:
    if isinstance(value, str) and value.startswith(_FORMULA):
        return f"'{value}"
    return f"{value:.6g}" if isinstance(value, float) else value
