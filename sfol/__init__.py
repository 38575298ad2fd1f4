"""sfol: rewards for reinforcement learning as logic that people write in YAML.

Example:
    >>> import sfol
    >>> reward = sfol.RewardFunction("aeb")
    >>> facts = sfol.Facts.parse("Pedestrian(p1): 0.8. OnRoad(p1). CenterOf(p1, ego).")
    >>> outcome = reward.evaluate(facts, v=6.0, v_next=5.5, d=9.0)
    >>> round(outcome.confidences["safe1"], 3)
    0.95
"""

from sfol import errors
from sfol.facts import Bound, Facts
from sfol.knowledge_base import KnowledgeBase
from sfol.outcome import Outcome
from sfol.reward import RewardFunction
from sfol.syntax import Atom, constant

__version__ = "0.1.0"

__all__ = [
    "Atom",
    "Bound",
    "Facts",
    "KnowledgeBase",
    "Outcome",
    "RewardFunction",
    "constant",
    "errors",
]
