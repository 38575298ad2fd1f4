"""What differs between floats, numpy arrays and torch tensors, in one place.

Everything else in sfol is written with the operators that all three understand. torch is never
imported here: whoever passes a tensor has done so already.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Array = Any  # a float, a numpy array or a torch tensor
Indices = npt.NDArray[np.intp]


def is_tensor(value: object) -> bool:
    """Tell whether a value is a torch tensor."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, torch.Tensor)


def is_array(value: object) -> bool:
    """Tell whether a value is a numpy array or a torch tensor."""
    return isinstance(value, np.ndarray) or is_tensor(value)


def has_nan(value: Array) -> bool:
    """Tell whether any element is NaN."""
    if is_tensor(value):
        return bool(value.isnan().any())
    return bool(np.isnan(value).any()) if isinstance(value, np.ndarray) else math.isnan(value)


def elementwise(name: str, on_floats: Callable[..., float]) -> Callable[..., Array]:
    """Return a function for floats, arrays and tensors.

    Args:
        name: what numpy and torch both call it.
        on_floats: the same for floats, faster there.
    """

    def function(*values: Array) -> Array:
        if any(map(is_tensor, values)):
            torch = sys.modules["torch"]
            return getattr(torch, name)(*map(torch.as_tensor, values))
        if any(isinstance(value, np.ndarray) for value in values):
            return getattr(np, name)(*values)
        return on_floats(*values)

    return function


minimum = elementwise("minimum", min)
maximum = elementwise("maximum", max)
exp = elementwise("exp", math.exp)
log = elementwise("log", math.log)
sqrt = elementwise("sqrt", math.sqrt)


def where(condition: Array, then: Array, otherwise: Array) -> Array:
    """Return `then` where the condition is not zero, else `otherwise`."""
    if is_tensor(condition) or is_tensor(then) or is_tensor(otherwise):
        torch = sys.modules["torch"]
        chosen = torch.as_tensor(condition) != 0
        pair = (torch.as_tensor(value, device=chosen.device) for value in (then, otherwise))
        return torch.where(chosen, *pair)
    if any(isinstance(value, np.ndarray) for value in (condition, then, otherwise)):
        return np.where(np.asarray(condition) != 0, then, otherwise)
    return then if condition else otherwise


class NumpyBackend:
    """Operations on whole batches, for numpy."""

    def array(self, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return an array of this kind."""
        return values

    def take(self, values: npt.NDArray[Any], rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return the rows of the values."""
        return values.take(rows)

    def put(
        self, values: npt.NDArray[Any], rows: npt.NDArray[Any], new: npt.NDArray[Any]
    ) -> npt.NDArray[Any]:
        """Return a copy of the values with other ones in some rows."""
        changed = values.copy()
        changed[rows] = new
        return changed

    def any_of(self, chosen: npt.NDArray[Any], groups: npt.NDArray[Any], count: int) -> Array:
        """Tell for every group whether any of its members is chosen."""
        found = np.zeros(count, dtype=bool)
        found[groups[chosen]] = True
        return found

    def sum_of(self, values: npt.NDArray[Any], groups: npt.NDArray[Any], count: int) -> Array:
        """Return the sum of every group."""
        return np.bincount(groups, weights=values, minlength=count)

    def count_of(self, groups: npt.NDArray[Any], count: int) -> Array:
        """Return the number of members of every group, as a real number."""
        return np.bincount(groups, minlength=count).astype(np.float64)

    def largest_of(self, values: npt.NDArray[Any], groups: npt.NDArray[Any], count: int) -> Array:
        """Return the largest of every group, or minus infinity."""
        largest = np.full(count, -np.inf)
        np.maximum.at(largest, groups, values)
        return largest

    def full(self, count: int, value: float | bool) -> npt.NDArray[Any]:
        """Return an array that holds one value."""
        return np.full(count, value)


class TorchBackend:
    """Operations on whole batches, for torch; gradients go through values, not through choices.

    Args:
        device: where the tensors are.
        dtype: of real numbers.
    """

    def __init__(self, device: Any, dtype: Any) -> None:
        self._torch = sys.modules["torch"]
        self._device = device
        self._dtype = dtype

    def array(self, values: Array) -> Any:
        """Return a tensor of this kind."""
        tensor = self._torch.as_tensor(values, device=self._device)
        return tensor.to(self._dtype) if tensor.is_floating_point() else tensor

    def take(self, values: Any, rows: Any) -> Any:
        """Return the rows of the values."""
        return values[rows]

    def put(self, values: Any, rows: Any, new: Any) -> Any:
        """Return a copy of the values with other ones in some rows."""
        return values.index_put((rows,), new.to(values.dtype))

    def any_of(self, chosen: Any, groups: Any, count: int) -> Any:
        """Tell for every group whether any of its members is chosen."""
        found = self.full(count, value=False)
        found[groups[chosen]] = True
        return found

    def sum_of(self, values: Any, groups: Any, count: int) -> Any:
        """Return the sum of every group."""
        return self.full(count, 0.0).index_add(0, groups, values.to(self._dtype))

    def count_of(self, groups: Any, count: int) -> Any:
        """Return the number of members of every group, as a real number."""
        return self._torch.bincount(groups, minlength=count).to(self._dtype)

    def largest_of(self, values: Any, groups: Any, count: int) -> Any:
        """Return the largest of every group, or minus infinity."""
        return self.full(count, -math.inf).scatter_reduce(0, groups, values, "amax")

    def full(self, count: int, value: float | bool) -> Any:
        """Return a tensor that holds one value."""
        dtype = self._torch.bool if isinstance(value, bool) else self._dtype
        return self._torch.full((count,), value, device=self._device, dtype=dtype)


Backend = NumpyBackend | TorchBackend


def backend_of(values: Sequence[Array]) -> Backend:
    """Return the backend that a call needs: torch's as soon as one value is a tensor."""
    tensors = [value for value in values if is_tensor(value)]
    if not tensors:
        return NumpyBackend()
    torch = sys.modules["torch"]
    dtypes = [tensor.dtype for tensor in tensors if tensor.is_floating_point()]
    widest = torch.float64 if torch.float64 in dtypes or not dtypes else dtypes[0]
    return TorchBackend(max((t.device for t in tensors), key=str), widest)
