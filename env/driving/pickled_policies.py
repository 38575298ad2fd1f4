"""Policies of stable-baselines3 and sb3-contrib as drivers: pickles, which need trust."""

from __future__ import annotations

import importlib
import json
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from env.street.observation import ObservationKind, Observer, observer_of
from env.street.view import StreetView
from env.world.camera import DashCameraParameters
from sfol.errors import UsageError, missing_extra
from sfol.reading import opened

_PROJECT = Path(__file__).resolve().parents[2]
_KINDS: tuple[ObservationKind, ...] = ("image", "state")
_MOST = 10_000_000  # bytes that a model says of itself
# Beside a policy, in this order: what VecNormalize has saved of what its training saw.
_STATISTICS = ("{stem}.pkl", "{stem}_vecnormalize.pkl", "vecnormalize.pkl")


class _Algorithm(NamedTuple):
    package: str
    name: str


# Algorithms that can read a model, by where its policy's class is from.
_ALGORITHMS = {
    "stable_baselines3.common": _Algorithm("stable_baselines3", "PPO"),
    "stable_baselines3.sac": _Algorithm("stable_baselines3", "SAC"),
    "stable_baselines3.td3": _Algorithm("stable_baselines3", "TD3"),
    "sb3_contrib.tqc": _Algorithm("sb3_contrib", "TQC"),
    "sb3_contrib.common.recurrent": _Algorithm("sb3_contrib", "RecurrentPPO"),
}


class PickledPolicyDriver:
    """Drives as a policy of stable-baselines3 says, without chance, by what it was trained on.

    A policy that was trained on observations normalised by ``VecNormalize`` needs its file: beside
    ``name.zip``, ``name.pkl``, ``name_vecnormalize.pkl`` or ``vecnormalize.pkl``. Actions last for
    one control step.

    Args:
        path: a file (``.zip``) that PPO, A2C, SAC, TD3 or DDPG has saved, or TQC or RecurrentPPO of
            sb3-contrib.
        trust: whether the files may lie outside the project's own folder. Loading one runs whatever
            code was put into it.

    Raises:
        UsageError: it is not trusted, it is no policy, its spaces are not those of the street, or
            it was trained on normalised observations and comes without what they were normalised
            by.
        MissingExtraError: a package is not installed that the policy needs.
    """

    def __init__(self, path: Path, *, trust: bool = False) -> None:
        _check_trust(path, trust)
        model = _load(path)
        self._policy = model.policy
        self._observer = _observer_for(self._policy.observation_space, path)
        _check_actions(self._policy.action_space, path)
        self._normaliser = _normaliser_of(model, path, trust)
        self.reset()

    def reset(self) -> None:
        """Forget the episode before, where the policy remembers it."""
        self._memory: tuple[npt.NDArray[Any], ...] | None = None

    def __call__(self, street: StreetView) -> float:
        """Return the policy's most likely action."""
        observation: Any = self._observer(street)
        if self._normaliser is not None:
            observation = self._normaliser.normalize_obs(observation)
        action, self._memory = self._policy.predict(
            observation,
            state=self._memory,
            episode_start=np.array([self._memory is None]),
            deterministic=True,
        )
        return float(np.clip(np.asarray(action).ravel()[0], -1.0, 1.0))


def _check_trust(path: Path, trust: bool) -> None:
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
    algorithm = _algorithm_of(path)
    try:
        package = importlib.import_module(algorithm.package)
    except ImportError:
        raise missing_extra(
            algorithm.package.replace("_", "-"),
            f"'{path}' is a policy of its {algorithm.name}",
            extra="aeb",
            python="3.11",
        ) from None
    try:
        return getattr(package, algorithm.name).load(path, device="cpu")
    except Exception as error:  # unpickling can raise anything
        raise UsageError(
            f"'{path}' is no policy of stable-baselines3: {error}", name=str(path)
        ) from None


def _algorithm_of(path: Path) -> _Algorithm:
    """Return what can read a model, by what the file says of itself; nothing is unpickled."""
    try:
        with opened(path) as file, zipfile.ZipFile(file) as archive, archive.open("data") as data:
            module = json.loads(data.read(_MOST))["policy_class"]["__module__"]
    except (zipfile.BadZipFile, KeyError, TypeError, ValueError, OSError) as error:
        raise UsageError(
            f"'{path}' is no policy of stable-baselines3: {error}", name=str(path)
        ) from None
    for place, algorithm in _ALGORITHMS.items():
        if str(module).startswith(place):
            return algorithm
    return _ALGORITHMS["stable_baselines3.common"]  # a class of somebody's own


def _normaliser_of(model: Any, path: Path, trust: bool) -> Any:
    """Return what normalises a model's observations; None if nothing does.

    Raises:
        UsageError: it is missing, not trusted or of another model.
    """
    names = [name.format(stem=path.stem) for name in _STATISTICS]
    file = next((path.with_name(name) for name in names if path.with_name(name).is_file()), None)
    # What a model keeps of the last observation before it was normalised tells that it was.
    if file is None and model._last_original_obs is not None:
        raise UsageError(
            f"'{path}' was trained on observations that VecNormalize had normalised, and what "
            "they were normalised by is missing",
            name=str(path),
            suggestion=f"VecNormalize's save() to one of {', '.join(names)} beside it",
        )
    if file is None:
        return None
    _check_trust(file, trust)
    return _read_normaliser(file, model.policy)


def _read_normaliser(file: Path, policy: Any) -> Any:
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize  # noqa: PLC0415

    nowhere = DummyVecEnv([lambda: _Nowhere(policy.observation_space, policy.action_space)])
    try:
        normaliser = VecNormalize.load(str(file), nowhere)
    except Exception as error:  # unpickling can raise anything
        raise UsageError(
            f"'{file}' holds nothing that VecNormalize has saved for such observations: {error}",
            name=str(file),
        ) from None
    normaliser.training = False
    return normaliser


class _Nowhere(gymnasium.Env[Any, Any]):
    """An environment that has spaces and nothing else: VecNormalize is not read without one."""

    def __init__(self, observations: spaces.Space[Any], actions: spaces.Space[Any]) -> None:
        self.observation_space, self.action_space = observations, actions


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
