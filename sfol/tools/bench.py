"""Speed of a knowledge base: every figure and every ratio from one run.

The scene is a test of the knowledge base, in which one entity and all that is said of it is
repeated; so it measures whatever the file is about.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np

from sfol.errors import KnowledgeBaseError, UsageError
from sfol.facts import Bound, Facts
from sfol.knowledge_base import Case, KnowledgeBase
from sfol.reward import RewardFunction
from sfol.syntax import Atom
from sfol.testing.cases import written_out
from sfol.tools.bench_hand_written import measure_hand_written
from sfol.tools.bench_observations import measure_observations
from sfol.tools.bench_pyreason import ready, ready_compared, run_python

Tuples = Sequence[tuple[Atom, Bound]]

SIZES = (1, 10, 25, 50)
BATCHES = (1, 16, 256, 4096, 65_536)
GRADIENT_SCENES = 4096
_SECONDS = 0.5  # how long each figure is measured


def measure(
    kb: KnowledgeBase,
    *,
    quick: bool = False,
    progress: Callable[[str], None] = lambda stage: None,
) -> dict[str, Any]:
    """Return the costs of a knowledge base, ready for JSON.

    Args:
        kb: with at least one test that names an entity besides the subject.
        quick: whether to leave out PyReason's start without a cache, which takes ten minutes.
        progress: called with the name of each stage as it begins.

    Returns:
        Times in the unit that the key names, medians; ratios of times taken in this run.

    Raises:
        KnowledgeBaseError: there is no such test.
        UsageError: it has rules over time, and neither single steps nor batches are worth anything.
    """
    if kb.has_memory:
        raise UsageError(
            f"'{kb.name}' has rules over time, and what is measured are single steps and batches",
            name=kb.name,
            suggestion="measure what it extends, or the file without operators and smoothing",
        )
    case, entity = busiest(kb)
    result: dict[str, Any] = {"knowledge_base": kb.name, "scene": case.name, "repeated": entity}
    engines = ["compiled", *(["pyreason"] if find_spec("pyreason") else [])]
    stages: Mapping[str, Callable[[], object]] = {
        "import": _imports,
        "single": lambda: _single(kb, case, entity, engines),
        "batch": lambda: _batches(kb, case, entity),
        "gradient": lambda: _gradient(kb, case, entity),
        "observations": lambda: measure_observations(kb, median),
        "hand_written": lambda: measure_hand_written(kb),
    }
    if "pyreason" in engines:
        stages = {**stages, "pyreason_start": ready}
        if not quick:
            stages = {**stages, "pyreason_start_compared": ready_compared}
    for name, stage in stages.items():
        progress(name)
        result[name] = stage()
    return result


def busiest(kb: KnowledgeBase) -> tuple[Case, str]:
    """Return the test with the most facts, and the entity in it of which the most is said.

    Raises:
        KnowledgeBaseError: no test names an entity besides the subject.
    """
    reward = RewardFunction(kb)
    cases = [written_out(reward, case) for case in kb.tests]
    scenes = [(case, Facts.parse(case.facts)) for case in cases]
    found = [
        (len(facts), sum(entity in atom.arguments for atom in facts), case, entity)
        for case, facts in scenes
        for entity in facts.entities()
        if entity != kb.subject
    ]
    if not found:
        raise KnowledgeBaseError(
            f"'{kb.name}' has no test with an entity besides '{kb.subject}'",
            name=kb.name,
            suggestion="add one: the benchmark repeats an entity of a test",
        )
    _, _, case, entity = max(found, key=lambda entry: entry[:2])
    return case, entity


def repeated(kb: KnowledgeBase, case: Case, entity: str, times: int) -> Tuples:
    """Return the facts of a test, with one entity so many times, each by a name of its own."""
    facts = list(Facts.parse(case.facts, margin=kb.grounding.margin).items())
    copies = [
        (Atom(atom.predicate, _renamed(atom.arguments, entity, f"{entity}_{i}")), bound)
        for i in range(times)
        for atom, bound in facts
        if entity in atom.arguments
    ]
    return [*((atom, bound) for atom, bound in facts if entity not in atom.arguments), *copies]


def _renamed(arguments: Sequence[str], old: str, new: str) -> tuple[str, ...]:
    return tuple(new if argument == old else argument for argument in arguments)


def _facts(tuples: Tuples) -> Facts:
    facts = Facts()
    for (predicate, arguments), bound in tuples:
        facts.add(predicate, *arguments, bound=bound)
    return facts


def _single(
    kb: KnowledgeBase, case: Case, entity: str, engines: Sequence[str]
) -> dict[str, dict[str, float]]:
    rewards = {engine: RewardFunction(kb, engine=engine) for engine in engines}
    return {
        str(size): _one_size(rewards, repeated(kb, case, entity, size), case.signals)
        for size in SIZES
    }


def _one_size(
    rewards: Mapping[str, RewardFunction], tuples: Tuples, signals: Mapping[str, float]
) -> dict[str, float]:
    prepared = _facts(tuples)
    compiled = rewards["compiled"]
    figures = {
        "from_tuples_us": 1e6 * median(lambda: compiled.evaluate(_facts(tuples), **signals)),
        "prepared_us": 1e6 * median(lambda: compiled.evaluate(prepared, **signals)),
    }
    if "pyreason" in rewards:
        reference = 1e6 * median(lambda: rewards["pyreason"].evaluate(prepared, **signals))
        figures["pyreason_us"] = reference
        figures["pyreason_over_from_tuples"] = reference / figures["from_tuples_us"]
        figures["pyreason_over_prepared"] = reference / figures["prepared_us"]
    return {name: round(value, 1) for name, value in figures.items()}


def _batches(kb: KnowledgeBase, case: Case, entity: str) -> dict[str, dict[str, float]]:
    reward = RewardFunction(kb)
    facts = _facts(repeated(kb, case, entity, 10))
    figures = {}
    for size in BATCHES:
        started = time.perf_counter()
        batch = reward.batch([facts] * size)
        encoding = time.perf_counter() - started
        signals = {name: np.full(size, value) for name, value in case.signals.items()}
        seconds = median(lambda b=batch, s=signals: reward.evaluate(b, **s))  # type: ignore[misc]
        figures[str(size)] = {
            "encode_us_a_scene": round(1e6 * encoding / size, 1),
            "scenes_a_second": round(size / seconds),
        }
    return figures


def _gradient(kb: KnowledgeBase, case: Case, entity: str) -> dict[str, float] | None:
    """Return the cost of a gradient of all coefficients, or None where torch is missing."""
    if find_spec("torch") is None:
        return None
    import torch  # noqa: PLC0415  (slow, and optional)

    reward = RewardFunction(kb)
    batch = reward.batch([_facts(repeated(kb, case, entity, 10))] * GRADIENT_SCENES)
    for numbers in reward.coefficients.values():
        for head in numbers:
            numbers[head] = torch.tensor(numbers[head], dtype=torch.float64, requires_grad=True)  # type: ignore[assignment]

    def forward() -> Any:
        return reward.evaluate(batch, **case.signals).reward.sum()

    with torch.no_grad():
        alone = median(forward)
    both = median(lambda: forward().backward())
    return {
        "forward_ms": round(1e3 * alone, 2),
        "forward_and_backward_ms": round(1e3 * both, 2),
        "ratio": round(both / alone, 2),
    }


def _imports() -> dict[str, float]:
    numpy_and_pydantic, whole = (
        1e3 * median(lambda c=code: run_python(c))  # type: ignore[misc]
        for code in ("import numpy, pydantic", "import sfol")
    )
    return {
        "numpy_and_pydantic_ms": round(numpy_and_pydantic),
        "sfol_ms": round(whole),
        "sfol_more_ms": round(whole - numpy_and_pydantic),
    }


def median(call: Callable[[], object]) -> float:
    """Return the median duration of a call in s, over half a second and at least five calls."""
    call()
    samples: list[float] = []
    while len(samples) < 5 or sum(samples) < _SECONDS:
        started = time.perf_counter()
        call()
        samples.append(time.perf_counter() - started)
    return statistics.median(samples)
