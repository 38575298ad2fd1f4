"""Trained policies as drivers, and the one place where a driver is made from its name."""

from __future__ import annotations

import hashlib
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from env.driving.drivers import DRIVERS, Driver
from env.perception.weights_folder import WHERE_FROM, weights_folder
from env.street.observation import ObservationKind, Observer, observer_of
from env.street.view import StreetView
from env.world.camera import DashCameraParameters
from sfol.errors import UsageError, did_you_mean, missing_extra
from sfol.reading import opened

_PROJECT = Path(__file__).resolve().parents[2]
TRAINED = "trained"
SUFFIX = ".safetensors"
_PICKLE = ".zip"
_KINDS: tuple[ObservationKind, ...] = ("image", "state")


def policy_file(driver: str) -> Path | None:
    """Return the file of a driver that is a policy, whether it exists or not; else None.

    Args:
        driver: its name, which is the file's path, or ``trained``: the policy beside the networks'
            weights.
    """
    if driver == TRAINED:
        return weights_folder() / f"policy{SUFFIX}"
    return Path(driver) if driver.endswith((SUFFIX, _PICKLE)) else None


def make_driver(name: str, *, trust: bool = False) -> Driver:
    """Return a driver.

    Args:
        name: of a scripted driver; ``trained``; or the path of a policy file: the ``.safetensors``
            that `aeb train` writes, or a ``.zip`` of stable-baselines3.
        trust: whether a ``.zip`` may lie outside the project's own folder.

    Raises:
        UsageError: there is no such driver, or the file can't be used or trusted.
        MissingExtraError: stable-baselines3 is not installed.
    """
    file = policy_file(name)
    if file is not None and file.suffix == SUFFIX:
        return TrainedDriver(file)
    if file is not None:
        return PickledPolicyDriver(file, trust=trust)
    if name not in DRIVERS:
        raise UsageError(
            f"there is no driver '{name}'",
            name=name,
            suggestion=did_you_mean(name, [*DRIVERS, TRAINED])
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


class PickledPolicyDriver:
    """Drives as a policy of stable-baselines3 says, without chance, by what it was trained on.

    Args:
        path: a policy file (``.zip``) that stable-baselines3's PPO has saved.
        trust: whether the file may lie outside the project's own folder. Loading one runs whatever
            code was put into it.

    Raises:
        UsageError: there is no such file, it is not trusted, it is no policy, or its spaces are
            not those of the street.
        MissingExtraError: stable-baselines3 is not installed.
    """

    def __init__(self, path: Path, *, trust: bool = False) -> None:
        _check_file(path, trust)
        self._policy = _load(path)
        self._observer = _observer_for(self._policy.observation_space, path)
        _check_actions(self._policy.action_space, path)

    def reset(self) -> None:
        """Do nothing: the policy has no memory."""

    def __call__(self, street: StreetView) -> float:
        """Return the policy's most likely action."""
        action, _ = self._policy.predict(self._observer(street), deterministic=True)
        return float(np.asarray(action).ravel()[0])


def check_exists(path: Path) -> None:
    """Refuse a policy file that is not there.

    Raises:
        UsageError: there is no such file.
    """
    if not path.is_file():
        missing = f"there is no policy file '{path}'"
        shipped = path == policy_file(TRAINED)
        raise UsageError(missing, name=str(path), suggestion=WHERE_FROM if shipped else None)


def _check_file(path: Path, trust: bool) -> None:
    check_exists(path)
    # A link that leads out of the project is outside.
    if not trust and not _in_project(path.resolve()):
        raise UsageError(
            f"'{path}' is not in the project's folder, and loading a policy file runs the code in "
            "it, since it is a pickle",
            name=str(path),
            suggestion="--trust, if you know where it comes from",
        )


def _in_project(path: Path) -> bool:
    # Installed elsewhere there is no checkout, and so no folder of the project's own.
    return (_PROJECT / "pyproject.toml").is_file() and path.is_relative_to(_PROJECT)


def _load(path: Path) -> Any:
    try:
        from stable_baselines3 import PPO  # noqa: PLC0415  (slow, and few need it)
    except ImportError:
        raise missing_extra(
            "stable-baselines3", "policies in .zip files need it", extra="aeb", python="3.11"
        ) from None
    try:
        return PPO.load(path, device="cpu").policy
    except Exception as error:  # unpickling can raise anything
        raise UsageError(
            f"'{path}' is no policy of stable-baselines3's PPO: {error}", name=str(path)
        ) from None


def _observer_for(space: spaces.Space[Any], path: Path) -> Observer:
    side = DashCameraParameters().size
    observers = {kind: observer_of(kind, side) for kind in _KINDS}
    for observer in observers.values():
        if space in (observer.space, _channels_first(observer.space)):
            return observer
    known = "; ".join(f"{kind}: {observer.space}" for kind, observer in observers.items())
    raise UsageError(
        f"'{path}' was trained on observations {space}, which the street does not give",
        name=str(path),
        suggestion=f"known are {known}; what aeb train writes, .safetensors, drives by more",
    )


def _channels_first(space: spaces.Space[Any]) -> spaces.Space[Any]:
    """Return an image space as stable-baselines3 turns it for its networks."""
    if space.shape is None or len(space.shape) != 3:
        return space
    return spaces.Box(0, 255, (space.shape[2], *space.shape[:2]), np.uint8)


def _check_actions(space: spaces.Space[Any], path: Path) -> None:
    if not isinstance(space, spaces.Box) or space.shape != (1,):
        raise UsageError(
            f"'{path}' chooses actions {space}, but a pedal is one number in [-1, 1]",
            name=str(path),
        )
