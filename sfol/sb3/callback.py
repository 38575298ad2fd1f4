"""A callback that logs what rules' rewards were made of."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, unwrap_vec_wrapper

from sfol.errors import UsageError
from sfol.sb3.vec_env import VecRuleReward
from sfol.wrappers import EPISODE, FIRED, RuleReward

_LONGEST = 30  # longer names could be cut, and confused, in the tables that loggers print
_CONFIDENCE = "confidence_"


class RuleRewardCallback(BaseCallback):
    """Logs what the rules gave, at every dump of stable-baselines3's logger.

    ``Episode_Reward/<term>`` is the sum of a term over an episode, ``Episode/return`` that of all
    rewards, ``Episode/original_return`` that of the environment's own and ``Episode/length`` the
    number of steps: means of all episodes that have ended since the dump before. Means of all steps
    since then are ``Confidence/<head>``, which mode ``potential`` has not, and
    ``Rule_Coverage/<rule>``, the share of steps in which a rule concluded something.

    The environments are wrapped with `VecRuleReward`, or each with `sfol.wrappers.RuleReward`, in
    whichever process it runs.

    Args:
        verbose: of stable-baselines3.

    Raises:
        UsageError: when a training starts whose environments are not rewarded by rules.
    """

    def _on_training_start(self) -> None:
        self._call = _call_of(self.training_env)
        self._call("report_fired")

    def _on_training_end(self) -> None:
        self._call("report_fired", whether=False)

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
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
        hidden = ("stdout", "log") if len(name) > _LONGEST else None
        self.logger.record_mean(f"{group}/{name}", value, exclude=hidden)


def _call_of(envs: VecEnv) -> Callable[..., list[Any]]:
    """Return how to call a method of what rewards environments, wherever it is."""
    wrapper = unwrap_vec_wrapper(envs, VecRuleReward)
    if wrapper is not None:
        return lambda name, **given: [getattr(wrapper, name)(**given)]
    if all(envs.env_is_wrapped(RuleReward)):
        return envs.env_method
    raise UsageError(
        "the environments are not rewarded by rules",
        name="RuleRewardCallback",
        suggestion="wrap each with RuleReward, or all of them with VecRuleReward",
    )
