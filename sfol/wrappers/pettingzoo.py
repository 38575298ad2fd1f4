"""A wrapper of parallel environments of PettingZoo: every agent rewarded by rules."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from sfol.errors import expect, missing_extra
from sfol.facts import Facts
from sfol.reward import RewardFunction
from sfol.wrappers.judging import Judge, Transition
from sfol.wrappers.modes import EPISODE, EpisodeSums, checked_shaping
from sfol.wrappers.silence import Silence

try:
    from pettingzoo import ParallelEnv
    from pettingzoo.utils import BaseParallelWrapper
except ImportError as error:
    raise missing_extra(
        "pettingzoo", "the wrapper of its environments needs it", extra="pettingzoo"
    ) from error

_Agents = dict[str, Any]


class ParallelRuleReward(BaseParallelWrapper):
    """Rewards the agents of a parallel environment by a knowledge base.

    What `RuleReward` is for one agent, this is for several. Facts and signals of an agent are read
    off what it observes itself, as the knowledge base says; its subject is the agent then, whatever
    the environment calls it. Where a function makes facts instead, they are those of all agents at
    once, and each agent is the subject by its own name, such as ``agent_0``.

    An agent that joins an episode gets 0 from the rules for the step in which it appears. ``info``
    of each agent gets what that of `RuleReward` gets.

    Args:
        env: a parallel environment.
        reward: the reward function; agents share its coefficients and parameters.
        facts: makes facts of (observations by agent, infos by agent, env); called at reset and
            after each step. None reads each agent's off its observation.
        signals: makes signals of (agent, its transition), by name; the others are read off it.
        mode: ``replace``, ``add`` or ``potential``, as for `RuleReward`.
        potential: in mode ``potential``, a weight that is φ; None for R.
        discount: in mode ``potential``, γ, that of the agents.

    Raises:
        UsageError: an argument is of another type or does not belong to the mode, the knowledge
            base does not say how something is read and there is no function that makes it, or an
            agent has a name that is no constant.
    """

    def __init__(  # noqa: PLR0913 (six have defaults and are given by name)
        self,
        env: ParallelEnv,
        reward: RewardFunction,
        *,
        facts: Callable[[Mapping[str, Any], Mapping[str, Any], ParallelEnv], Facts] | None = None,
        signals: Callable[[str, Transition[Any, Any]], Mapping[str, float]] | None = None,
        mode: str = "replace",
        potential: str | None = None,
        discount: float | None = None,
    ) -> None:
        expect(env, ParallelEnv, "the environment", "give a pettingzoo.ParallelEnv")
        shaping = checked_shaping(reward, facts, signals, mode, potential, discount)
        super().__init__(env)
        self._reward = reward
        self._facts_of = facts
        self._signals_of = signals
        self._mode = mode
        self._silence = Silence(reward)
        self._shaping = shaping
        self._judges: dict[str, Judge[Any, Any]] = {}
        self._sums: dict[str, EpisodeSums] = {}  # of those who take part
        for agent in getattr(env, "possible_agents", ()):
            self._judge(agent)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[_Agents, _Agents]:
        """Start an episode; see `pettingzoo.ParallelEnv.reset`."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self._sums = {}
        self._make_facts(observations, infos)
        for agent in self.env.agents:
            self._begin(agent, observations, infos)
        return observations, infos

    def step(self, actions: _Agents) -> tuple[_Agents, _Agents, _Agents, _Agents, _Agents]:
        """Take a step and reward each agent; see `pettingzoo.ParallelEnv.step`."""
        observations, native, terminated, truncated, infos = self.env.step(actions)
        rewards, infos = dict(native), dict(infos)
        self._make_facts(observations, infos)
        for agent, original in native.items():
            if agent not in self._sums:
                self._begin(agent, observations, infos)
                rewards[agent] = 0.0 if self._mode == "replace" else original
                infos[agent] = {**infos[agent], "original_reward": original}
                continue
            transition = Transition(
                self._judge(agent).observation,
                actions.get(agent),
                observations[agent],
                original,
                terminated[agent],
                truncated[agent],
                infos[agent],
            )
            rewards[agent], infos[agent] = self._rewarded(agent, transition)
        for agent in self._sums.keys() - {*self.env.agents}:
            del self._sums[agent]
        return observations, rewards, terminated, truncated, infos

    def _rewarded(
        self, agent: str, transition: Transition[Any, Any]
    ) -> tuple[float, dict[str, Any]]:
        """Return what a step of an agent is worth, and its info."""
        given, original = self._judge(agent).step(transition), transition.native
        value = given.value if self._mode == "replace" else float(original) + given.value
        self._sums[agent].add(value, float(original), given.terms)
        self._silence.hear(given.items)
        info = {**transition.info, **given.items, "original_reward": original}
        if transition.terminated or transition.truncated:
            info[EPISODE] = self._sums[agent].items()
            self._silence.end(lambda: self._judge(agent).facts)
        return value, info

    def _begin(self, agent: str, observations: _Agents, infos: _Agents) -> None:
        self._judge(agent).begin(observations[agent], infos[agent])
        self._sums[agent] = EpisodeSums()

    def _make_facts(self, observations: _Agents, infos: _Agents) -> None:
        """Make the facts of all agents, if a function does."""
        if self._facts_of is not None:
            self._facts = self._facts_of(observations, infos, self.env)

    def _judge(self, agent: str) -> Judge[Any, Any]:
        """Return who judges the steps of an agent; made at its first episode."""
        if agent not in self._judges:
            shared, of_agent = self._facts_of is not None, self._signals_of
            self._judges[agent] = Judge(
                self._reward.for_subject(agent) if shared else self._reward,
                facts=(lambda _observation, _info: self._facts) if shared else None,
                signals=None if of_agent is None else partial(of_agent, agent),
                shaping=self._shaping,
            )
        return self._judges[agent]
