"""What is wanted of steps, such as their rewards, repeated from a tape."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sfol import arrays
from sfol.arrays import Array
from sfol.engines.lanes import given
from sfol.engines.tape import MOST_NUMBERS, NotRecordableError, Program, Tape
from sfol.errors import SfolError
from sfol.observations.plans import Observation, ObservedStep

Reals = npt.NDArray[np.float64]
# How many steps are repeated together: what they compute then stays in a processor's cache. A tape
# that is too long even for these takes longer than an evaluation.
BLOCK = 4096
_Keys = tuple[Any, ...]
_Step = Sequence[Observation]
_NUMBERS = (float, int, np.number, np.bool_)


class Leaf(NamedTuple):
    """An array of a step: of which whole, the keys there, and its shape without B."""

    whole: int
    keys: _Keys
    shape: tuple[int, ...]


class RecordedSteps:
    """Repeats what a reward function does to steps.

    It is recorded when it is asked for a second time with the same numbers. Steps of another form,
    and those for which the tape does not hold, are given back.

    Steps are what `ObservedStep` has, in its order.

    Args:
        evaluate: what is wanted of B steps, (B,) each.
        of_one: whether steps are of one scene, without an axis B.
    """

    def __init__(
        self, evaluate: Callable[[ObservedStep], Sequence[Array]], *, of_one: bool = False
    ) -> None:
        self._evaluate = evaluate
        self._of_one = of_one
        self._state: object = None
        self._asked = 0
        self._recording: Recording | None = None

    def numbers(self, step: _Step, state: object) -> list[float] | None:
        """Return what is wanted of one step; None if it has to be found out by evaluation.

        Args:
            step: of one scene.
            state: equal if the reward function has the same numbers.
        """
        recording = self._recorded(step, state)
        return None if recording is None else recording.numbers(step)

    def rows(self, step: _Step, state: object) -> Reals | None:
        """Return what is wanted of B steps, (k, B), as `numbers` does."""
        recording = self._recorded(step, state)
        values = None if recording is None else recording.arrays(step)
        if recording is None or values is None:
            return None
        rows = np.empty((len(values), recording.size_of(step)))
        for row, value in zip(rows, values, strict=True):
            row[...] = value
        return rows

    def own_arrays(self, step: _Step, state: object) -> list[Array] | None:
        """Return what is wanted of B steps as arrays (B,), each one of its own to write to."""
        recording = self._recorded(step, state)
        values = None if recording is None else recording.arrays(step)
        return None if recording is None or values is None else recording.apart(values, step)

    def _recorded(self, step: _Step, state: object) -> Recording | None:
        if not _is_plain(step[0]):
            return None
        if state != self._state:
            self._state, self._asked, self._recording = state, 0, None
        if self._asked < 2:
            self._asked += 1
            if self._asked == 2:
                self._recording = record(self._evaluate, step, of_one=self._of_one)
        return self._recording


class Recording:
    """What is wanted of steps, on tape.

    Attributes:
        leaves: name → the array that it names, of those that are needed.
        program: gives what is wanted.
    """

    def __init__(self, leaves: Sequence[Leaf], program: Program) -> None:
        self.program = program
        self._needed: dict[int, list[int]] = {}  # of each array that is given
        for name, index, _ in program.given:
            self._needed.setdefault(name, []).append(index)
        self.leaves = {name: leaves[name] for name in self._needed}

    def numbers(self, step: _Step) -> list[float] | None:
        """Return what is wanted of one step; None if the tape does not hold for it."""
        given = {}
        for name, leaf in self.leaves.items():
            numbers = _numbers(leaf_of(step, leaf), leaf.shape)
            if numbers is None:
                return None
            given[name] = numbers
        return self.program.of_numbers(given)

    def arrays(self, step: _Step) -> list[Array] | None:
        """Return what is wanted of B steps; None if the tape does not hold for one of them."""
        given = self._given(step)
        if given is None:
            return None
        size = self.size_of(step)
        if size <= BLOCK:
            return self.program.of_arrays(given)
        blocks = []
        for start in range(0, size, BLOCK):
            block = {name: rows[:, start : start + BLOCK] for name, rows in given.items()}
            values = self.program.of_arrays(block)
            if values is None:
                return None
            blocks.append(values)
        return [_joined(parts) for parts in zip(*blocks, strict=True)]

    def _given(self, step: _Step) -> dict[int, Reals] | None:
        """Return the arrays that the tape takes, (k, B); None if it does not hold for them."""
        given: dict[int, Reals] = {}
        sizes = set()
        for name, leaf in self.leaves.items():
            value = leaf_of(step, leaf)
            if not _is_array(value) or value.shape[1:] != leaf.shape or not len(value):
                return None
            if min(len(value), BLOCK) * self.program.size > MOST_NUMBERS:
                return None
            sizes.add(len(value))
            columns = value.reshape(len(value), -1).T
            given[name] = numbers = np.ascontiguousarray(columns, dtype=np.float64)
            if np.count_nonzero(np.isnan(numbers)) and np.isnan(numbers[self._needed[name]]).any():
                return None
        return given if len(sizes) == 1 else None

    def size_of(self, step: _Step) -> int:
        """Return how many steps there are."""
        return len(leaf_of(step, next(iter(self.leaves.values()))))

    def apart(self, values: Sequence[Array], step: _Step) -> list[Array]:
        """Return what `arrays` gave as arrays (B,), each one of its own."""
        size = self.size_of(step)
        seen: set[int] = set()
        own: list[Array] = []
        for value in values:
            if not isinstance(value, np.ndarray):
                own.append(np.full(size, value))
            elif id(value) in seen or value.base is not None:
                own.append(value.copy())
            else:
                own.append(value)
            seen.add(id(value))
        return own


def record(
    evaluate: Callable[[ObservedStep], Sequence[Array]], step: _Step, *, of_one: bool
) -> Recording | None:
    """Record the evaluation of the first of some steps, if that can be done."""
    tape = Tape()
    leaves: list[Leaf] = []

    def recorded(whole: int, keys: _Keys, value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: recorded(whole, (*keys, key), part) for key, part in value.items()}
        if isinstance(value, tuple):
            return tuple(recorded(whole, (*keys, i), part) for i, part in enumerate(value))
        if value is None:
            return None
        if not isinstance(value, (np.ndarray, *_NUMBERS) if of_one else np.ndarray):
            raise NotRecordableError
        first: Any = np.asarray(value)[None] if of_one else np.asarray(value)[:1]
        if not _is_array(first):
            raise NotRecordableError
        leaves.append(Leaf(whole, keys, first.shape[1:]))
        return given(tape, len(leaves) - 1, first)

    try:
        wholes = [recorded(i, (), value) for i, value in enumerate(step)]
        wanted = [value.ids.reshape(()).item() for value in evaluate(ObservedStep(*wholes))]
        return Recording(leaves, tape.program(wanted))
    except (NotRecordableError, SfolError, TypeError):
        return None  # an evaluation will say what is wrong with it, if anything is


def first_of(value: Any) -> Any:
    """Return the first of B observations as numpy's arrays, with an axis B of 1."""
    if isinstance(value, Mapping):
        return {key: first_of(part) for key, part in value.items()}
    if isinstance(value, tuple):
        return tuple(map(first_of, value))
    return arrays.plain(value)[:1] if arrays.is_array(value) else value


