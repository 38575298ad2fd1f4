"""Speed of a knowledge base beside the same reward written by hand, in one run.

Both get the same random steps and are called in turns. Where they do not give the same rewards,
their times say nothing of each other, and no ratio is reported.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

import numpy as np

from sfol import arrays
from sfol.knowledge_base import KnowledgeBase
from sfol.reward import RewardFunction
from sfol.tools.hand_written import HAND_WRITTEN, HandWritten

SCENES = (64, 4096, 65_536)
CHECKED = 1000  # how many steps are compared, however few are measured
SAME = 1e-9  # up to which difference of rewards they are the same
SECONDS = 0.5  # how long each side of a comparison is measured
_LEAST_TURNS = 5


def measure_hand_written(kb: KnowledgeBase) -> dict[str, dict[str, float]] | None:
    """Return what rewards of arrays cost by rules and by hand.

    Args:
        kb: any knowledge base.

    Returns:
        By array library, device and number of scenes, the greatest difference between the rewards
        and, if that is `SAME` at most, times in ms, medians, and their ratio. None if the reward of
        no knowledge base of this name is written by hand.
    """
    by_hand = HAND_WRITTEN.get(kb.name)
    if by_hand is None:
        return None
    reward = RewardFunction(kb)
    return {
        f"{kind} {size}": _compared(reward, by_hand, kind, size)
        for kind in _kinds()
        for size in SCENES
    }


def _kinds() -> list[str]:
    if find_spec("torch") is None:
        return ["numpy"]
    import torch  # noqa: PLC0415  (slow, and optional)

    return ["numpy", "torch cpu", *(["torch cuda"] if torch.cuda.is_available() else [])]


def _compared(
    reward: RewardFunction, by_hand: HandWritten, kind: str, size: int
) -> dict[str, float]:
    with _library(kind) as (library, converted, wait):

        def steps(count: int) -> list[Any]:
            return [converted(part) for part in by_hand.steps(np.random.default_rng(0), count)]

        def rules(before: Any, after: Any) -> Any:
            rewards = reward.transitions(before, None, after).reward
            wait()
            return rewards

        def hand(before: Any, after: Any) -> Any:
            rewards = by_hand.reward(library, before, after)
            wait()
            return rewards

        # A few steps may be worth the same by chance.
        difference = max(
            float(np.max(np.abs(arrays.plain(rules(*step)) - arrays.plain(hand(*step)))))
            for step in (steps(size), steps(CHECKED))
        )
        if not difference <= SAME:
            return {"difference": difference}
        step = steps(size)
        by_rules, alone = in_turns(lambda: rules(*step), lambda: hand(*step))
    return {
        "difference": difference,
        "rules_ms": round(1e3 * by_rules, 3),
        "by_hand_ms": round(1e3 * alone, 3),
        "ratio": round(by_rules / alone, 2),
        "rules_scenes_a_second": round(size / by_rules),
    }


_Library = tuple[Any, Callable[[Any], Any], Callable[[], object]]


@contextmanager
def _library(kind: str) -> Iterator[_Library]:
    """Yield the functions of arrays, what converts numpy's, and what waits for the device."""
    if kind == "numpy":
        yield np, lambda observation: observation, lambda: None
        return
    import torch  # noqa: PLC0415  (slow, and optional)

    device = kind.removeprefix("torch ")

    def converted(observation: Any) -> Any:
        if isinstance(observation, Mapping):
            return {name: converted(part) for name, part in observation.items()}
        return torch.from_numpy(observation).to(device)

    with torch.no_grad():
        yield torch, converted, torch.cuda.synchronize if device == "cuda" else lambda: None


def in_turns(first: Callable[[], object], second: Callable[[], object]) -> tuple[float, float]:
    """Return the median durations of two calls in s, made in turns, so that both fare alike."""
    samples: list[tuple[float, float]] = []
    ends = time.perf_counter() + 2 * SECONDS
    while len(samples) < _LEAST_TURNS or time.perf_counter() < ends:
        started = time.perf_counter()
        first()
        between = time.perf_counter()
        second()
        samples.append((between - started, time.perf_counter() - between))
    one, other = (statistics.median(column) for column in zip(*samples, strict=True))
    return one, other
