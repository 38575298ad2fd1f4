"""Recorded steps in data sets of Minari.

A row is a step of an episode: what was observed before and after it, the action, the environment's
own reward and how it ended. A piece is some episodes. Beside the labels stand ``episode`` and
``step``, which count from 0 as Minari does.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property, partial
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sfol.errors import UsageError, missing_extra
from sfol.tools.label_sources import BATCH_ROWS, Batch, Piece, together, unreadable

if TYPE_CHECKING:
    import pyarrow as pa

PREFIX = "minari:"
_METADATA = "metadata.json"
# What an episode has, and how much more of it than steps.
_COUNTS = {"observations": 1, "actions": 0, "rewards": 0, "terminations": 0, "truncations": 0}
# What Minari, h5py and pyarrow raise where something is wrong with a file.
_WRONG = (OSError, ValueError, LookupError, TypeError, AttributeError, AssertionError, RuntimeError)


def folder_of(data: str | Path) -> Path | None:
    """Return the folder of a data set of Minari; None if the data are none.

    Args:
        data: ``minari:NAME`` for one that Minari has on this machine, or a path.

    Raises:
        MissingExtraError: Minari is not installed, which knows where it keeps data.
        UsageError: it has none of that name.
    """
    if not str(data).startswith(PREFIX):
        return Path(data) if (Path(data) / "data" / _METADATA).is_file() else None
    name = str(data).removeprefix(PREFIX)
    with _reading(Path(name)):
        from minari.storage.datasets_root_dir import get_dataset_path  # noqa: PLC0415 (an extra)

        folder = Path(get_dataset_path(name))
    if not (folder / "data" / _METADATA).is_file():
        raise UsageError(
            f"Minari has no data set '{name}' at '{folder}'",
            name=name,
            suggestion=f"minari download {name}, or give the path of a data set",
        )
    return folder


class MinariEpisodes:
    """The steps in a data set of Minari; one episode at a time is read.

    Args:
        folder: of the data set.

    Raises:
        MissingExtraError: Minari is not installed, or what it reads the data with.
        FileError: it can't be read.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        with _reading(folder):
            from minari.dataset.minari_storage import MinariStorage  # noqa: PLC0415 (an extra)

            metadata = MinariStorage.read_raw_metadata(folder / "data")
            # Without its spaces Minari would make the environment: data would say what is run.
            for space in ("observation_space", "action_space"):
                if space not in metadata:
                    raise LookupError(f"its metadata has no {space}")
            self._storage = MinariStorage.read(folder / "data")

    def about(self) -> list[dict[str, Any]]:
        """Return the data set's name and a digest of its files' names, sizes and times."""
        digest = hashlib.sha256()
        for path in sorted((self._folder / "data").rglob("*")):
            if path.is_file():
                stat = path.stat()
                name = path.relative_to(self._folder).as_posix()
                digest.update(f"{name} {stat.st_size} {stat.st_mtime_ns}\n".encode())
        return [{"minari": self._folder.name, "files": digest.hexdigest()}]

    def pieces(self, part_rows: int) -> Iterator[Piece]:
        """Yield episodes that make a part together."""
        first = 0
        for episodes in together(self._sizes, part_rows):
            rows = sum(self._sizes[i] for i in episodes)
            yield Piece(self._folder, episodes, first, rows)
            first += rows

    def schema(self, piece: Piece) -> pa.Schema:
        """Return that of ``episode`` and ``step``."""
        import pyarrow as pa  # noqa: PLC0415  (an extra, and slow to import)

        return pa.schema([("episode", pa.int64()), ("step", pa.int64())])

    def batches(self, piece: Piece) -> Iterator[Batch]:
        """Yield a piece."""
        import pyarrow as pa  # noqa: PLC0415

        for run in together([self._sizes[i] for i in piece.members], BATCH_ROWS):
            whole = _merged(np.concatenate, [self._episode(piece.members[i]) for i in run])
            for start in range(0, len(whole[0]), BATCH_ROWS):
                rows = slice(start, start + BATCH_ROWS)
                episodes, steps, *step = _each(itemgetter(rows), whole)
                columns = pa.record_batch([episodes, steps], schema=self.schema(piece))
                yield Batch(columns, partial(tuple, step))

    @cached_property
    def _sizes(self) -> list[int]:
        with _reading(self._folder):
            episodes = range(int(self._storage.total_episodes))
            return [int(one["total_steps"]) for one in self._storage.get_episode_metadata(episodes)]

    def _episode(self, number: int) -> tuple[Any, ...]:
        """Return an episode's number and its steps', and what `Batch.step` has of them."""
        with _reading(self._folder):
            (episode,) = self._storage.get_episodes([number])
            size, found = self._sizes[number], {}
            for name, count in _COUNTS.items():
                found[name] = _each(np.asarray, episode[name])
                _each(partial(_check_length, size + count, name), found[name])
        observed, *others = found.values()
        before, after = (_each(itemgetter(rows), observed) for rows in (slice(-1), slice(1, None)))
        return np.full(size, number), np.arange(size), before, others[0], after, *others[1:]


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Make errors of ours of what Minari raises."""
    try:
        yield
    except ImportError as error:
        lacks = error.name or "minari[hdf5]"  # Minari says so without a name
        raise missing_extra(lacks, "data sets of Minari need it", extra="minari") from None
    except _WRONG as error:
        raise unreadable(path, error) from None


def _check_length(size: int, what: str, part: npt.NDArray[Any]) -> None:
    if len(part) != size:
        raise ValueError(f"an episode has {len(part)} {what}, and not {size}")


def _each(function: Callable[[Any], Any], nested: Any) -> Any:
    """Return dictionaries and tuples with what a function makes of what is in them."""
    return _merged(lambda parts: function(parts[0]), [nested])


def _merged(function: Callable[[list[Any]], Any], nested: Sequence[Any]) -> Any:
    """Return one of some dictionaries and tuples of the same form, its parts made of theirs."""
    first = nested[0]
    if isinstance(first, Mapping):
        return {name: _merged(function, [one[name] for one in nested]) for name in first}
    if isinstance(first, tuple):
        return tuple(_merged(function, parts) for parts in zip(*nested, strict=True))
    return function([*nested])
