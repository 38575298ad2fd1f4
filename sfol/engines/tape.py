"""What is done to arrays, recorded once for one scene and repeated for any number of scenes.

What the reader of observations, the dense engine and the formulas do to arrays depends on the
knowledge base and the shapes alone, but for a few questions about values, such as whether any is
NaN. So it is done once with arrays that keep a tape of it. Each of their elements is a *lane*: one
number of every scene. Moving elements about costs nothing on a tape, what is computed twice stands
there once, and what is known beforehand not at all. Repeated, a lane is a number, for one scene, or
an array (B,).

Every answer to a question about values is kept with the tape. If one would be another in some
scene, the tape does not hold for these scenes and gives nothing.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping, Sequence, Set
from typing import Any

import numpy as np
import numpy.typing as npt

from sfol.arithmetic import FUNCTIONS, OPERATORS
from sfol.arrays import Array, Indices
from sfol.engines.ranges import ANY, RANGES, Range

MOST_LANES = 4_000  # of a program; recording more takes too long
MOST_NUMBERS = 1 << 20  # of all lanes in all scenes: 8 MB; beyond them an evaluation is faster
_DEEPEST, _MOST_NARROWED = 50, 200  # so that long sums are recorded in little time
Number = float | bool


class NotRecordableError(Exception):
    """Something is done to arrays that no tape holds."""


def _minimum(left: float, right: float) -> float:
    return right if right < left or right != right else left  # noqa: PLR0124 (NaN)


def _maximum(left: float, right: float) -> float:
    return right if right > left or right != right else left  # noqa: PLR0124 (NaN)


def _where(condition: Number, then: Number, otherwise: Number) -> Number:
    return then if condition else otherwise


# Operation → the function for numbers, and the one for arrays (B,).
OPERATIONS: Mapping[str, tuple[Callable[..., Any], Callable[..., Any]]] = {
    "+": (operator.add, np.add),
    "-": (operator.sub, np.subtract),
    "*": (operator.mul, np.multiply),
    "/": (OPERATORS["/"].of_numbers, np.true_divide),
    "**": (OPERATORS["**"].of_numbers, operator.pow),
    "neg": (operator.neg, np.negative),
    "abs": (abs, np.abs),
    "<": (operator.lt, np.less),
    "<=": (operator.le, np.less_equal),
    ">": (operator.gt, np.greater),
    ">=": (operator.ge, np.greater_equal),
    "==": (operator.eq, np.equal),
    "!=": (operator.ne, np.not_equal),
    "and": (operator.and_, np.logical_and),
    "or": (operator.or_, np.logical_or),
    "not": (operator.not_, np.logical_not),
    "isnan": (math.isnan, np.isnan),
    "isfinite": (math.isfinite, np.isfinite),
    "minimum": (_minimum, np.minimum),
    "maximum": (_maximum, np.maximum),
    "where": (_where, np.where),
    "cos": (math.cos, np.cos),
    "hypot": (FUNCTIONS["hypot"].of_numbers, np.hypot),
    "atan2": (FUNCTIONS["atan2"].of_numbers, np.arctan2),
    "exp": (FUNCTIONS["exp"].of_numbers, np.exp),
    "log": (FUNCTIONS["log"].of_numbers, np.log),
    "sqrt": (FUNCTIONS["sqrt"].of_numbers, np.sqrt),
}
_TRUTHS = frozenset({"<", "<=", ">", ">=", "==", "!=", "and", "or", "not", "isnan", "isfinite"})


class Tape:
    """What is done to lanes, in order.

    Attributes:
        values: of each lane in the scene with which it is recorded.
    """

    def __init__(self) -> None:
        self.values: list[Number] = []
        self._entries: list[tuple[Any, ...]] = []  # an operation and its lanes
        self._ranges: list[Range] = []
        self._found: dict[tuple[Any, ...], int] = {}
        self._guards: dict[int, bool] = {}

    def given(self, name: int, numbers: npt.NDArray[Any]) -> Indices:
        """Return the lanes of numbers of a scene that are given.

        Args:
            name: of all of them.
            numbers: of any shape; a tape holds for no scene in which one that is needed is NaN.
        """
        values = [0.0 if math.isnan(number) else float(number) for number in numbers.reshape(-1)]
        ids = [self._lane(("given", name, i), value) for i, value in enumerate(values)]
        return np.array(ids, dtype=np.intp).reshape(numbers.shape)

    def constant(self, value: Number) -> int:
        """Return the lane that has one value in every scene."""
        if isinstance(value, bool | np.bool_):
            return self._lane(("constant", bool(value)), bool(value))
        return self._lane(("constant", repr(float(value))), float(value))

    def applied(self, operation: str, *lanes: int) -> int:
        """Return the lane of an operation's results."""
        simpler = self._simplified(operation, lanes)
        if simpler is not None:
            return simpler
        with np.errstate(all="ignore"):
            value = OPERATIONS[operation][0](*(self.values[lane] for lane in lanes))
        if all(map(self.is_constant, lanes)):
            return self.constant(value)
        return self._lane((operation, *lanes), value)

    def truth(self, lane: int) -> bool:
        """Return a truth value, which must then be the same in every scene."""
        value = bool(self.values[lane])
        if not self.is_constant(lane):
            self._guards[lane] = value
        return value

    def is_constant(self, lane: int) -> bool:
        """Tell whether a lane is the same in every scene, whatever is given."""
        return bool(self._entries[lane][0] == "constant")

    def is_truth(self, lane: int) -> bool:
        """Tell whether a lane has truth values."""
        return isinstance(self.values[lane], bool)

    def program(self, outputs: Sequence[int]) -> Program:
        """Return what is needed for some lanes."""
        finite = self._implied()
        guards = {
            lane: value
            for lane, value in self._guards.items()
            if (self._entries[lane][0], value) not in (("isfinite", True), ("isnan", False))
            or self._entries[lane][1] not in finite
        }
        needed = self._needed([*outputs, *guards])
        return Program(
            {lane: self._entries[lane] for lane in sorted(needed)},
            {lane: self.values[lane] for lane in needed if self.is_constant(lane)},
            tuple(outputs),
            tuple(guards.items()),
        )

    def _lane(self, entry: tuple[Any, ...], value: Number) -> int:
        if entry not in self._found:
            if len(self._entries) > 10 * MOST_LANES:
                raise NotRecordableError
            self._found[entry] = len(self._entries)
            self._entries.append(entry)
            self._ranges.append(self._range(entry))
            self.values.append(value)
        return self._found[entry]

    def _range(self, entry: tuple[Any, ...]) -> Range:
        operation, *rest = entry
        if operation == "given":
            return Range(nan=False)
        if operation == "constant":
            value = float(rest[0])
            minus_zero = value == 0.0 and math.copysign(1.0, value) < 0.0
            number = Range(value, value, nan=False, minus_zero=minus_zero)
            return ANY if math.isnan(value) else number
        if operation in _TRUTHS:
            return Range(0.0, 1.0, nan=False, minus_zero=False)
        known = RANGES.get(operation)
        return known(*(self._ranges[lane] for lane in rest)) if known else ANY

    # -- what need not be computed ------------------------------------------------------------

    def _simplified(self, operation: str, lanes: tuple[int, ...]) -> int | None:
        """Return the lane that has the results of an operation without it; or None."""
        rule = _RULES.get(operation)
        return rule(self, operation, *lanes) if rule else None

    def _asked(self, question: str, lane: int) -> int | None:
        known = self._ranges[lane]
        if question == "isnan":
            return None if known.nan else self.constant(value=False)
        return self.constant(value=True) if known.is_finite else None

    def _joined(self, operation: str, left: int, right: int) -> int | None:
        for lane, other in ((left, right), (right, left)):
            if self.is_constant(lane):
                return lane if self.values[lane] == (operation == "or") else other
        return left if left == right else None

    def _chosen(self, _: str, condition: int, then: int, otherwise: int) -> int | None:
        if self.is_constant(condition):
            return then if self.values[condition] else otherwise
        narrower = self._narrowed(condition, then)
        wider = self._widened(condition, narrower, otherwise)
        if wider is None or narrower == otherwise:
            return narrower
        if (wider, narrower) == (condition, then):
            return None
        return self.applied("where", wider, narrower, otherwise)

    def _widened(self, condition: int, lane: int, zero: int) -> int | None:
        """Return a condition without x > 0, where x or else 0 is asked for and x is from 0 up."""
        if not self._is_zero(zero) or not self._ranges[lane].is_positive:
            return condition
        operation, *parts = self._entries[condition]
        superfluous = (">", lane, zero)
        if self._entries[condition] == superfluous:
            return None
        others = [part for part in parts if self._entries[part] != superfluous]
        return others[0] if operation == "and" and len(others) == 1 else condition

    def _neutral(self, operation: str, left: int, right: int) -> int | None:
        """Leave out what changes no number, not even the sign of a zero."""
        pairs = [(right, left)] if operation in ("/", "-") else [(left, right), (right, left)]
        for constant, other in pairs:
            if self.is_constant(constant) and not self.is_truth(constant):
                if self._changes_nothing(operation, constant, other):
                    return other
                if operation == "*" and self._is_zero(constant) and self._vanishes(other):
                    return constant
        return self._halved(left, right) if operation == "/" else None

    def _changes_nothing(self, operation: str, constant: int, other: int) -> bool:
        """Tell whether 1 x, x / 1, x - 0 or 0 + x is x; the last may not be, where x is -0."""
        if self.is_truth(other):
            return False
        if operation in ("*", "/"):
            return self.values[constant] == 1.0
        if self.values[constant] != 0.0:
            return False
        keeps = self._ranges[constant].minus_zero is (operation == "+")
        return keeps or not self._ranges[other].minus_zero

    def _is_zero(self, lane: int) -> bool:
        return (
            self.is_constant(lane) and self.values[lane] == 0.0 and self._ranges[lane].is_positive
        )

    def _vanishes(self, lane: int) -> bool:
        """Tell whether 0 times a lane is 0: it is finite, and the zero has no minus."""
        return self._ranges[lane].is_finite and self._ranges[lane].is_positive

    def _halved(self, lane: int, two: int) -> int | None:
        """Return x for (x + x) / 2, the middle of an exact bound, if x + x can't overflow."""
        operation, *summands = self._entries[lane]
        if operation != "+" or not self.is_constant(two) or self.values[two] != 2.0:
            return None
        left, right = summands
        known = self._ranges[lane]
        return left if left == right and known.is_finite and not self.is_truth(left) else None

    def _ordered(self, operation: str, left: int, right: int) -> int | None:
        """Return what is known beforehand of which one is the less."""
        swapped = operation in (">", ">=", "maximum")
        a, b = (self._ranges[lane] for lane in ((right, left) if swapped else (left, right)))
        always = a.high < b.low if operation in ("<", ">") else a.high <= b.low
        never = a.low > b.high if operation in ("<=", ">=") else a.low >= b.high
        if a.nan or b.nan or not (always or never):
            return self._truth_of(left) if operation == ">" and self._is_zero(right) else None
        if operation in ("minimum", "maximum"):
            return left if always else right
        return self.constant(value=always)

    def _truth_of(self, lane: int) -> int | None:
        """Return the truth value that a lane is as a number, if it is one."""
        operation, *factors = self._entries[lane]
        if operation != "*" or not self.is_constant(factors[0]) or self.values[factors[0]] != 1.0:
            return None
        return factors[1] if self.is_truth(factors[1]) else None

    def _narrowed(self, condition: int, lane: int) -> int:
        """Return a lane that is the same wherever a condition holds, and takes less."""
        holding = {condition}
        waiting = [condition]
        while waiting:
            operation, *rest = self._entries[waiting.pop()]
            if operation == "and":
                holding.update(rest)
                waiting += rest
        return self._under(holding, lane, {}, 0)

    def _under(self, holding: Set[int], lane: int, known: dict[int, int], depth: int) -> int:
        """Return a lane under conditions; lanes that are far from it stay as they are."""
        if lane in holding:
            return self.constant(value=True)
        operation, *rest = self._entries[lane]
        # What stands before the conditions does not ask for them.
        if operation not in OPERATIONS or lane < min(holding):
            return lane
        if lane not in known and (depth >= _DEEPEST or len(known) >= _MOST_NARROWED):
            return lane
        if lane not in known:
            if operation == "where" and rest[0] in holding:
                known[lane] = self._under(holding, rest[1], known, depth + 1)
            else:
                inner = [self._under(holding, lane, known, depth + 1) for lane in rest]
                known[lane] = lane if inner == rest else self.applied(operation, *inner)
        return known[lane]

    def _implied(self) -> set[int]:
        """Return the lanes that are finite because another one is that is asked about."""
        asked = [
            self._entries[lane][1]
            for lane, value in self._guards.items()
            if value and self._entries[lane][0] == "isfinite"
        ]
        implied: set[int] = set()
        waiting = list(asked)
        while waiting:
            operation, *lanes = self._entries[waiting.pop()]
            if operation in ("+", "-", "*", "neg", "abs"):  # what is infinite or NaN stays so
                new = [lane for lane in lanes if lane not in implied]
                implied.update(new)
                waiting += new
        return implied

    def _needed(self, lanes: Sequence[int]) -> set[int]:
        needed: set[int] = set()
        waiting = list(lanes)
        while waiting:
            lane = waiting.pop()
            if lane not in needed:
                needed.add(lane)
                operation, *inputs = self._entries[lane]
                waiting += inputs if operation in OPERATIONS else []
        return needed


