"""Numbers, and the kinds of array that sfol computes with: a backend for each.

Everything else in sfol is written with the operators that numbers and all arrays understand, and
asks here for the rest. A further kind of array (JAX's, CuPy's) is one more class that does what
`Backend` says, and its place in `BACKENDS`.

torch is never imported here: whoever passes a tensor has done so already.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Protocol

import numpy as np
import numpy.typing as npt

Array = Any  # a number, or an array of any backend
Indices = npt.NDArray[np.intp]


class Backend(Protocol):
    """What one library of arrays does for sfol.

    The static methods work on whatever arrays come in; one argument at least is of this kind, and
    the others are so too, or numbers, or of a kind that stands later in `BACKENDS`. The other
    methods work on one-dimensional arrays that `array` or `full` made. Nothing is changed in place.

    Attributes:
        differentiable: whether gradients go through its arrays.
        tolerance: by which share of itself a threshold may be missed, in the precision of the
            computation; see `sfol.operators.least`.
    """

    differentiable: ClassVar[bool]
    tolerance: float

    @staticmethod
    def owns(value: object) -> bool:
        """Tell whether a value is an array of this kind."""
        ...

    @staticmethod
    def is_real(values: Array) -> bool:
        """Tell whether the elements are truth values, integers or real numbers."""
        ...

    @staticmethod
    def has_nan(values: Array) -> bool:
        """Tell whether any element is NaN."""
        ...

    @staticmethod
    def is_finite(values: Array) -> bool:
        """Tell whether every element is finite."""
        ...

    @staticmethod
    def plain(values: Array, /) -> npt.NDArray[Any]:
        """Return the elements as an array of numpy's, without gradients."""
        ...

    @staticmethod
    def minimum(left: Array, right: Array, /) -> Array:
        """Return the lesser of two, element by element."""
        ...

    @staticmethod
    def maximum(left: Array, right: Array, /) -> Array:
        """Return the greater of two, element by element."""
        ...

    @staticmethod
    def exp(values: Array, /) -> Array:
        """Return e to the power of every element."""
        ...

    @staticmethod
    def log(values: Array, /) -> Array:
        """Return the natural logarithm of every element."""
        ...

    @staticmethod
    def sqrt(values: Array, /) -> Array:
        """Return the square root of every element."""
        ...

    @staticmethod
    def cos(values: Array, /) -> Array:
        """Return the cosine of every element."""
        ...

    @staticmethod
    def hypot(left: Array, right: Array, /) -> Array:
        """Return the root of the sum of two squares, without a square that overflows."""
        ...

    @staticmethod
    def atan2(left: Array, right: Array, /) -> Array:
        """Return the angle of the point (right, left), from −π to π."""
        ...

    @staticmethod
    def where(condition: Array, then: Array, otherwise: Array) -> Array:
        """Return `then` where the condition is not zero, else `otherwise`."""
        ...

    @staticmethod
    def largest(values: Array, /) -> Array:
        """Return the largest along the first axis, which is not empty."""
        ...

    @staticmethod
    def total(values: Array, /) -> Array:
        """Return the sum along the first axis."""
        ...

    @staticmethod
    def turned(values: Array, /) -> Array:
        """Return an array with its axes in reverse order, written out in that order."""
        ...

    @staticmethod
    def stacked(values: Sequence[Array]) -> Array:
        """Return arrays of one shape as one, along a new first axis."""
        ...

    @staticmethod
    def broadcast(values: Array, shape: tuple[int, ...]) -> Array:
        """Return an array as one of a larger shape, in which elements repeat."""
        ...

    @staticmethod
    def any_along(values: Array, axis: int) -> Array:
        """Tell whether any element along an axis, which is kept with size 1, is true."""
        ...

    @staticmethod
    def largest_along(values: Array, axis: int) -> Array:
        """Return the largest along an axis, which is kept with size 1; minus infinity of none."""
        ...

    @staticmethod
    def nth_largest_along(values: Array, axis: int, n: int) -> Array:
        """Return the n-th largest along an axis, kept with size 1; minus infinity of fewer."""
        ...

    @staticmethod
    def sum_along(values: Array, axes: tuple[int, ...]) -> Array:
        """Return the sum along some axes, which are kept with size 1."""
        ...

    @staticmethod
    def joined_along(values: Sequence[Array], axis: int) -> Array:
        """Return arrays one after the other along an axis, which share their other axes."""
        ...

    @classmethod
    def of(cls, values: Sequence[Array]) -> Backend:
        """Return the backend for a computation with some arrays of this kind, maybe none."""
        ...

    def array(self, values: Array) -> Array:
        """Return row numbers or truth values as an array of this kind."""
        ...

    def real(self, values: Array) -> Array:
        """Return numbers as real ones of this kind, in the precision of the computation."""
        ...

    def full(self, count: int, value: float | bool) -> Array:
        """Return an array that holds one value, as real numbers or as truth values."""
        ...

    def take(self, values: Array, rows: Array) -> Array:
        """Return the rows of the values."""
        ...

    def put(self, values: Array, rows: Array, new: Array) -> Array:
        """Return a copy of the values with other ones in some rows."""
        ...

    def any_of(self, chosen: Array, groups: Array, count: int) -> Array:
        """Tell for every group whether any of its members is chosen."""
        ...

    def sum_of(self, values: Array, groups: Array, count: int) -> Array:
        """Return the sum of every group."""
        ...

    def count_of(self, groups: Array, count: int) -> Array:
        """Return the number of members of every group, as a real number."""
        ...

    def largest_of(self, values: Array, groups: Array, count: int) -> Array:
        """Return the largest of every group, or minus infinity."""
        ...

    def rows_of(self, values: Array, groups: Array, count: int, absent: float) -> Array:
        """Return the members of every group in a row of its own, filled up with one value.

        Args:
            values: real numbers (k,).
            groups: (k,), the group of each.
            count: the number of groups, n.
            absent: what the rows of smaller groups are filled up with.

        Returns:
            (n, m), m the size of the largest group.
        """
        ...


