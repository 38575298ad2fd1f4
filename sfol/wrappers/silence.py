"""Rules that never say anything: one warning at the end of the first episode."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from sfol.errors import warn_of_silence
from sfol.facts import Facts
from sfol.reward import RewardFunction

_SPEAKING = ("confidence_", "potential_")


class Silence:
    """Listens until a rule concludes something, or the first episode ends.

    Args:
        reward: the reward function.

    Attributes:
        lasts: whether it listens.
    """

    def __init__(self, reward: RewardFunction) -> None:
        self._kb = reward.kb
        self.lasts = bool(reward.kb.heads)

    def hear(self, items: Mapping[str, float | npt.NDArray[Any]]) -> None:
        """Listen to a step.

        Args:
            items: what `info` gets: numbers, or arrays (B,).
        """
        if self.lasts:
            spoken = (value for name, value in items.items() if name.startswith(_SPEAKING))
            self.lasts = not any(np.any(value) for value in spoken)

    def end(self, facts: Callable[[], Facts] | None = None) -> None:
        """Warn at the end of an episode, if it was the first and nothing was concluded in it.

        Args:
            facts: returns its last ones, if they are at hand.
        """
        if not self.lasts:
            return
        self.lasts = False
        given = {atom.predicate for atom in self._kb.background} | {*self._kb.heads}
        known = None if facts is None else {*facts().predicates()}
        missing = [] if known is None else sorted(self._kb.read - given - known)
        shown = ", ".join(missing[:5]) + (", …" if len(missing) > 5 else "")
        hint = f"its last facts say nothing of {shown}; " if missing else ""
        warn_of_silence(
            f"'{self._kb.name}': no rule has concluded anything about '{self._kb.subject}' in a "
            f"whole episode ({hint}sfol lint finds rules that can't, RewardFunction.explain says "
            "what each lacks)"
        )