_RULES: Mapping[str, Callable[..., int | None]] = {
    "and": Tape._joined,
    "or": Tape._joined,
    "where": Tape._chosen,
    "isnan": Tape._asked,
    "isfinite": Tape._asked,
    **dict.fromkeys(("<", "<=", ">", ">=", "minimum", "maximum"), Tape._ordered),
    **dict.fromkeys(("+", "-", "*", "/"), Tape._neutral),
}


class Program:
    """The operations of a tape that some of its lanes need.

    Attributes:
        size: how many lanes it has; all else is said of their places, from 0 on.
        given: the numbers that it takes: name, index, and where they are put.
        constants: places with a value.
        operations: in order, what is done to which places, and where its result is put.
        guards: places with the truth value that they must have, or the tape does not hold.
        outputs: where that is which is wanted.

    Args:
        entries: lane → an operation and its lanes, in their order.
        constants: lane → its value.
        outputs: the lanes that are wanted.
        guards: lanes with the truth value that they must have.
    """

    def __init__(
        self,
        entries: Mapping[int, tuple[Any, ...]],
        constants: Mapping[int, Number],
        outputs: tuple[int, ...],
        guards: tuple[tuple[int, bool], ...],
    ) -> None:
        places = {lane: place for place, lane in enumerate(entries)}
        self.operations = [
            (operation, tuple(places[lane] for lane in lanes), place)
            for place, (operation, *lanes) in enumerate(entries.values())
            if operation in OPERATIONS
        ]
        if len(self.operations) > MOST_LANES:
            raise NotRecordableError
        self.size = len(entries)
        self.constants = [(places[lane], value) for lane, value in constants.items()]
        self._start: list[Any] = [constants.get(lane) for lane in entries]
        self.given = [
            (name, index, place)
            for place, (kind, *rest) in enumerate(entries.values())
            if kind == "given"
            for name, index in [rest]
        ]
        self.outputs = [places[lane] for lane in outputs]
        self._start_of_arrays = self._faster_constants()
        self.guards = [(places[lane], value) for lane, value in guards]
        self._of_numbers, self._of_arrays = (
            [
                (OPERATIONS[operation][kind], len(inputs), *_three(inputs), place)
                for operation, inputs, place in self.operations
            ]
            for kind in (0, 1)
        )

    def _faster_constants(self) -> list[Any]:
        """Return what arrays start with: constants as arrays, which numpy need not convert.

        A power has another result with such an exponent, and outputs are arrays (B,) or numbers.
        """
        powers = [inputs for operation, inputs, _ in self.operations if operation == "**"]
        kept = {*self.outputs, *(place for inputs in powers for place in inputs)}
        constants = {place: np.array(value) for place, value in self.constants}
        return [
            constants.get(place) if place not in kept else value
            for place, value in enumerate(self._start)
        ]

    def of_numbers(self, given: Mapping[int, Sequence[float]]) -> list[float] | None:
        """Return the outputs for one scene; None if the tape does not hold for it.

        Args:
            given: name → the numbers of one scene.
        """
        lanes = self._start.copy()
        for name, index, place in self.given:
            lanes[place] = number = given[name][index]
            if number != number:  # noqa: PLR0124 (NaN, and math.isnan takes longer)
                return None
        _run(self._of_numbers, lanes)
        for place, value in self.guards:
            if lanes[place] != value:
                return None
        return [lanes[place] for place in self.outputs]

    def of_arrays(self, given: Mapping[int, npt.NDArray[np.float64]]) -> list[Array] | None:
        """Return the outputs for B scenes, (B,) or a number; None if the tape does not hold.

        Args:
            given: name → float64 (k, B), none of which is NaN.
        """
        lanes = self._start_of_arrays.copy()
        for name, index, place in self.given:
            lanes[place] = given[name][index]
        with np.errstate(all="ignore"):
            _run(self._of_arrays, lanes)
        for place, value in self.guards:
            if np.count_nonzero(lanes[place]) != (lanes[place].size if value else 0):
                return None
        return [lanes[place] for place in self.outputs]


def _three(inputs: tuple[int, ...]) -> tuple[int, int, int]:
    first, second, third = (*inputs, 0, 0)[:3]
    return first, second, third


def _run(
    steps: Sequence[tuple[Callable[..., Any], int, int, int, int, int]], lanes: list[Any]
) -> None:
    for function, count, first, second, third, place in steps:
        if count == 2:
            lanes[place] = function(lanes[first], lanes[second])
        elif count == 1:
            lanes[place] = function(lanes[first])
        else:
            lanes[place] = function(lanes[first], lanes[second], lanes[third])