class _Numpy(Backend):
    differentiable = False
    tolerance = 1e-9

    minimum = staticmethod(np.minimum)
    maximum = staticmethod(np.maximum)
    exp = staticmethod(np.exp)
    log = staticmethod(np.log)
    sqrt = staticmethod(np.sqrt)
    cos = staticmethod(np.cos)
    hypot = staticmethod(np.hypot)
    atan2 = staticmethod(np.arctan2)

    @staticmethod
    def owns(value: object) -> bool:
        return isinstance(value, np.ndarray)

    @staticmethod
    def is_real(values: Array) -> bool:
        return values.dtype.kind in "biuf"

    @staticmethod
    def has_nan(values: Array) -> bool:
        return bool(np.isnan(values).any())

    @staticmethod
    def is_finite(values: Array) -> bool:
        return bool(np.isfinite(values).all())

    @staticmethod
    def plain(values: Array) -> npt.NDArray[Any]:
        return np.asarray(values)

    @staticmethod
    def where(condition: Array, then: Array, otherwise: Array) -> Array:
        chosen = np.asarray(condition)
        return np.where(chosen if chosen.dtype == np.bool_ else chosen != 0, then, otherwise)

    @staticmethod
    def largest(values: Array) -> Array:
        return values.max(axis=0)

    @staticmethod
    def total(values: Array) -> Array:
        return values.sum(axis=0)

    @staticmethod
    def turned(values: Array) -> Array:
        return np.ascontiguousarray(values.T)

    @staticmethod
    def stacked(values: Sequence[Array]) -> Array:
        return np.stack(values)

    @staticmethod
    def broadcast(values: Array, shape: tuple[int, ...]) -> Array:
        return values if values.shape == shape else np.broadcast_to(values, shape)

    @staticmethod
    def any_along(values: Array, axis: int) -> Array:
        return values.any(axis=axis, keepdims=True)

    @staticmethod
    def largest_along(values: Array, axis: int) -> Array:
        return values.max(axis=axis, keepdims=True, initial=-math.inf)

    @staticmethod
    def nth_largest_along(values: Array, axis: int, n: int) -> Array:
        size = values.shape[axis]
        if size < n:
            return np.full_like(values, -math.inf, shape=_with_one(values.shape, axis))
        return np.partition(values, size - n, axis).take([size - n], axis)

    @staticmethod
    def sum_along(values: Array, axes: tuple[int, ...]) -> Array:
        return values.sum(axis=axes, keepdims=True)

    @staticmethod
    def joined_along(values: Sequence[Array], axis: int) -> Array:
        return np.concatenate(values, axis)

    @classmethod
    def of(cls, values: Sequence[Array]) -> Backend:
        return cls()

    def array(self, values: Array) -> Array:
        return values

    def real(self, values: Array) -> Array:
        return np.asarray(values, dtype=np.float64)

    def full(self, count: int, value: float | bool) -> Array:
        return np.full(count, value)

    def take(self, values: Array, rows: Array) -> Array:
        return values.take(rows)

    def put(self, values: Array, rows: Array, new: Array) -> Array:
        changed = values.copy()
        changed[rows] = new
        return changed

    def any_of(self, chosen: Array, groups: Array, count: int) -> Array:
        found = np.zeros(count, dtype=bool)
        found[groups[chosen]] = True
        return found

    def sum_of(self, values: Array, groups: Array, count: int) -> Array:
        return np.bincount(groups, weights=values, minlength=count)

    def count_of(self, groups: Array, count: int) -> Array:
        return np.bincount(groups, minlength=count).astype(np.float64)

    def largest_of(self, values: Array, groups: Array, count: int) -> Array:
        largest = np.full(count, -np.inf)
        np.maximum.at(largest, groups, values)
        return largest

    def rows_of(self, values: Array, groups: Array, count: int, absent: float) -> Array:
        order = groups.argsort(kind="stable")
        sizes = np.bincount(groups, minlength=count)
        groups = groups[order]
        places = np.arange(len(groups)) - (sizes.cumsum() - sizes)[groups]
        rows = np.full((count, sizes.max(initial=0)), absent)
        rows[groups, places] = values[order]
        return rows


