"""Trained policies as drivers, and the one place where a driver is made from its name."""

from __future__ import annotations

import hashlib
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from env.driving.drivers import DRIVERS, Driver
from env.driving.pickled_policies import PickledPolicyDriver
from env.perception.weights_folder import WHERE_FROM, weights_folder
from env.street.view import StreetView
from sfol.errors import UsageError, did_you_mean
from sfol.reading import opened

SUFFIX = ".safetensors"
TRAINED = "trained"
# The policies beside the networks' weights: the main setup's, and one that goes beyond the paper.
SHIPPED = {TRAINED: f"policy{SUFFIX}", "beyond": f"beyond{SUFFIX}"}
_PICKLE = ".zip"


def policy_file(driver: str) -> Path | None:
    """Return the file of a driver that is a policy, whether it exists or not; else None.

    Args:
        driver: its name, which is the file's path, or ``trained`` or ``beyond``: the policies
            beside the networks' weights.
    """
    if driver in SHIPPED:
        return weights_folder() / SHIPPED[driver]
    return Path(driver) if driver.endswith((SUFFIX, _PICKLE)) else None


def make_driver(name: str, *, trust: bool = False) -> Driver:
    """Return a driver.

    Args:
        name: of a scripted driver; ``trained`` or ``beyond``; or the path of a policy file: the
            ``.safetensors`` that `aeb train` writes, or a ``.zip`` of stable-baselines3 or
            sb3-contrib.
        trust: whether a ``.zip`` may lie outside the project's own folder.

    Raises:
        UsageError: there is no such driver, or the file can't be used or trusted.
        MissingExtraError: a package is not installed that the policy needs.
    """
    file = policy_file(name)
    if file is not None and file.suffix == SUFFIX:
        return TrainedDriver(file)
    if file is not None:
        check_exists(file)
        return PickledPolicyDriver(file, trust=trust)
    if name not in DRIVERS:
        raise UsageError(
            f"there is no driver '{name}'",
            name=name,
            suggestion=did_you_mean(name, [*DRIVERS, *SHIPPED])
            or "a policy file ends in .safetensors or .zip",
        )
    return DRIVERS[name]()


def file_hash(path: Path) -> str:
    """Return the first 12 hexadecimal digits of a file's SHA-256.

    Raises:
        FileError: the file can't be read.
    """
    with opened(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:12]


class TrainedDriver:
    """Drives as a policy that `aeb train` wrote says, without chance, by what it was trained on.

    Args:
        path: of the policy (``.safetensors``), with its card beside it.

    Raises:
        UsageError: there is no such file, or it is no policy.
        MissingExtraError: torch is not installed.
    """

    def __init__(self, path: Path) -> None:
        from env.driving.policy_files import PolicyFile  # noqa: PLC0415  (torch is slow to import)

        check_exists(path)
        file = PolicyFile(path)
        self._observer, self._network = file.load()
        interface = file.card().interface
        self._last: deque[Any] = deque(maxlen=interface.frames)
        self._decision_steps = interface.decision_steps
        self.reset()

    def reset(self) -> None:
        """Forget what was observed."""
        self._last.clear()
        self._pedal, self._held = 0.0, 0

    def __call__(self, street: StreetView) -> float:
        """Return the policy's most likely action, or the last one while that is held."""
        from env.driving.policy_files import act  # noqa: PLC0415

        if self._held == 0:
            self._pedal = act(self._network, self.observe(street))
        self._held = (self._held + 1) % self._decision_steps
        return self._pedal

    def observe(self, street: StreetView) -> npt.NDArray[np.float32]:
        """Return what the policy is given now, float32 (N,)."""
        observation = np.asarray(self._observer(street))
        # Before the first observation there were zeros, as in stable-baselines3's VecFrameStack.
        while len(self._last) + 1 < (self._last.maxlen or 1):
            self._last.append(np.zeros_like(observation))
        self._last.append(observation)
        return np.concatenate(self._last)


def check_exists(path: Path) -> None:
    """Refuse a policy file that is not there.

    Raises:
        UsageError: there is no such file.
    """
    if not path.is_file():
        missing = f"there is no policy file '{path}'"
        shipped = path in map(policy_file, SHIPPED)
        raise UsageError(missing, name=str(path), suggestion=WHERE_FROM if shipped else None)
