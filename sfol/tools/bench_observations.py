"""Speed of a knowledge base that reads observations: from arrays to rewards, and in wrappers.

The step is a test of the knowledge base; over batches and environments it is the same everywhere,
which costs what different ones would.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np

from sfol.knowledge_base import Case, KnowledgeBase
from sfol.observations.plans import ObservedStep, read_for_facts
from sfol.reward import RewardFunction

SCENES = (1, 64, 4096)
ENVIRONMENTS = 64

Median = Callable[[Callable[[], object]], float]  # the duration of a call, in s
_Array = Any


def measure_observations(kb: KnowledgeBase, median: Median) -> dict[str, Any] | None:
    """Return the costs of facts and signals that are read, with those of the reward.

    Args:
        kb: any knowledge base.
        median: returns the median duration of a call, in s.

    Returns:
        ``step`` names the test; ``single``, one transition, in µs; ``batch``, by number of scenes,
        as a list of facts, as numpy arrays and, with torch installed, as tensors, in scenes a
        second; ``wrappers``, with Gymnasium installed, what a step of many environments costs, in
        µs. None if no test has an observation.
    """
    case = _fullest(kb)
    if case is None:
        return None
    reward = RewardFunction(kb)
    return {
        "step": case.name,
        "single": _single(reward, case, median),
        "batch": {str(scenes): _batch(reward, case, scenes, median) for scenes in SCENES},
        "wrappers": _wrappers(kb, case, median) if find_spec("gymnasium") else None,
    }


def _fullest(kb: KnowledgeBase) -> Case | None:
    """Return the test that observes the most numbers."""
    cases = [case for case in kb.tests if case.observation is not None]
    return max(cases, key=lambda case: _size(case.observation) + _size(case.next), default=None)


def _size(value: object) -> int:
    if isinstance(value, Mapping):
        return sum(map(_size, value.values()))
    return sum(map(_size, value)) if isinstance(value, Sequence) else 1


def _step(case: Case, convert: Callable[[Any], Any]) -> tuple[Any, ...]:
    """Return what `RewardFunction.transition` takes, with all numbers converted."""
    parts = (case.observation, case.action, case.next, case.native, case.terminated, case.truncated)
    return tuple(None if part is None else _converted(part, convert) for part in parts)


def _converted(value: Any, convert: Callable[[Any], Any]) -> Any:
    if isinstance(value, Mapping):
        return {key: _converted(part, convert) for key, part in value.items()}
    return convert(np.asarray(value))


def _single(reward: RewardFunction, case: Case, median: Median) -> dict[str, float]:
    step = _step(case, lambda array: array)
    observed = read_for_facts(reward.kb, ObservedStep(*step))
    given = dict(case.signals)
    facts = reward.observe(observed)
    signals = reward.observe_signals(*step, **given)
    return {
        "observation_to_reward_us": _us(median(lambda: reward.transition(*step, **given))),
        "observation_to_facts_us": _us(median(lambda: reward.observe(observed))),
        "facts_to_reward_us": _us(median(lambda: reward.evaluate(facts, **signals))),
    }


def _batch(reward: RewardFunction, case: Case, scenes: int, median: Median) -> dict[str, float]:
    def many(array: _Array) -> _Array:
        return np.repeat(array[None], scenes, axis=0)

    def paces(step: tuple[Any, ...]) -> float:
        return median(lambda: reward.transitions(*step, **case.signals))

    single = _step(case, lambda array: array)
    facts = reward.observe(read_for_facts(reward.kb, ObservedStep(*single)))
    signals = reward.observe_signals(*single, **case.signals)
    started = time.perf_counter()
    reward.evaluate(reward.batch([facts] * scenes), **signals)
    listed = time.perf_counter() - started
    seconds = {"list_of_facts": listed, "numpy": paces(_step(case, many))}
    if find_spec("torch") is not None:
        import torch  # noqa: PLC0415  (slow, and optional)

        with torch.no_grad():
            seconds["torch"] = paces(_step(case, lambda array: torch.from_numpy(many(array))))
    return {f"{name}_scenes_a_second": round(scenes / time) for name, time in seconds.items()}


def _wrappers(kb: KnowledgeBase, case: Case, median: Median) -> dict[str, float]:
    """Return what a step costs of many environments in which nothing happens."""
    import gymnasium  # noqa: PLC0415  (slow, and optional)

    from sfol.tools.bench_environment import Still  # noqa: PLC0415  (needs it)
    from sfol.wrappers import RuleReward, VectorRuleReward  # noqa: PLC0415  (likewise)

    observation = _converted(_state(case), np.float64)

    def still() -> Still:
        return Still(observation)

    apart = [RuleReward(still(), RewardFunction(kb)) for _ in range(ENVIRONMENTS)]
    for environment in apart:
        environment.reset()
    together = VectorRuleReward(
        gymnasium.vector.SyncVectorEnv([still] * ENVIRONMENTS), RewardFunction(kb)
    )
    together.reset()
    actions = np.zeros(ENVIRONMENTS, np.int64)
    bare = gymnasium.vector.SyncVectorEnv([still] * ENVIRONMENTS)
    bare.reset()
    alone = median(lambda: [environment.step(0) for environment in apart])
    vector = median(lambda: together.step(actions))
    return {
        "environments": ENVIRONMENTS,
        "rule_reward_us": _us(alone),
        "vector_rule_reward_us": _us(vector),
        "vector_without_rules_us": _us(median(lambda: bare.step(actions))),
        "ratio": round(alone / vector, 1),
    }


def _state(case: Case) -> Any:
    """Return what a test observes last, with what it does not say anew as it was before."""
    if isinstance(case.observation, Mapping) and isinstance(case.next, Mapping):
        return {**case.observation, **case.next}
    return case.observation if case.next is None else case.next


def _us(seconds: float) -> float:
    return round(1e6 * seconds, 1)
