"""What is asked of arrays that callers hand over, and the error that says it."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from sfol.errors import UsageError

Array = TypeVar("Array", bound=NDArray[Any])


def checked_array(
    array: Array, kind: type[np.generic], shape: tuple[int | str, ...], name: str
) -> Array:
    """Return an array that is what it should be.

    Args:
        array: of any kind.
        kind: of its numbers, such as ``np.uint8`` or ``np.floating``.
        shape: its sides, at least 1 where a letter stands.
        name: what it is called.

    Raises:
        UsageError: it is no array of numpy, or of another type or shape.
    """
    if isinstance(array, np.ndarray) and issubclass(array.dtype.type, kind):
        if array.shape == shape:  # which is all there is to ask of most, and faster
            return array
        sides = zip(array.shape, shape, strict=False)
        alike = (side > 0 if isinstance(wanted, str) else side == wanted for side, wanted in sides)
        if array.ndim == len(shape) and all(alike):
            return array
    found = (
        f"is {array.dtype} of shape {array.shape}"
        if isinstance(array, np.ndarray)
        else f"is a {type(array).__name__}"
    )
    wanted = ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "")
    raise UsageError(
        f"{name} {found}", name=name, suggestion=f"an array, {kind.__name__} of shape ({wanted})"
    )
