"""Goals that are replaced after the fact: what a step would have been worth with another one.

Source: Andrychowicz et al., Hindsight experience replay, NeurIPS 2017.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import numpy.typing as npt

from sfol import arrays
from sfol.errors import UsageError
from sfol.knowledge_base import KnowledgeBase
from sfol.knowledge_base.observing import NEXT
from sfol.observations.plans import Observation, parts_of, plans_of
from sfol.reward import RewardFunction
from sfol.wrappers.judging import Transition
from sfol.wrappers.modes import Shaping, total

ACHIEVED, DESIRED = "achieved_goal", "desired_goal"
TRANSITION = "sfol.transition"  # the key in `info` of a step whose reward goals alone do not say


_Reals = npt.NDArray[np.float64]


class _Step(NamedTuple):
    """What is recorded of a step, or of B steps."""

    observation: Any
    action: Any
    next_observation: Any
    terminated: Any
    truncated: Any


def has_goals(space: gymnasium.Space[Any]) -> bool:
    """Tell whether observations have an achieved and a desired goal."""
    return isinstance(space, gymnasium.spaces.Dict) and {ACHIEVED, DESIRED} <= space.keys()


def refuse_hindsight(method: str) -> None:
    """Refuse to let environments that know nothing of the rules answer what hindsight asks.

    Args:
        method: of the environments, that is to be called.

    Raises:
        UsageError: it is the one for the rewards of other goals.
    """
    if method == "compute_reward":
        raise UsageError(
            "hindsight is paid by each environment, and these know nothing of the rules",
            name=method,
            suggestion="wrap each environment in sfol.wrappers.RuleReward instead",
        )


class Hindsight:
    """Rewards steps by rules with another desired goal than the one that they were taken for.

    A step then has the goal in both of its observations; all else is as it was recorded, but for
    the environment's own reward, which is that for the other goal.

    Args:
        space: of observations, with goals.
        native: the environment's own ``compute_reward``; asked only if something needs it.
        reward: the reward function.
        mode: ``replace``, ``add`` or ``potential``.
        shaping: how the environment's own reward is shaped, if it is.
    """

    def __init__(
        self,
        space: gymnasium.Space[Any],
        native: Callable[[Any, Any, Any], Any],
        reward: RewardFunction,
        mode: str,
        shaping: Shaping | None,
    ) -> None:
        assert isinstance(space, gymnasium.spaces.Dict), "it has goals"
        self._rank = len(space[ACHIEVED].shape or ())
        self._native = native
        self._reward = reward
        self._mode = mode
        self._shaping = shaping
        self._read = _read_beside_goals(reward.kb) if shaping is None else "the state before a step"
        reads_native = any(
            r.whole == "native"
            for plan in plans_of(reward.kb).signals.values()
            for r in plan.readings
        )
        self._needs_native = reads_native or mode != "replace"

    @property
    def needs_transition(self) -> bool:
        """Whether a reward takes more than the goals, so that steps must be recorded in `info`."""
        return self._read is not None

    def rewards(self, achieved: Any, desired: Any, info: Any) -> float | _Reals:
        """Return the reward of a step, or of B steps; see `RuleReward.compute_reward`."""
        many = np.ndim(achieved) > self._rank
        if many and not len(achieved):
            return np.zeros(0)
        step = self._step(achieved, desired, info, many=many)
        native = None
        if self._needs_native:
            native = np.asarray(self._native(achieved, desired, info), dtype=np.float64)
        if self._shaping is None:
            ruled = self._ruled(step, native, many=many)
        else:
            ruled = self._shaped(step, self._shaping, many=many)
        value = ruled if self._mode == "replace" else native + ruled
        return arrays.plain(value) if many else float(value)

    def _step(self, achieved: Any, desired: Any, info: Any, *, many: bool) -> _Step:
        """Return a step, or B steps, with the goals that are asked for."""
        goals = {ACHIEVED: achieved, DESIRED: desired}
        if self._read is None:
            return _Step({DESIRED: desired}, None, goals, None, None)
        recorded = [self._recorded(each) for each in (info if many else [info])]
        found = _Step(*map(_stacked if many else _first, zip(*recorded, strict=True)))
        return found._replace(
            observation={**found.observation, DESIRED: desired},
            next_observation={**found.next_observation, **goals},
        )

    def _recorded(self, info: Mapping[str, Any]) -> _Step:
        if TRANSITION not in info:
            raise UsageError(
                f"the reward reads {self._read}, which goals do not say, and info has no "
                f"'{TRANSITION}'",
                name=TRANSITION,
                suggestion="keep the info of each step: HerReplayBuffer(copy_info_dict=True); or "
                "let facts and signals read the goals of the next observation alone",
            )
        step: Transition[Any, Any] = info[TRANSITION]
        return _Step(*(getattr(step, name) for name in _Step._fields))

    def _ruled(self, step: _Step, native: Any, *, many: bool) -> Any:
        evaluate = self._reward.transitions if many else self._reward.transition
        before, action, after, *ended = step
        return evaluate(before, action, after, native, *ended).reward

    def _shaped(self, step: _Step, shaping: Shaping, *, many: bool) -> Any:
        states = (step.observation, step.next_observation)
        before, after = (
            shaping.potentials(self._reward, state if many else _stacked([state]))
            for state in states
        )
        ruled = total(shaping.terms(before, after, np.asarray(step.terminated, np.float64)))
        return ruled if many else ruled[0]


def _read_beside_goals(kb: KnowledgeBase) -> str | None:
    """Return something that is read of a step and that its goals do not say, or None."""
    sources, facts, signals = plans_of(kb)
    known = {"": {DESIRED}, NEXT: {ACHIEVED, DESIRED}}
    facts_of = NEXT if kb.facts_at == "next" else ""
    read = [(facts_of, part[1]) for _, plan in facts for part in parts_of(plan)]
    read += [part[:2] for plan in signals.values() for part in parts_of(plan)]
    for whole, part in read:
        paths = [sources[part].path, sources[part].mask or sources[part].path]
        if whole != "native" and any(str(*path[:1]) not in known.get(whole, ()) for path in paths):
            return f"'{'.'.join(filter(None, [whole, part if whole != part else '']))}'"
    return None


def _stacked(parts: Sequence[Observation]) -> Any:
    """Return B observations, nested in any way, as one with an axis B before all others."""
    first = parts[0]
    if first is None:
        return None
    if isinstance(first, Mapping):
        return {key: _stacked([part[key] for part in parts]) for key in first}
    if isinstance(first, tuple):
        return tuple(map(_stacked, zip(*parts, strict=True)))
    return np.stack([np.asarray(part) for part in parts])


def _first(parts: Sequence[Observation]) -> Observation:
    return parts[0]
