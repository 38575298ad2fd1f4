"""Gymnasium wrappers: any environment, rewarded by rules."""

from sfol.errors import missing_extra

try:
    import gymnasium as gymnasium  # the modules below need it
except ImportError as error:
    raise missing_extra("gymnasium", "the wrappers need it", extra="gymnasium") from error

from sfol.outcome import log_items
from sfol.wrappers.judging import Transition
from sfol.wrappers.modes import EPISODE, FIRED
from sfol.wrappers.single import RuleReward
from sfol.wrappers.vector import VectorRuleReward

__all__ = ["EPISODE", "FIRED", "RuleReward", "Transition", "VectorRuleReward", "log_items"]