class _Torch(Backend):
    """Gradients go through values, not through choices."""

    differentiable = True

    def __init__(self, device: Any, dtype: Any) -> None:
        self._torch = sys.modules["torch"]
        self._device = device
        self._dtype = dtype  # of real numbers
        self.tolerance = 1e-9 if dtype == self._torch.float64 else 1e-6

    @staticmethod
    def owns(value: object) -> bool:
        torch = sys.modules.get("torch")
        return torch is not None and isinstance(value, torch.Tensor)

    @staticmethod
    def is_real(values: Array) -> bool:
        return not values.is_complex()

    @staticmethod
    def has_nan(values: Array) -> bool:
        return bool(values.isnan().any())

    @staticmethod
    def is_finite(values: Array) -> bool:
        return bool(values.isfinite().all())

    @staticmethod
    def plain(values: Array) -> npt.NDArray[Any]:
        return np.asarray(values.detach().cpu())

    @staticmethod
    def minimum(left: Array, right: Array) -> Array:
        return sys.modules["torch"].minimum(*_Torch._alike(left, right))

    @staticmethod
    def maximum(left: Array, right: Array) -> Array:
        return sys.modules["torch"].maximum(*_Torch._alike(left, right))

    @staticmethod
    def exp(values: Array) -> Array:
        return values.exp()

    @staticmethod
    def log(values: Array) -> Array:
        return values.log()

    @staticmethod
    def sqrt(values: Array) -> Array:
        return values.sqrt()

    @staticmethod
    def cos(values: Array) -> Array:
        return values.cos()

    @staticmethod
    def hypot(left: Array, right: Array) -> Array:
        torch = sys.modules["torch"]
        left, right = _Torch._alike(left, right)
        # Where both are 0 there is no gradient, and torch's is NaN: two entities at one place.
        apart = (left != 0) | (right != 0)
        return torch.where(apart, torch.hypot(torch.where(apart, left, 1.0), right), 0.0)

    @staticmethod
    def atan2(left: Array, right: Array) -> Array:
        return sys.modules["torch"].atan2(*_Torch._alike(left, right))

    @staticmethod
    def where(condition: Array, then: Array, otherwise: Array) -> Array:
        torch = sys.modules["torch"]
        chosen = torch.as_tensor(condition) != 0
        return torch.where(
            chosen, *(pair.to(chosen.device) for pair in _Torch._alike(then, otherwise))
        )

    @staticmethod
    def _alike(left: Array, right: Array) -> tuple[Array, Array]:
        """Return two values as tensors of one type; a number takes that of the tensor beside it."""
        torch = sys.modules["torch"]
        tensors = [value for value in (left, right) if isinstance(value, torch.Tensor)]
        like = tensors[0] if tensors else torch.empty(0, dtype=torch.float64)
        return tuple(
            torch.as_tensor(value, dtype=like.dtype, device=like.device)
            if isinstance(value, float | int)
            else torch.as_tensor(value)
            for value in (left, right)
        )

    @staticmethod
    def largest(values: Array) -> Array:
        return values.amax(0)

    @staticmethod
    def total(values: Array) -> Array:
        return values.sum(0)

    @staticmethod
    def turned(values: Array) -> Array:
        return values.permute(*reversed(range(values.ndim))).contiguous()

    @staticmethod
    def stacked(values: Sequence[Array]) -> Array:
        return sys.modules["torch"].stack(values)

    @staticmethod
    def broadcast(values: Array, shape: tuple[int, ...]) -> Array:
        return values.expand(shape)

    @staticmethod
    def any_along(values: Array, axis: int) -> Array:
        return values.any(dim=axis, keepdim=True)

    @staticmethod
    def largest_along(values: Array, axis: int) -> Array:
        if values.shape[axis]:
            return values.amax(axis, keepdim=True)
        return values.new_full(_with_one(values.shape, axis), -math.inf)

    @staticmethod
    def nth_largest_along(values: Array, axis: int, n: int) -> Array:
        if values.shape[axis] < n:
            return values.new_full(_with_one(values.shape, axis), -math.inf)
        return values.topk(n, axis).values.narrow(axis, n - 1, 1)

    @staticmethod
    def sum_along(values: Array, axes: tuple[int, ...]) -> Array:
        return values.sum(dim=axes, keepdim=True) if axes else values

    @staticmethod
    def joined_along(values: Sequence[Array], axis: int) -> Array:
        return sys.modules["torch"].cat(list(values), axis)

    @classmethod
    def of(cls, values: Sequence[Array]) -> Backend:
        torch = sys.modules["torch"]
        dtypes = [tensor.dtype for tensor in values if tensor.is_floating_point()]
        # Half precision overflows at the square of 256: it is computed with in single precision.
        precision = torch.float64 if torch.float64 in dtypes or not dtypes else torch.float32
        return cls(max((tensor.device for tensor in values), key=str), precision)

    def array(self, values: Array) -> Array:
        return self._torch.as_tensor(values, device=self._device)

    def real(self, values: Array) -> Array:
        return self._torch.as_tensor(values, dtype=self._dtype, device=self._device)

    def full(self, count: int, value: float | bool) -> Array:
        dtype = self._torch.bool if isinstance(value, bool) else self._dtype
        return self._torch.full((count,), value, device=self._device, dtype=dtype)

    def take(self, values: Array, rows: Array) -> Array:
        return values[rows]

    def put(self, values: Array, rows: Array, new: Array) -> Array:
        return values.index_put((rows,), new.to(values.dtype))

    def any_of(self, chosen: Array, groups: Array, count: int) -> Array:
        found = self.full(count, value=False)
        found[groups[chosen]] = True
        return found

    def sum_of(self, values: Array, groups: Array, count: int) -> Array:
        return self.full(count, 0.0).index_add(0, groups, values.to(self._dtype))

    def count_of(self, groups: Array, count: int) -> Array:
        return self._torch.bincount(groups, minlength=count).to(self._dtype)

    def largest_of(self, values: Array, groups: Array, count: int) -> Array:
        return self.full(count, -math.inf).scatter_reduce(0, groups, values, "amax")

    def rows_of(self, values: Array, groups: Array, count: int, absent: float) -> Array:
        order = groups.argsort(stable=True)
        sizes = self._torch.bincount(groups, minlength=count)
        groups = groups[order]
        places = self._torch.arange(len(groups), device=self._device)
        places = places - (sizes.cumsum(0) - sizes)[groups]
        most = int(sizes.max()) if count else 0
        rows = self.full(count * most, absent).reshape(count, most)
        return rows.index_put((groups, places), values[order].to(self._dtype))


