"""What worker processes need, imported quietly and for one thread each.

The server that they are forked from imports this once, before the first of them.
"""

from __future__ import annotations

import gc
import os
from contextlib import suppress
from importlib import import_module

_MODULES = (
    "pybullet",
    "stable_baselines3",
    "vsr.networks.autoencoder",
    "vsr.networks.openvino_runtime",
    "env.driving.policy_files",
    "env.perception.description",
    "env.street.crossing",
)


def _import_all() -> None:
    os.environ["OMP_NUM_THREADS"] = "1"  # read by numpy's and torch's libraries; workers are many
    stderr = os.dup(2)
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)  # pybullet announces itself
    try:
        for name in _MODULES:
            with suppress(ImportError):  # whoever needs what is missing says so
                import_module(name)
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(null)


_import_all()
with suppress(ImportError):
    from tqdm import tqdm

    # Each worker would make a lock of its own, which it leaves behind if it is interrupted.
    tqdm.get_lock()
# What the garbage collector never visits it never writes to, so that processes go on sharing it.
gc.freeze()
