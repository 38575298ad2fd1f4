"""How soon PyReason is ready in a new process, and what that adds to its cache on disk."""

from __future__ import annotations

import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

# Both say how long PyReason took to be ready in its process, from the first line on.
_WITH_IDENTITY = """
import time
started = time.perf_counter()
import sfol
sfol.RewardFunction("aeb", engine="pyreason")(sfol.Facts(), v=1.0, v_next=1.0)
print(time.perf_counter() - started)
"""
_THE_ORDINARY_WAY = """
import time
started = time.perf_counter()
import numba
import sfol
from sfol.engines import pyreason_runtime as runtime
runtime._FUNCTIONS = tuple(numba.njit(cache=True)(f.py_func) for f in runtime._FUNCTIONS)
sfol.RewardFunction("aeb", engine="pyreason")(sfol.Facts(), v=1.0, v_next=1.0)
print(time.perf_counter() - started)
"""


def ready() -> dict[str, float]:
    """Return how soon PyReason is ready in a process that finds its cache.

    Returns:
        The median of three processes, in s, the size of the cache, and what they added to it.
    """
    cache = _package() / "cache"
    run_python(_WITH_IDENTITY)  # fills the cache, if this is the first time
    before = _size(cache)
    seconds = [float(run_python(_WITH_IDENTITY)) for _ in range(3)]
    return {
        "ready_in_a_new_process_s": round(statistics.median(seconds), 2),
        "cache_mb": round(before / 1e6, 1),
        "cache_growth_bytes": _size(cache) - before,
    }


def ready_compared() -> dict[str, float]:
    """Return how soon PyReason is ready without a cache, with one, and registered differently.

    It takes ten minutes: without a cache, PyReason compiles all that it has. That happens in a copy
    of PyReason in a temporary folder, so that the cache of the installed one is neither used nor
    changed.

    Returns:
        Times in s: `cold`, the first process of an installation; `warm`, a later one; `ordinary`, a
        later one whose annotation functions have no fixed identity. And what the last two add to
        the cache, in bytes.
    """
    with tempfile.TemporaryDirectory(prefix="pyreason-") as folder:
        copy = Path(folder, "pyreason")
        compiled = shutil.ignore_patterns("cache", "__pycache__")
        shutil.copytree(_package(), copy, ignore=compiled)
        cache, first = copy / "cache", {"PYTHONPATH": folder}
        cold = float(run_python(_WITH_IDENTITY, first))
        sizes = [_size(cache)]
        warm = float(run_python(_WITH_IDENTITY, first))
        sizes.append(_size(cache))
        ordinary = float(run_python(_THE_ORDINARY_WAY, first))
        sizes.append(_size(cache))
    return {
        "cold_s": round(cold, 2),
        "warm_s": round(warm, 2),
        "ordinary_s": round(ordinary, 2),
        "ordinary_over_warm": round(ordinary / warm, 1),
        "warm_cache_growth_bytes": sizes[1] - sizes[0],
        "ordinary_cache_growth_bytes": sizes[2] - sizes[1],
    }


def run_python(code: str, environment: dict[str, str] | None = None) -> str:
    """Run code in a new Python process and return what it prints.

    Args:
        code: the program.
        environment: variables that it gets besides those of this process.
    """
    command = [sys.executable, "-c", code]
    variables = {**os.environ, **(environment or {})}
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=variables)
    return done.stdout.splitlines()[-1] if done.stdout else ""


def _package() -> Path:
    spec = find_spec("pyreason")
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent


def _size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