def _with_one(shape: Sequence[int], axis: int) -> list[int]:
    """Return a shape in which an axis has size 1."""
    return [1 if i == axis else size for i, size in enumerate(shape)]


# Where several kinds meet, the first of them takes the others in.
BACKENDS: tuple[type[Backend], ...] = (_Torch, _Numpy)


def add_backend(kind: type[Backend]) -> None:
    """Add a kind of array, which takes in all others that there are so far."""
    global BACKENDS  # noqa: PLW0603 (a table that modules add to while they are imported)
    BACKENDS = (kind, *BACKENDS)


_NUMBERS_AND_NUMPY = frozenset({float, int, bool, np.ndarray})


def _kind_of(values: Sequence[Array]) -> type[Backend] | None:
    """Return the class of backend that takes some values; None where all are plain numbers."""
    types = set(map(type, values))
    if types <= _NUMBERS_AND_NUMPY:  # as most are, and asking every backend takes longer
        return _Numpy if np.ndarray in types else None
    for kind in BACKENDS:
        if any(map(kind.owns, values)):
            return kind
    return None


def backend_of(values: Sequence[Array]) -> Backend:
    """Return the backend for a computation with some values; numpy's where all are numbers."""
    kind = _kind_of(values) or _Numpy
    return kind.of([value for value in values if kind.owns(value)])


