"""A wrapper of one environment."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, SupportsFloat

import gymnasium

from sfol.errors import UsageError, expect
from sfol.facts import Facts
from sfol.knowledge_base import ScheduledNumber
from sfol.reward import RewardFunction
from sfol.wrappers.goals import ACHIEVED, DESIRED, TRANSITION, Hindsight, has_goals
from sfol.wrappers.judging import Action, Judge, Observation, Transition
from sfol.wrappers.modes import EPISODE, EpisodeSums, checked_shaping
from sfol.wrappers.silence import Silence


class RuleReward(
    gymnasium.Wrapper[Observation, Action, Observation, Action],
    gymnasium.utils.RecordConstructorArgs,
):
    """Rewards the steps of an environment by a knowledge base.

    Facts and signals are read off observations as the knowledge base says; functions may make them
    instead, or the signals that it does not read. A step is rewarded by the facts of the state
    before it, or of the state after it if the knowledge base says `facts_at: next`. If no rule
    concludes anything about the subject in the first episode, a `SilentZeroWarning` says so. Rules
    over time remember the steps since the last reset.

    In mode ``replace`` the reward is that of the knowledge base, R, in mode ``add`` the sum of it
    and the environment's own. In mode ``potential`` the environment's own reward is shaped by
    γ φ(s') − φ(s), where φ(s) is R of one state, or a weight; φ of a terminal state is 0, so that
    every policy that was optimal is so still (Ng, Harada, Russell 1999).

    ``info`` of every step gets ``reward_<term>`` (they sum to what the rules gave), and the
    environment's own reward as ``original_reward``; ``weight_<name>`` and ``confidence_<head>``, or
    ``potential_<term>`` of s' in mode ``potential``. At the end of an episode ``sfol.episode`` has
    its sums: ``return``, ``original_return``, ``length`` and ``terms``.

    Where the environment has goals, `compute_reward` is the rules' as well, so that hindsight pays
    the same reward for goals that are replaced.

    Args:
        env: any environment.
        reward: the reward function.
        facts: makes facts of (observation, info, env); called at reset and after each step. None
            reads them off the observation.
        signals: makes signals of a transition, by name; the others are read off it.
        mode: ``replace``, ``add`` or ``potential``.
        potential: in mode ``potential``, a weight that is φ; None for R, which may then have no
            signals but those of one state.
        discount: in mode ``potential``, γ, that of the agent.

    Raises:
        UsageError: an argument is of another type or does not belong to the mode, or the knowledge
            base does not say how something is read and there is no function that makes it.
    """

    def __init__(  # noqa: PLR0913 (six have defaults and are given by name)
        self,
        env: gymnasium.Env[Observation, Action],
        reward: RewardFunction,
        *,
        facts: Callable[[Observation, Mapping[str, Any], gymnasium.Env[Any, Any]], Facts]
        | None = None,
        signals: Callable[[Transition[Observation, Action]], Mapping[str, float]] | None = None,
        mode: str = "replace",
        potential: str | None = None,
        discount: float | None = None,
    ) -> None:
        expect(env, gymnasium.Env, "the environment", "give a gymnasium.Env")
        shaping = checked_shaping(reward, facts, signals, mode, potential, discount)
        # So that Gymnasium can make the environment again from its specification.
        gymnasium.utils.RecordConstructorArgs.__init__(
            self,
            reward=reward,
            facts=facts,
            signals=signals,
            mode=mode,
            potential=potential,
            discount=discount,
            _disable_deepcopy=True,
        )
        gymnasium.Wrapper.__init__(self, env)
        self._judge: Judge[Observation, Action] = Judge(
            reward, facts=facts, signals=signals, shaping=shaping, context=(env,)
        )
        self._reward = reward
        self._mode = mode
        self._silence = Silence(reward)
        self._hindsight: Hindsight | None = None
        alone = facts is None and signals is None and not reward.kb.has_memory
        if has_goals(env.observation_space) and alone:
            self._hindsight = Hindsight(env.observation_space, self._native, reward, mode, shaping)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; see `gymnasium.Env.reset`."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._judge.begin(observation, info)
        self._sums = EpisodeSums()
        return observation, info

    def step(self, action: Action) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Take a step and reward it; see `gymnasium.Env.step`."""
        observation, original, terminated, truncated, info = self.env.step(action)
        before = self._judge.observation
        transition = Transition(before, action, observation, original, terminated, truncated, info)
        given = self._judge.step(transition)
        value = given.value if self._mode == "replace" else float(original) + given.value
        self._sums.add(value, float(original), given.terms)
        info = {**info, **given.items, "original_reward": original}
        self._silence.hear(given.items)
        if terminated or truncated:
            info[EPISODE] = self._sums.items()
            self._silence.end(lambda: self._judge.facts)
        if self._hindsight is not None and self._hindsight.needs_transition:
            after = self._judge.observation  # a copy
            info[TRANSITION] = Transition(
                before, action, after, original, terminated, truncated, transition.info
            )
        return observation, value, terminated, truncated, info

    @property
    def schedules(self) -> Mapping[str, ScheduledNumber]:
        """The numbers of the knowledge base that change while an agent is trained."""
        return self._reward.kb.schedules

    def apply_schedules(self, *, steps: int, episodes: int) -> dict[str, float]:
        """Set the scheduled numbers of the reward; see `RewardFunction.apply_schedules`."""
        return self._reward.apply_schedules(steps=steps, episodes=episodes)

    def report_fired(self, *, whether: bool = True) -> None:
        """Say whether ``info`` gets ``sfol.fired``: rule → whether it concluded something."""
        self._judge.reports_fired = whether

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Return the reward of a step had the goal been another one, as hindsight asks for it.

        It is the rules' reward, made of the goals if they are all that is read of a step. If more
        is read, ``info["sfol.transition"]`` must say what happened, as it does where `step` filled
        it in. How a step ended stays as it was.

        Args:
            achieved_goal: of the state that the step led to; or of B steps, with an axis B before
                all others.
            desired_goal: the other goal, likewise.
            info: of the step; or of each step.

        Returns:
            A number, or float64 (B,).

        Raises:
            UsageError: the environment has no goals, facts or signals are made by functions, rules
                speak of steps that have passed, or info does not say what the reward needs.
        """
        if self._hindsight is None:
            raise self._no_hindsight()
        return self._hindsight.rewards(achieved_goal, desired_goal, info)

    def _no_hindsight(self) -> UsageError:
        if not has_goals(self.env.observation_space):
            why = "the environment has no goals"
            suggestion = f"it must observe '{ACHIEVED}' and '{DESIRED}'"
        elif self._reward.kb.has_memory:
            why = "rules over time can't tell what a step would have been worth with another past"
            suggestion = "leave out operators over time and smoothing, or learn without hindsight"
        else:
            why = "facts or signals are made by functions, which know the present alone"
            suggestion = "let the knowledge base say how they are read off observations"
        return UsageError(why, name="compute_reward", suggestion=suggestion)

    def _native(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Return the environment's own reward with other goals."""
        return self.env.get_wrapper_attr("compute_reward")(achieved_goal, desired_goal, info)
