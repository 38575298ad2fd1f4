"""A callback that logs what rules' rewards were made of, and lets schedules go on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, unwrap_vec_wrapper

from sfol.errors import UsageError
from sfol.knowledge_base import ScheduledNumber
from sfol.knowledge_base.schedules import values_at
from sfol.sb3.vec_env import VecRuleReward
from sfol.wrappers import EPISODE, FIRED, RuleReward

_LONGEST = 30  # longer names could be cut, and confused, in the tables that loggers print
_CONFIDENCE = "confidence_"
_EPISODES = "sfol_episodes"  # the attribute of a model that counts them, and is saved with it


class RuleRewardCallback(BaseCallback):
    """Logs what the rules gave, at every dump of stable-baselines3's logger.

    ``Episode_Reward/<term>`` is the sum of a term over an episode, ``Episode/return`` that of all
    rewards, ``Episode/original_return`` that of the environment's own and ``Episode/length`` the
    number of steps: means of all episodes that have ended since the dump before. Means of all steps
    since then are ``Confidence/<head>``, which mode ``potential`` has not, and
    ``Rule_Coverage/<rule>``, the share of steps in which a rule concluded something.

    The schedules of the knowledge base go on at the beginning of every rollout, in all processes;
    ``Schedule/<number>`` is the value of a number then. Steps and episodes are counted over all
    environments and from the beginning of the training, also where it is resumed: the model keeps
    both, and its file has them.

    The environments are wrapped with `VecRuleReward`, or each with `sfol.wrappers.RuleReward`, in
    whichever process it runs.

    Args:
        episodes: how many episodes a training had before that is resumed, if it was without this
            callback and a schedule counts episodes.
        verbose: of stable-baselines3.

    Raises:
        UsageError: when a training starts whose environments are not rewarded by rules, or that is
            resumed and nobody knows how many episodes it had.
    """

    def __init__(self, *, episodes: int | None = None, verbose: int = 0) -> None:
        super().__init__(verbose)
        self._earlier = episodes

    def _on_training_start(self) -> None:
        self._call, self._schedules = _rewarding(self.training_env)
        self._call("report_fired")
        self._values: Mapping[str, float] = {}
        vars(self.model)[_EPISODES] = self._episodes_before()

    def _on_rollout_start(self) -> None:
        done = {"steps": self.num_timesteps, "episodes": vars(self.model)[_EPISODES]}
        values = values_at(self._schedules, **done)
        if values != self._values:
            self._call("apply_schedules", **done)
            self._values = values
        for target, value in values.items():
            self.logger.record(f"Schedule/{target}", value, exclude=_hidden(target))

    def _on_training_end(self) -> None:
        self._call("report_fired", whether=False)

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        vars(self.model)[_EPISODES] += int(sum(self.locals["dones"]))
        for info in infos:
            if EPISODE in info:
                self._log_episode(info[EPISODE])
        self._log_means("Confidence", ({
            key.removeprefix(_CONFIDENCE): value
            for key, value in info.items() if key.startswith(_CONFIDENCE)
        } for info in infos))  # fmt: skip
        self._log_means("Rule_Coverage", (info[FIRED] for info in infos))
        return True

    def _log_episode(self, sums: Mapping[str, Any]) -> None:
        for name in ("return", "original_return", "length"):
            self._log_mean("Episode", name, sums[name])
        for term, value in sums["terms"].items():
            self._log_mean("Episode_Reward", term, value)

    def _log_means(self, group: str, numbers: Iterable[Mapping[str, float]]) -> None:
        """Log the means over environments, which all weigh the same."""
        found: dict[str, list[float]] = {}
        for of_environment in numbers:
            for name, value in of_environment.items():
                found.setdefault(name, []).append(value)
        for name, values in found.items():
            self._log_mean(group, name, sum(values) / len(values))

    def _log_mean(self, group: str, name: str, value: float) -> None:
        self.logger.record_mean(f"{group}/{name}", value, exclude=_hidden(name))

    def _episodes_before(self) -> int:
        """Return how many episodes there were before this training, or part of one."""
        if self.num_timesteps == 0:
            return 0
        if self._earlier is not None:
            return self._earlier
        if _EPISODES in vars(self.model):
            return int(vars(self.model)[_EPISODES])
        if any(number.by == "episodes" for number in self._schedules.values()):
            raise UsageError(
                "a schedule counts episodes, and nobody counted those before",
                name="episodes",
                suggestion="say how many there were: RuleRewardCallback(episodes=…)",
            )
        return 0


def _hidden(name: str) -> tuple[str, ...] | None:
    """Return the kinds of output that have no room for a name."""
    return ("stdout", "log") if len(name) > _LONGEST else None


def _rewarding(envs: VecEnv) -> tuple[Callable[..., Any], Mapping[str, ScheduledNumber]]:
    """Return how to call a method of what rewards environments, and the schedules there."""
    wrapper = unwrap_vec_wrapper(envs, VecRuleReward)
    if isinstance(wrapper, VecRuleReward):
        return lambda name, **given: getattr(wrapper, name)(**given), wrapper.schedules
    if all(envs.env_is_wrapped(RuleReward)):
        return envs.env_method, envs.get_attr("schedules")[0]
    raise UsageError(
        "the environments are not rewarded by rules",
        name="RuleRewardCallback",
        suggestion="wrap each with RuleReward, or all of them with VecRuleReward",
    )
