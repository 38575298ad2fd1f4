"""A wrapper of parallel environments of PettingZoo: every agent rewarded by rules."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from sfol.errors import expect, missing_extra
from sfol.facts import Facts
from sfol.reward import RewardFunction
from sfol.wrappers.episodes import Rewarding, RuledEpisode, Transition

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
        self._rewarding = Rewarding.checked(reward, facts, signals, mode, potential, discount)
        super().__init__(env)
        self._facts_of = facts
        self._episodes: dict[str, RuledEpisode[Any, Any]] = {}
        self._of_agents: dict[str, Rewarding] = {}
        for agent in getattr(env, "possible_agents", ()):
            self._of(agent)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[_Agents, _Agents]:
        """Start an episode; see `pettingzoo.ParallelEnv.reset`."""
        observations, infos = self.env.reset(seed=seed, options=options)
        facts_of = self._facts(observations, infos)
        self._episodes = {
            agent: self._started(agent, observations[agent], facts_of) for agent in self.env.agents
        }
        return observations, infos

    def step(self, actions: _Agents) -> tuple[_Agents, _Agents, _Agents, _Agents, _Agents]:
        """Take a step and reward each agent; see `pettingzoo.ParallelEnv.step`."""
        observations, native, terminated, truncated, infos = self.env.step(actions)
        facts_of = self._facts(observations, infos)
        rewards, infos = dict(native), dict(infos)
        for agent, original in native.items():
            episode = self._episodes.get(agent)
            if episode is None:
                self._episodes[agent] = self._started(agent, observations[agent], facts_of)
                rewards[agent] = 0.0 if self._rewarding.mode == "replace" else original
                infos[agent] = {**infos[agent], "original_reward": original}
                continue
            transition = Transition(
                episode.observation,
                actions.get(agent),
                observations[agent],
                original,
                terminated[agent],
                truncated[agent],
                infos[agent],
            )
            rewards[agent], infos[agent] = episode.step(transition, partial(facts_of, agent))
        for agent in self._episodes.keys() - {*self.env.agents}:
            del self._episodes[agent]
        return observations, rewards, terminated, truncated, infos

    def _started(
        self, agent: str, observation: Any, facts_of: Callable[[str], Facts]
    ) -> RuledEpisode[Any, Any]:
        return RuledEpisode(self._of(agent), observation, facts_of(agent))

    def _facts(
        self, observations: Mapping[str, Any], infos: Mapping[str, Any]
    ) -> Callable[[str], Facts]:
        """Return what gives the facts of an agent's state."""
        if self._facts_of is None:
            return lambda agent: self._rewarding.reward.observe(observations[agent])
        shared = self._facts_of(observations, infos, self.env)
        return lambda _agent: shared

    def _of(self, agent: str) -> Rewarding:
        """Return by what an agent is rewarded."""
        if agent not in self._of_agents:
            common, signals_of = self._rewarding, self._rewarding.signals_of
            reward = common.reward
            self._of_agents[agent] = replace(
                common,
                reward=reward if self._facts_of is None else reward.for_subject(agent),
                signals_of=None if signals_of is None else partial(signals_of, agent),
            )
        return self._of_agents[agent]
