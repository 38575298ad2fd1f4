"""Observations and actions of many environments, nested in any way."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from sfol import arrays


def copied(batch: Any) -> Any:
    """Return B observations as they are now: environments may use one array for all of them."""
    if isinstance(batch, np.ndarray) and batch.dtype != np.object_:
        return batch.copy()  # several times as fast as what is below
    if type(batch) is dict:
        return {key: copied(part) for key, part in batch.items()}
    return copy.deepcopy(batch)


def row(batch: Any, index: int) -> Any:
    """Return one of B observations."""
    if isinstance(batch, Mapping):
        return {key: row(part, index) for key, part in batch.items()}
    if isinstance(batch, tuple):
        return tuple(row(part, index) for part in batch)
    return batch[index]


def rows(batch: Any, mask: npt.NDArray[np.bool_]) -> Any:
    """Return some of B observations."""
    if batch is None:
        return None
    if isinstance(batch, Mapping):
        return {key: rows(part, mask) for key, part in batch.items()}
    if isinstance(batch, tuple):
        return tuple(rows(part, mask) for part in batch)
    return batch[mask] if arrays.is_array(batch) else np.asarray(batch)[mask]


def replaced(batch: Any, new: Mapping[int, Any]) -> Any:
    """Return B observations with some of them replaced.

    Args:
        batch: the observations.
        new: index → an observation.
    """
    if isinstance(batch, Mapping):
        return {key: replaced(part, _under(new, key)) for key, part in batch.items()}
    if isinstance(batch, tuple):
        return tuple(replaced(part, _under(new, key)) for key, part in enumerate(batch))
    changed = copy.copy(batch)
    for index, observation in new.items():
        changed[index] = observation
    return changed


def _under(new: Mapping[int, Any], key: Any) -> dict[int, Any]:
    return {index: observation[key] for index, observation in new.items()}
