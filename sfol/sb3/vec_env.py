"""A wrapper of stable-baselines3's vectorised environments."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import repeat
from typing import Any, NamedTuple, Protocol

import numpy as np
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from sfol.errors import UsageError, expect
from sfol.facts import Facts
from sfol.knowledge_base import ScheduledNumber
from sfol.observations.plans import Observation
from sfol.recorded_steps import Reals
from sfol.reward import RewardFunction
from sfol.wrappers.goals import refuse_hindsight
from sfol.wrappers.judging import Judge, Transition
from sfol.wrappers.judging_many import ManyJudge, Mask
from sfol.wrappers.modes import (
    EPISODE,
    FIRED,
    ManyEpisodeSums,
    Shaping,
    checked_shaping,
    term_names,
)
from sfol.wrappers.nested import replaced, row
from sfol.wrappers.silence import Silence

_FactsOf = Callable[[Observation, Mapping[str, Any]], Facts]
_SignalsOf = Callable[[Transition[Any, Any]], Mapping[str, float]]
_Infos = Sequence[dict[str, Any]]


class VecRuleReward(VecEnvWrapper):
    """Rewards the steps of stable-baselines3's environments by a knowledge base.

    What `sfol.wrappers.RuleReward` is for one environment, this is for B of them, with the same
    numbers and the same keys in ``infos``. Facts and signals are read off the observations, and one
    evaluation rewards all environments; with a function that makes facts or signals, or rules over
    time, each is evaluated on its own. A last step leads to what ``terminal_observation`` has, and
    is truncated if ``TimeLimit.truncated`` says so.

    Args:
        venv: vectorised environments.
        reward: the reward function.
        facts: makes facts of an environment's (observation, info); called at reset and after each
            step. None reads them off the observation.
        signals: makes signals of an environment's transition, by name; the others are read off it.
        mode: ``replace``, ``add`` or ``potential``, as for `RuleReward`.
        potential: in mode ``potential``, a weight that is φ; None for the reward.
        discount: in mode ``potential``, γ, that of the agent.

    Raises:
        UsageError: an argument is of another type or does not belong to the mode, or the knowledge
            base does not say how something is read and there is no function that makes it.
    """

    def __init__(  # noqa: PLR0913 (five have defaults and are given by name)
        self,
        venv: VecEnv,
        reward: RewardFunction,
        *,
        facts: _FactsOf | None = None,
        signals: _SignalsOf | None = None,
        mode: str = "replace",
        potential: str | None = None,
        discount: float | None = None,
    ) -> None:
        expect(venv, VecEnv, "the environments", "give a VecEnv of stable-baselines3")
        shaping = checked_shaping(
            reward, facts, signals, mode, potential, discount, of="(observation, info)"
        )
        super().__init__(venv)
        self._reward = reward
        self._mode = mode
        self._silence = Silence(reward)
        self._terms = term_names(reward, shaping)
        together = facts is None and signals is None and not reward.kb.has_memory
        self._panel: _Panel = (
            _Together(reward, shaping)
            if together
            else _OneByOne(venv.num_envs, reward, facts, signals, shaping)
        )

    def reset(self) -> Any:
        """Start an episode in each environment; see `VecEnv.reset`."""
        observations = self.venv.reset()
        self._panel.begin(observations, self.venv.unwrapped.reset_infos)
        self._sums = ManyEpisodeSums(self._terms, self.num_envs)
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Take a step in each environment; see `VecEnv.step_async`."""
        self._actions = actions
        self.venv.step_async(actions)

    def step_wait(self) -> tuple[Any, Reals, Mask, list[dict[str, Any]]]:
        """Return what came of the step, with the rules' rewards; see `VecEnv.step_wait`."""
        observations, native, dones, infos = self.venv.step_wait()
        ended = np.flatnonzero(dones).tolist()
        step = _Step(
            self._actions, _landed(observations, ended, infos), native, _truncated(ended, infos),
            dones, infos,
        )  # fmt: skip
        ruled, terms, items = self._panel.step(step)
        rewards = ruled if self._mode == "replace" else native + ruled
        self._sums.add(rewards, native, terms)
        infos = [info.copy() for info in infos]
        for info, own in zip(infos, items, strict=True):
            info.update(own)
        if self._silence.lasts:
            for info in infos:
                self._silence.hear(info)
        for index in ended:
            infos[index][EPISODE] = self._sums.items_of(index)
        if ended:
            self._sums.restart(dones)
            self._silence.end()
        self._panel.go_on(observations, step, self.venv.unwrapped.reset_infos)
        return observations, rewards, dones, infos

    def env_method(self, method_name: str, *arguments: Any, **options: Any) -> list[Any]:
        """Call a method of the environments; see `VecEnv.env_method`.

        Raises:
            UsageError: hindsight asks for the rewards of other goals, which the environments would
                answer with their own.
        """
        refuse_hindsight(method_name)
        return super().env_method(method_name, *arguments, **options)

    @property
    def schedules(self) -> Mapping[str, ScheduledNumber]:
        """The numbers of the knowledge base that change while an agent is trained."""
        return self._reward.kb.schedules

    def apply_schedules(self, *, steps: int, episodes: int) -> dict[str, float]:
        """Set the scheduled numbers of the reward; see `RewardFunction.apply_schedules`."""
        return self._reward.apply_schedules(steps=steps, episodes=episodes)

    def report_fired(self, *, whether: bool = True) -> None:
        """Say whether infos get ``sfol.fired``: rule → whether it concluded something."""
        self._panel.report_fired(whether)


