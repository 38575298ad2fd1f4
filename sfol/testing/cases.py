"""Runs the `tests` of a knowledge base, with rule coverage."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from sfol.errors import SfolError
from sfol.facts import Facts
from sfol.knowledge_base import Case, KnowledgeBase
from sfol.knowledge_base.observing import ACTION, NEXT, STEP
from sfol.observations.plans import ObservedStep, read_for_facts
from sfol.outcome import Outcome
from sfol.reward import RewardFunction

TOLERANCE = 1e-9


@dataclass(frozen=True)
class CaseResult:
    """What came of one test.

    Attributes:
        name: the test's name.
        differences: what came out otherwise than expected, a line each; none means passed.
        fired: the rules that concluded something.
    """

    name: str
    differences: tuple[str, ...]
    fired: frozenset[str]

    @property
    def passed(self) -> bool:
        """Whether everything came out as expected."""
        return not self.differences


@dataclass(frozen=True)
class TestReport:
    """What came of all tests of a knowledge base.

    Attributes:
        results: one for each test, in order.
        coverage: rule → number of tests in which it concluded something.
    """

    __test__ = False  # pytest would take the class for a test of its own

    results: tuple[CaseResult, ...]
    coverage: Mapping[str, int]

    @property
    def passed(self) -> bool:
        """Whether every test passed."""
        return all(result.passed for result in self.results)

    @property
    def covered(self) -> int:
        """How many rules concluded something in at least one test."""
        return sum(count > 0 for count in self.coverage.values())


def run_tests(kb: KnowledgeBase) -> TestReport:
    """Run the tests that stand in a knowledge base.

    Args:
        kb: the knowledge base; tests that it inherits from what it extends do not run.
    """
    reward = RewardFunction(kb)
    results = tuple(run_case(reward, case) for case in kb.tests)
    coverage = {rule: sum(rule in result.fired for result in results) for rule in kb.rules}
    return TestReport(results, coverage)


def run_case(reward: RewardFunction, case: Case) -> CaseResult:
    """Run one test of a knowledge base."""
    try:
        case = written_out(reward, case)
        facts = Facts.parse(case.facts, margin=reward.kb.grounding.margin)
        conclusions = reward.conclude(facts)
    except SfolError as error:
        return CaseResult(case.name, (str(error),), frozenset())
    try:
        outcome = reward.evaluate(conclusions, **case.signals)
    except SfolError as error:
        return CaseResult(case.name, (str(error),), conclusions.fired)
    return CaseResult(case.name, tuple(_differences(case, outcome)), conclusions.fired)


def written_out(reward: RewardFunction, case: Case) -> Case:
    """Return a test with the facts and signals that are read off its observations, in their place.

    Raises:
        FactError: the observation has another form than the knowledge base says.
        SignalError: so has something that a signal reads, or it is not given.
    """
    if case.observation is None:
        return case
    observed = (case.observation, case.action, case.next)
    step = ObservedStep(*observed, case.native, case.terminated, case.truncated)
    signals = reward.observe_signals(*step.wholes.values(), **case.signals)
    facts = str(reward.observe(read_for_facts(reward.kb, step)))
    read = dict.fromkeys(("observation", ACTION, NEXT, *STEP))
    return case.model_copy(update={"facts": facts, "signals": signals, **read})


def _differences(case: Case, outcome: Outcome) -> Iterator[str]:
    expect = case.expect
    for head, pair in expect.bounds.items():
        yield from _compare(f"bound of {head}", pair, outcome.bounds.get(head))
    for head, value in expect.confidences.items():
        yield from _compare(f"confidence of {head}", value, outcome.confidences.get(head, 0.0))
    for name, value in expect.weights.items():
        yield from _compare(f"weight {name}", value, outcome.weights[name])
    for name, value in expect.terms.items():
        yield from _compare(f"term {name}", value, outcome.terms[name])
    if expect.reward is not None:
        yield from _compare("reward", expect.reward, outcome.reward)


def _compare(
    what: str, expected: float | Sequence[float] | None, found: float | Sequence[float] | None
) -> Iterator[str]:
    if not _equal(expected, found):
        yield f"{what}: expected {_shown(expected)}, found {_shown(found)}"


def _equal(expected: float | Sequence[float] | None, found: float | Sequence[float] | None) -> bool:
    if expected is None or found is None:
        return expected is found
    if isinstance(expected, Sequence) and isinstance(found, Sequence):
        return all(map(_equal, expected, found))
    assert not isinstance(expected, Sequence)
    assert not isinstance(found, Sequence)
    return math.isclose(expected, found, rel_tol=TOLERANCE, abs_tol=TOLERANCE)


def _shown(value: float | Sequence[float] | None) -> str:
    if value is None:
        return "nothing concluded"
    if isinstance(value, Sequence):
        return f"[{', '.join(f'{v:.10g}' for v in value)}]"
    return f"{value:.10g}"
