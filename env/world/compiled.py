"""How the street's inner loops are compiled, and where their code is kept.

A kernel is a pure function of numbers, arrays and tuples of both. It is compiled by numba when it
is called first. The code is kept beside its module or in the user's own folder for such files, so
that later processes load it. Tuples get their names inside of the kernel: to hand over a named one
takes five times as long as a plain one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar

from sfol.errors import missing_extra

try:
    from numba import njit
except ImportError as error:
    raise missing_extra("numba", "the bundled street needs it", extra="aeb") from error

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function, and keep the code for later processes if some folder can be written.

    A quotient is IEEE 754's: infinite where something is divided by 0.
    """
    try:
        return njit(error_model="numpy", cache=True)(function)
    except RuntimeError:  # neither this folder nor the user's own for such files
        return njit(error_model="numpy")(function)


def part(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function of the same module that kernels are made of; it is kept with them."""
    return njit(error_model="numpy")(function)


def inlined_part(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function of the same module into its callers.

    Called in an inner loop, it would count references to all its arrays.
    """
    return njit(error_model="numpy", inline="always")(function)
