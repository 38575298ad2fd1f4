"""Arrays of lanes: what is done to them stands on a tape."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, ClassVar, NoReturn

import numpy as np
import numpy.typing as npt

from sfol import arrays
from sfol.arrays import Array, Indices
from sfol.engines.tape import NotRecordableError, Number, Tape

_PLAIN = (float, int, np.ndarray, np.generic)  # and no tensor, which is no constant


def given(tape: Tape, name: int, numbers: npt.NDArray[Any]) -> Recorded:
    """Return numbers of a scene that are given as an array; see `Tape.given`."""
    return Recorded(tape, tape.given(name, numbers))


def _binary(operation: str) -> Callable[[Recorded, Array], Recorded]:
    return lambda self, other: self.tape_of(operation, self, other)


def _reflected(operation: str) -> Callable[[Recorded, Array], Recorded]:
    return lambda self, other: self.tape_of(operation, other, self)


def _unary(operation: str) -> Callable[[Recorded], Recorded]:
    return lambda self: self.tape_of(operation, self)


class Recorded:
    """An array of lanes; what is done to it is recorded.

    Args:
        tape: where.
        ids: the lane of each element.
    """

    __array_ufunc__ = None  # so that numpy leaves operators to this class
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, tape: Tape, ids: Indices) -> None:
        self.tape = tape
        self.ids = ids

    @property
    def shape(self) -> tuple[int, ...]:
        """Its shape."""
        return self.ids.shape

    @property
    def ndim(self) -> int:
        """How many axes it has."""
        return self.ids.ndim

    @property
    def dtype(self) -> np.dtype[Any]:
        """Truth values, or real numbers."""
        truths = all(self.tape.is_truth(lane) for lane in self.ids.reshape(-1).tolist())
        return np.dtype(np.bool_ if truths and self.ids.size else np.float64)

    @staticmethod
    def tape_of(operation: str, *values: Array) -> Recorded:
        """Return the results of an operation on arrays and numbers, one of which is recorded."""
        tape = next(value.tape for value in values if isinstance(value, Recorded))
        columns = np.broadcast_arrays(*(_ids(tape, value) for value in values))
        flat = zip(*(column.reshape(-1).tolist() for column in columns), strict=True)
        ids = np.array([tape.applied(operation, *lanes) for lanes in flat], dtype=np.intp)
        return Recorded(tape, ids.reshape(columns[0].shape))

    __add__, __radd__ = _binary("+"), _reflected("+")
    __sub__, __rsub__ = _binary("-"), _reflected("-")
    __mul__, __rmul__ = _binary("*"), _reflected("*")
    __truediv__, __rtruediv__ = _binary("/"), _reflected("/")
    __pow__, __rpow__ = _binary("**"), _reflected("**")
    __and__, __rand__ = _binary("and"), _reflected("and")
    __or__, __ror__ = _binary("or"), _reflected("or")
    __lt__, __le__, __gt__, __ge__ = (_binary(name) for name in ("<", "<=", ">", ">="))
    __eq__, __ne__ = _binary("=="), _binary("!=")  # type: ignore[assignment]
    __neg__, __abs__, __invert__ = _unary("neg"), _unary("abs"), _unary("not")

    def __pos__(self) -> Recorded:
        return self

    def __bool__(self) -> bool:
        return self.tape.truth(int(self.ids.reshape(()).item()))

    def __getitem__(self, index: Any) -> Recorded:
        return Recorded(self.tape, np.asarray(self.ids[index]))

    def __len__(self) -> int:
        return len(self.ids)

    def __iter__(self) -> NoReturn:
        raise NotRecordableError

    def __getattr__(self, name: str) -> NoReturn:
        raise NotRecordableError(name) if not name.startswith("__") else AttributeError(name)

    __float__ = __int__ = __index__ = __array__ = __iter__

    def reshape(self, *shape: Any) -> Recorded:
        """Return it in another shape."""
        return Recorded(self.tape, self.ids.reshape(*shape))

    def swapaxes(self, first: int, second: int) -> Recorded:
        """Return it with two axes swapped."""
        return Recorded(self.tape, self.ids.swapaxes(first, second))

    def all(self) -> Recorded:
        """Tell whether all are true."""
        return self.reshape(-1).folded("and", 0, start=True)

    def any(self, axis: int) -> Recorded:
        """Tell whether any along an axis is true."""
        return self.folded("or", axis, start=False)

    def sum(self, axis: int) -> Recorded:
        """Return the sum along an axis."""
        return self.folded("+", axis, start=0.0)

    def folded(self, operation: str, axis: int, *, start: Number) -> Recorded:
        """Return what an operation makes of all along an axis, one after the other.

        Args:
            operation: of two.
            axis: which.
            start: what it makes of none.
        """
        if not self.ids.shape[axis]:
            shape = np.delete(self.ids.shape, axis)
            return Recorded(self.tape, np.full(shape, self.tape.constant(start), dtype=np.intp))
        parts = [Recorded(self.tape, part) for part in np.moveaxis(self.ids, axis, 0)]
        return reduce(lambda left, right: self.tape_of(operation, left, right), parts)


def _ids(tape: Tape, value: Array) -> Indices:
    if isinstance(value, Recorded):
        return value.ids
    numbers = np.asarray(value) if isinstance(value, _PLAIN) else np.array(None)
    if numbers.dtype.kind not in "biuf":
        raise NotRecordableError
    ids = [tape.constant(number) for number in numbers.reshape(-1).tolist()]
    return np.array(ids, dtype=np.intp).reshape(numbers.shape)


class _Lanes(arrays.Backend):
    differentiable: ClassVar[bool] = False
    tolerance = 1e-9

    def __init__(self, tape: Tape) -> None:
        self._tape = tape

    @staticmethod
    def owns(value: object) -> bool:
        return isinstance(value, Recorded)

    @staticmethod
    def is_real(values: Array) -> bool:
        return True

    @staticmethod
    def has_nan(values: Array) -> bool:
        return bool(Recorded.tape_of("isnan", values).reshape(-1).any(0))

    @staticmethod
    def is_finite(values: Array) -> bool:
        finite = Recorded.tape_of("isfinite", values).reshape(-1)
        return all(bool(finite[i]) for i in range(len(finite)))

    @staticmethod
    def plain(values: Array) -> NoReturn:
        raise NotRecordableError

    @staticmethod
    def minimum(left: Array, right: Array) -> Array:
        return Recorded.tape_of("minimum", left, right)

    @staticmethod
    def maximum(left: Array, right: Array) -> Array:
        return Recorded.tape_of("maximum", left, right)

    @staticmethod
    def exp(values: Array) -> Array:
        return Recorded.tape_of("exp", values)

    @staticmethod
    def log(values: Array) -> Array:
        return Recorded.tape_of("log", values)

    @staticmethod
    def sqrt(values: Array) -> Array:
        return Recorded.tape_of("sqrt", values)

    @staticmethod
    def cos(values: Array) -> Array:
        return Recorded.tape_of("cos", values)

    @staticmethod
    def hypot(left: Array, right: Array) -> Array:
        return Recorded.tape_of("hypot", left, right)

    @staticmethod
    def atan2(left: Array, right: Array) -> Array:
        return Recorded.tape_of("atan2", left, right)

    @staticmethod
    def where(condition: Array, then: Array, otherwise: Array) -> Array:
        return Recorded.tape_of("where", condition, then, otherwise)

    @staticmethod
    def largest(values: Array) -> Array:
        return values.folded("maximum", 0, start=-math.inf)

    @staticmethod
    def total(values: Array) -> Array:
        return values.sum(0)

    @staticmethod
    def turned(values: Array) -> Array:
        return Recorded(values.tape, values.ids.T)

    @staticmethod
    def stacked(values: Sequence[Array]) -> Array:
        return Recorded(values[0].tape, np.stack([value.ids for value in values]))

    @staticmethod
    def broadcast(values: Array, shape: tuple[int, ...]) -> Array:
        return Recorded(values.tape, np.broadcast_to(values.ids, shape))

    @staticmethod
    def any_along(values: Array, axis: int) -> Array:
        return Recorded(values.tape, np.expand_dims(values.any(axis).ids, axis))

    @staticmethod
    def largest_along(values: Array, axis: int) -> Array:
        largest = values.folded("maximum", axis, start=-math.inf)
        return Recorded(values.tape, np.expand_dims(largest.ids, axis))

    @staticmethod
    def nth_largest_along(values: Array, axis: int, n: int) -> Array:
        """Keep the n largest in order, and let each further one sink to its place among them."""
        parts = [Recorded(values.tape, part) for part in np.moveaxis(values.ids, axis, 0)]
        lowest = values.tape.constant(-math.inf)
        shape = np.delete(values.ids.shape, axis)
        if len(parts) < n:
            lowest_of_all = np.full(shape, lowest, dtype=np.intp)
            return Recorded(values.tape, np.expand_dims(lowest_of_all, axis))
        kept = [Recorded(values.tape, np.full(shape, lowest, dtype=np.intp)) for _ in range(n)]
        for part in parts:
            for place, other in enumerate(kept):
                kept[place] = Recorded.tape_of("maximum", other, part)
                part = Recorded.tape_of("minimum", other, part)  # noqa: PLW2901
        return Recorded(values.tape, np.expand_dims(kept[-1].ids, axis))

    @staticmethod
    def joined_along(values: Sequence[Array], axis: int) -> Array:
        return Recorded(values[0].tape, np.concatenate([value.ids for value in values], axis))

    @staticmethod
    def sum_along(values: Array, axes: tuple[int, ...]) -> Array:
        for axis in axes:
            values = Recorded(values.tape, np.expand_dims(values.sum(axis).ids, axis))
        return values

    @classmethod
    def of(cls, values: Sequence[Array]) -> arrays.Backend:
        return cls(values[0].tape)

    def array(self, values: Array) -> Array:
        return Recorded(self._tape, _ids(self._tape, values))

    def real(self, values: Array) -> Array:
        numbers = self.array(values)
        return 1.0 * numbers if numbers.dtype == np.bool_ else numbers

    def take(self, values: Array, rows: Array) -> NoReturn:
        raise NotRecordableError

    def put(self, values: Array, rows: Array, new: Array) -> NoReturn:
        raise NotRecordableError

    def any_of(self, chosen: Array, groups: Array, count: int) -> NoReturn:
        raise NotRecordableError

    def sum_of(self, values: Array, groups: Array, count: int) -> NoReturn:
        raise NotRecordableError

    def count_of(self, groups: Array, count: int) -> NoReturn:
        raise NotRecordableError

    def largest_of(self, values: Array, groups: Array, count: int) -> NoReturn:
        raise NotRecordableError

    def rows_of(self, values: Array, groups: Array, count: int, absent: float) -> NoReturn:
        raise NotRecordableError

    def full(self, count: int, value: float | bool) -> Array:
        return Recorded(self._tape, np.full(count, self._tape.constant(value), dtype=np.intp))


arrays.add_backend(_Lanes)
