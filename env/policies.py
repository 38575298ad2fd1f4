"""Trained policies as drivers, and the one place where a driver is made from its name."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces

from env.camera import DashCameraParameters
from env.crossing import OccludedCrossing
from env.drivers import DRIVERS, Driver
from env.observation import ObservationKind, Observer, observer_of
from sfol.errors import MissingExtraError, UsageError, did_you_mean

_PROJECT = Path(__file__).resolve().parents[1]
_SUFFIX = ".zip"
_KINDS: tuple[ObservationKind, ...] = ("image", "state")


def is_policy(name: str) -> bool:
    """Tell whether a driver's name is that of a policy file."""
    return name.endswith(_SUFFIX)


def make_driver(name: str, *, trust: bool = False) -> Driver:
    """Return a driver.

    Args:
        name: of a scripted driver, or the path of a policy file (``.zip``) of stable-baselines3.
        trust: whether a policy file may lie outside the project's own folder.

    Raises:
        UsageError: there is no such driver, or the file can't be used or trusted.
        MissingExtraError: stable-baselines3 is not installed.
    """
    if is_policy(name):
        return PolicyDriver(Path(name), trust=trust)
    if name not in DRIVERS:
        raise UsageError(
            f"there is no driver '{name}'",
            name=name,
            suggestion=did_you_mean(name, DRIVERS) or "a policy file ends in .zip",
        )
    return DRIVERS[name]()


def file_hash(path: Path) -> str:
    """Return the first 12 hexadecimal digits of a file's SHA-256."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:12]


class PolicyDriver:
    """Drives as a trained policy says, without chance. Sees what the policy was trained on.

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

    def __call__(self, street: OccludedCrossing) -> float:
        """Return the policy's most likely action."""
        action, _ = self._policy.predict(self._observer(street), deterministic=True)
        return float(np.asarray(action).ravel()[0])


def _check_file(path: Path, trust: bool) -> None:
    if not path.is_file():
        raise UsageError(f"there is no policy file '{path}'", name=str(path))
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
        raise MissingExtraError(
            "policy files need stable-baselines3, which is not installed",
            name="aeb",
            suggestion="pip install 'sfol[aeb]'",
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
        suggestion=f"known are {known}",
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