def _joined(parts: Sequence[Array]) -> Array:
    return np.concatenate(parts) if isinstance(parts[0], np.ndarray) else parts[0]


def leaf_of(step: _Step, leaf: Leaf) -> Any:
    """Return an array of a step, or None if there is none."""
    value = step[leaf.whole]
    try:
        for key in leaf.keys:
            value = value[key]
    except (KeyError, IndexError, TypeError):
        return None
    return value


def _is_plain(observation: Observation) -> bool:
    """Tell whether an observation has numbers or numpy's arrays, going by the first of them."""
    while isinstance(observation, dict | tuple) and observation:
        values = observation.values() if isinstance(observation, dict) else observation
        observation = next(iter(values))
    return isinstance(observation, np.ndarray | float | int | np.generic)


def _is_array(value: object) -> bool:
    return isinstance(value, np.ndarray) and value.dtype.kind in "biuf"


def _numbers(value: Any, shape: tuple[int, ...]) -> list[float] | None:
    """Return the numbers of one scene's array, or single number; None if it is none."""
    if isinstance(value, np.ndarray):
        if value.shape != shape or value.dtype.kind not in "biuf":
            return None
        numbers: list[float] = value.reshape(-1).tolist()
        return numbers if value.dtype.kind == "f" else [float(number) for number in numbers]
    if shape or not isinstance(value, _NUMBERS):
        return None
    return [float(value)]