def is_array(value: object) -> bool:
    """Tell whether a value is an array of some backend."""
    return _kind_of([value]) is not None


def is_differentiable(value: object) -> bool:
    """Tell whether gradients go through a value."""
    kind = _kind_of([value])
    return kind is not None and kind.differentiable


def is_real(value: Array) -> bool:
    """Tell whether an array holds numbers that can be real ones: neither texts nor complex ones."""
    kind = _kind_of([value])
    return kind is None or kind.is_real(value)


def has_nan(value: Array) -> bool:
    """Tell whether a number, or any element of an array, is NaN."""
    if isinstance(value, float):  # as most are that a single scene asks about
        return math.isnan(value)
    kind = _kind_of([value])
    return math.isnan(value) if kind is None else kind.has_nan(value)


def is_finite(value: Array) -> bool:
    """Tell whether a number, or every element of an array, is finite."""
    if isinstance(value, float):
        return math.isfinite(value)
    kind = _kind_of([value])
    return math.isfinite(value) if kind is None else kind.is_finite(value)


def as_reals(value: object) -> npt.NDArray[np.float64] | None:
    """Return numbers of any type, in arrays or lists, as numpy's own; None if they are none."""
    kind = _kind_of([value])
    try:
        array = np.asarray(value) if kind is None else kind.plain(value)
    except (TypeError, ValueError):  # lists of several lengths
        return None
    return array.astype(np.float64) if array.dtype.kind in "biuf" else None


def as_float(value: object) -> float | None:
    """Return a real number of any type, such as numpy's, as Python's own; None if it is none.

    Texts are no numbers, and arrays only those without dimensions.
    """
    if type(value) is float:
        return value
    if isinstance(value, str | bytes | bytearray) or getattr(value, "ndim", None):
        return None
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError, RuntimeError):  # torch raises the last
        return None


def _elementwise(name: str, of_numbers: Callable[..., float]) -> Callable[..., Array]:
    """Return a function of numbers and arrays: the backend's own, or the one for plain numbers."""

    def function(*values: Array) -> Array:
        kind = _kind_of(values)
        return of_numbers(*values) if kind is None else getattr(kind, name)(*values)

    return function


minimum = _elementwise("minimum", min)
maximum = _elementwise("maximum", max)
exp = _elementwise("exp", math.exp)
log = _elementwise("log", math.log)
sqrt = _elementwise("sqrt", math.sqrt)
cos = _elementwise("cos", math.cos)
hypot = _elementwise("hypot", math.hypot)
atan2 = _elementwise("atan2", math.atan2)
where = _elementwise("where", lambda condition, then, otherwise: then if condition else otherwise)


def largest(values: Array) -> Array:
    """Return the largest along the first axis of an array, which is not empty."""
    return _backend(values).largest(values)


def total(values: Array) -> Array:
    """Return the sum along the first axis of an array."""
    return _backend(values).total(values)


def _backend(values: Array) -> type[Backend]:
    kind = _kind_of([values])
    assert kind is not None, "an array is expected"
    return kind


def plain(values: Array) -> npt.NDArray[Any]:
    """Return the elements of an array as an array of numpy's, without gradients."""
    return _backend(values).plain(values)