class _Step(NamedTuple):
    """What came of a step of B environments.

    Attributes:
        actions: what was done.
        landed: the observations after it, before any environment began anew.
        native: (B,), the environments' own rewards.
        truncated: (B,), whether an episode was truncated.
        dones: (B,), whether an episode has ended, in whichever way.
        infos: what each environment says of it.
    """

    actions: Any
    landed: Any
    native: Reals
    truncated: Mask
    dones: Mask
    infos: _Infos

    @property
    def terminated(self) -> Mask:
        """(B,), whether the step terminated an episode."""
        return self.dones & ~self.truncated


_Items = Iterable[tuple[str, Any]]
_Ruled = tuple[Reals, Mapping[str, Reals], Iterable[_Items]]


class _Panel(Protocol):
    """Who judges the steps of B environments."""

    def begin(self, observations: Any, infos: _Infos) -> None:
        """Begin with some states."""
        ...

    def step(self, step: _Step) -> _Ruled:
        """Return what the rules give, its summands and the items of each environment's info."""
        ...

    def go_on(self, observations: Any, step: _Step, reset_infos: _Infos) -> None:
        """Go on from the states that are observed now."""
        ...

    def report_fired(self, whether: bool, /) -> None:
        """Say whether the items tell which rules fired."""
        ...


class _Together:
    """One evaluation for all environments."""

    def __init__(self, reward: RewardFunction, shaping: Shaping | None) -> None:
        self._judge = ManyJudge(reward, shaping)

    def begin(self, observations: Any, _: _Infos) -> None:
        self._judge.begin(observations)

    def step(self, step: _Step) -> _Ruled:
        everybody = np.ones(len(step.dones), dtype=np.bool_)
        given = self._judge.step(
            step.actions, step.landed, step.native, step.terminated, step.truncated, everybody
        )
        items = _by_environment({**given.items, "original_reward": step.native})
        if given.fired is not None:
            fired = map(dict, _by_environment(given.fired))
            items = ([*own, (FIRED, of_rules)] for own, of_rules in zip(items, fired, strict=True))
        return given.values, given.terms, items

    def go_on(self, observations: Any, step: _Step, _: _Infos) -> None:
        self._judge.go_on(observations, step.landed)

    def report_fired(self, whether: bool, /) -> None:
        self._judge.reports_fired = whether


class _OneByOne:
    """A judge for each environment, for functions of one."""

    def __init__(
        self,
        count: int,
        reward: RewardFunction,
        facts: _FactsOf | None,
        signals: _SignalsOf | None,
        shaping: Shaping | None,
    ) -> None:
        self._judges: list[Judge[Any, Any]] = [
            Judge(reward, facts=facts, signals=signals, shaping=shaping) for _ in range(count)
        ]

    def begin(self, observations: Any, infos: _Infos) -> None:
        for i, (judge, info) in enumerate(zip(self._judges, infos, strict=True)):
            judge.begin(row(observations, i), info)

    def step(self, step: _Step) -> _Ruled:
        given = [judge.step(_transition(judge, step, i)) for i, judge in enumerate(self._judges)]
        terms = {name: np.array([g.terms[name] for g in given]) for name in given[0].terms}
        items = [
            {**g.items, "original_reward": native}.items()
            for g, native in zip(given, step.native.tolist(), strict=True)
        ]
        return np.array([g.value for g in given]), terms, items

    def go_on(self, observations: Any, step: _Step, reset_infos: _Infos) -> None:
        for i in np.flatnonzero(step.dones).tolist():
            self._judges[i].begin(row(observations, i), reset_infos[i])

    def report_fired(self, whether: bool, /) -> None:
        for judge in self._judges:
            judge.reports_fired = whether


def _transition(judge: Judge[Any, Any], step: _Step, index: int) -> Transition[Any, Any]:
    return Transition(
        judge.observation,
        row(step.actions, index),
        row(step.landed, index),
        step.native[index].item(),
        bool(step.terminated[index]),
        bool(step.truncated[index]),
        step.infos[index],
    )


def _by_environment(columns: Mapping[str, Any]) -> Iterable[_Items]:
    """Return arrays (B,) by name as B times pairs of name and number."""
    lists = [np.asarray(values).tolist() for values in columns.values()]
    return map(zip, repeat((*columns,)), zip(*lists, strict=True))


def _landed(observations: Any, ended: Sequence[int], infos: _Infos) -> Any:
    """Return what was observed after each step, before an environment began anew."""
    if not ended:
        return observations
    if any("terminal_observation" not in infos[index] for index in ended):
        raise UsageError(
            "the environments begin anew and give no terminal_observation",
            name="terminal_observation",
            suggestion="their infos must have the last observations of episodes",
        )
    return replaced(observations, {i: infos[i]["terminal_observation"] for i in ended})


def _truncated(ended: Sequence[int], infos: _Infos) -> Mask:
    truncated = np.zeros(len(infos), dtype=np.bool_)
    for index in ended:
        truncated[index] = infos[index].get("TimeLimit.truncated", False)
    return truncated
