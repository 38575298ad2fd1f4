"""For stable-baselines3: its vectorised environments rewarded by rules, and what is logged of it.

May import the wrappers, and is imported by nothing else in sfol.
"""

from sfol.errors import missing_extra

try:
    import stable_baselines3 as stable_baselines3  # the modules below need it
except ImportError as error:
    raise missing_extra("stable-baselines3", "sfol.sb3 is for it", extra="sb3") from error

from sfol.sb3.callback import RuleRewardCallback
from sfol.sb3.vec_env import VecRuleReward

__all__ = ["RuleRewardCallback", "VecRuleReward"]
