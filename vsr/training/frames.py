"""Sets of frames on disk: a folder of npz files, and a card that says where they come from."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from sfol.errors import FileError, UsageError
from sfol.reading import opened
from sfol.writing import replacing
from vsr.classes import CLASS_COUNT
from vsr.segmentation import Frame
from vsr.tensor_files import read_card

CARD = "frames.json"

_COLUMNS = {
    "gray": np.uint8,
    "classes": np.uint8,
    "instances": np.int16,
    "streets": np.int64,
    "steps": np.int64,
}
_PICTURES = ("gray", "classes", "instances")


class _FrameCard(BaseModel):
    """What is said about a set of frames; whoever needs more than this asks for it."""

    model_config = ConfigDict(extra="allow", defer_build=True)

    renderer: str


@dataclass(frozen=True, eq=False)
class FrameSet:
    """N frames and where they come from.

    Attributes:
        gray: uint8 (N, H, W), grey values.
        classes: uint8 (N, H, W), the `SemanticClass` of each pixel.
        instances: int16 (N, H, W), the body that each pixel belongs to, -1 where there is none.
        streets: int64 (N,), the seed of the street that a frame shows.
        steps: int64 (N,), control steps since that street's start; two frames of one street that
            are one step apart show the same people a moment later.
        card: what is said about all of them: renderer, camera, seeds.
    """

    gray: NDArray[np.uint8]
    classes: NDArray[np.uint8]
    instances: NDArray[np.int16]
    streets: NDArray[np.int64]
    steps: NDArray[np.int64]
    card: Mapping[str, Any]

    def __len__(self) -> int:
        return len(self.gray)

    def frame(self, index: int) -> Frame:
        """Return one frame."""
        instances = self.instances[index].astype(np.int32)
        return Frame(self.gray[index], self.classes[index], instances)

    def without_successors(self) -> list[Frame]:
        """Return the frames but for those that follow on another one step later."""
        later = set(self.pairs()[:, 1].tolist())
        return [self.frame(i) for i in range(len(self)) if i not in later]

    def pairs(self) -> NDArray[np.int64]:
        """Return the indices of frames and of those one control step later, int64 (M, 2)."""
        same = (np.diff(self.streets) == 0) & (np.diff(self.steps) == 1)
        first = np.flatnonzero(same)
        return np.column_stack([first, first + 1])


def load_frames(folder: Path) -> FrameSet:
    """Read all frames of a folder.

    Args:
        folder: what `aeb frames` wrote, or npz files with the columns of
            `FrameSet` and a `frames.json` that says at least which ``renderer`` made them.

    Raises:
        UsageError: there are none, or a file is damaged or does not go with the others.
    """
    shards = sorted(folder.glob("*.npz"))
    if not shards or not (folder / CARD).is_file():
        raise UsageError(
            f"{folder} holds no frames",
            name=str(folder),
            suggestion="aeb frames renders those of the bundled street",
        )
    card = read_card(folder / CARD, _FrameCard, "card of frames").model_dump()
    parts = [read_shard(shard) for shard in shards]
    for shard, part in zip(shards, parts, strict=True):
        if part["gray"].shape[1:] != parts[0]["gray"].shape[1:]:
            raise FileError(f"{shard} has frames of another size than {shards[0]}", name=str(shard))
    columns = {name: np.concatenate([part[name] for part in parts]) for name in _COLUMNS}
    return FrameSet(**columns, card=card)


def read_shard(file: Path) -> dict[str, NDArray[Any]]:
    """Return the columns of one file.

    Raises:
        FileError: the file is damaged, or a column is missing or of another shape or type.
    """
    try:
        with opened(file) as content, np.load(content) as shard:
            columns = {name: shard[name] for name in _COLUMNS}
    except (OSError, KeyError, ValueError, EOFError, zlib.error, zipfile.BadZipFile) as error:
        raise _no_frames(file, str(error)) from error
    shape = columns["gray"].shape
    for name, kind in _COLUMNS.items():
        column = columns[name]
        expected = shape if name in _PICTURES else shape[:1]
        if len(shape) != 3 or column.shape != expected or column.dtype != kind:
            raise _no_frames(file, f"{name} is {column.dtype} of shape {column.shape}")
    if columns["classes"].max(initial=0) >= CLASS_COUNT:
        raise _no_frames(file, f"a class has a number beyond {CLASS_COUNT - 1}")
    return columns


def _no_frames(file: Path, reason: str) -> FileError:
    return FileError(
        f"{file} is no file of frames: {reason}",
        name=str(file),
        suggestion="delete it; aeb frames renders what is missing",
    )


def write_shard(file: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write the columns of one file, whole or not at all."""
    typed = {name: columns[name].astype(kind, copy=False) for name, kind in _COLUMNS.items()}
    with replacing(file) as part, part.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **typed)
