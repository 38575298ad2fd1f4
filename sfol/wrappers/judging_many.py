"""What the rules give for the steps of many environments: one evaluation for all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sfol import arrays
from sfol.arrays import Array
from sfol.observations.plans import Observation
from sfol.outcome import log_items, named
from sfol.recorded_steps import Reals
from sfol.reward import RewardFunction
from sfol.wrappers.modes import Shaping, item_names, total
from sfol.wrappers.nested import copied, rows

Mask = npt.NDArray[np.bool_]


class ManySteps(NamedTuple):
    """A step of each of B environments, in the order of `RewardFunction.transition`.

    Attributes:
        observations: of the states before.
        actions: what was done.
        landed: the observations of the states after, before any environment began anew.
        native: (B,), the environments' own rewards.
        terminated: (B,), whether a step terminated its episode.
        truncated: (B,), whether an episode was truncated after it.
    """

    observations: Observation
    actions: Any
    landed: Observation
    native: Array
    terminated: Mask
    truncated: Mask


class Judgements(NamedTuple):
    """What the rules give for B steps.

    Attributes:
        values: (B,), the sums of the terms.
        terms: their summands (B,) by name.
        items: what `info` gets, (B,) each.
        fired: rule → whether it fired (B,); None if nobody asks.
    """

    values: Reals
    terms: Mapping[str, Reals]
    items: Mapping[str, Reals]
    fired: Mapping[str, Mask] | None


class ManyJudge:
    """Judges the steps of B environments, one after the other.

    Args:
        reward: the reward function; its knowledge base says how facts and signals are read.
        shaping: how the environments' own rewards are shaped, if they are.

    Attributes:
        reports_fired: whether `Judgements` have which rules fired.
    """

    def __init__(self, reward: RewardFunction, shaping: Shaping | None) -> None:
        self.reports_fired = False
        self._reward = reward
        self._shaping = shaping
        self._names = item_names(reward)

    def begin(self, observations: Observation) -> None:
        """Begin with some states."""
        if self._shaping is not None:
            self._potential = self._shaping.potentials(self._reward, observations)
        self._observations = copied(observations)

    def step(  # noqa: PLR0913, PLR0917 (what a step of environments gives, in its order)
        self,
        actions: Any,
        landed: Observation,
        native: Array,
        terminated: Mask,
        truncated: Mask,
        taken: Mask,
    ) -> Judgements:
        """Judge steps from the present states.

        Args:
            actions: what was done.
            landed: the observations after it, before any environment began anew.
            native: (B,), the environments' own rewards.
            terminated: (B,), whether a step terminated its episode.
            truncated: (B,), whether an episode was truncated after it.
            taken: (B,), who took a step; the others get 0.
        """
        step = ManySteps(self._observations, actions, landed, native, terminated, truncated)
        if self._shaping is not None:
            return self._shaped(self._shaping, step, taken)
        # Also of those who began anew, where that can be repeated: choosing rows takes longer.
        found = self._reward.repeated_many(step, fired=self.reports_fired)
        if found is not None:
            np.copyto(found, 0.0, where=~taken)
            return self._repeated(found)
        if taken.all():
            return self._rewarded(step, arrays.plain)
        if not taken.any():
            zeros = np.zeros(len(taken))
            terms = dict.fromkeys(self._reward.kb.terms, zeros)
            return Judgements(zeros, terms, named(reward=terms), self._nothing(taken))
        chosen = ManySteps(*(rows(part, taken) for part in step))
        return self._rewarded(chosen, partial(_spread, mask=taken))

    def _repeated(self, found: Reals) -> Judgements:
        value, *numbers = found
        kb = self._reward.kb
        terms = dict(zip(kb.terms, numbers, strict=False))
        fired = None
        if self.reports_fired:
            masks = (mask != 0 for mask in numbers[len(self._names) :])
            fired = dict(zip(kb.rules, masks, strict=True))
        return Judgements(value, terms, dict(zip(self._names, numbers, strict=False)), fired)

    def go_on(self, observations: Observation, landed: Observation) -> None:
        """Go on from the states that are observed now; from where a step led, if they are same."""
        if self._shaping is None or observations is not landed:
            self.begin(observations)
            return
        self._potential = self._landed_potential
        self._observations = copied(observations)

    def _rewarded(self, step: ManySteps, spread: Callable[[Array], Any]) -> Judgements:
        outcome = self._reward.transitions(*step)
        items = {name: spread(value) for name, value in log_items(outcome).items()}
        terms = {name: items[f"reward_{name}"] for name in outcome.terms}
        at_next = self._reward.kb.facts_at == "next"
        fired = self._fired(step.landed if at_next else step.observations, spread)
        return Judgements(spread(outcome.reward), terms, items, fired)

    def _shaped(self, shaping: Shaping, step: ManySteps, taken: Mask) -> Judgements:
        self._landed_potential = shaping.potentials(self._reward, step.landed)
        given = shaping.terms(self._potential, self._landed_potential, step.terminated)
        terms = {name: np.where(taken, term, 0.0) for name, term in given.items()}
        items = named(reward=terms, potential=self._landed_potential)
        return Judgements(total(terms), terms, items, self._fired(step.landed, arrays.plain))

    def _fired(
        self, observations: Observation, spread: Callable[[Array], Any]
    ) -> dict[str, Mask] | None:
        if not self.reports_fired:
            return None
        fired = self._reward.fired_of_many(observations)
        return {rule: spread(mask) != 0 for rule, mask in fired.items()}

    def _nothing(self, taken: Mask) -> dict[str, Mask] | None:
        return dict.fromkeys(self._reward.kb.rules, taken) if self.reports_fired else None


def _spread(values: Array, mask: Mask) -> Reals:
    """Return values of some of B environments as an array (B,), with 0 for the others."""
    spread = np.zeros(len(mask))
    spread[mask] = arrays.plain(values)
    return spread
