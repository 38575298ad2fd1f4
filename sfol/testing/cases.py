"""Runs the `tests` of a knowledge base, with rule coverage."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from sfol.engines.conclusions import Conclusions
from sfol.errors import SfolError
from sfol.facts import Facts
from sfol.knowledge_base import Case, CaseStep, Expectation, KnowledgeBase
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
    differences: list[str] = []
    fired: frozenset[str] = frozenset()
    try:
        steps = steps_of(reward, case)
        pairs = zip(steps, played(reward, steps), strict=True)
        for number, (step, conclusions) in enumerate(pairs, 1):
            fired |= conclusions.fired
            outcome = reward.evaluate(conclusions, **step.signals)
            differences += [f"step {number}: {line}" for line in _differences(step.expect, outcome)]
        differences += _differences(case.expect, outcome)
    except SfolError as error:
        differences.append(str(error))
    return CaseResult(case.name, tuple(differences), fired)


def played(reward: RewardFunction, steps: Iterable[CaseStep]) -> Iterator[Conclusions]:
    """Yield what follows from the facts of each step, which make one episode.

    Raises:
        SfolError: the facts of a step don't fit the knowledge base.
    """
    episode = reward.episode()
    for step in steps:
        yield episode.conclude(Facts.parse(step.facts, margin=reward.kb.grounding.margin))


def steps_of(reward: RewardFunction, case: Case) -> list[CaseStep]:
    """Return the steps that a test plays, one after the other; most tests play a single one.

    Raises:
        SfolError: something can't be read off the test's observations.
    """
    if not case.steps:
        case = written_out(reward, case)
        return [CaseStep(facts=case.facts, signals=case.signals)]
    steps = []
    for step in case.steps:
        last = step.model_copy(update={"signals": {**case.signals, **step.signals}})
        before = last.model_copy(update={"expect": Expectation()})
        steps += [before] * (step.times - 1) + [last]
    return steps


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


def _differences(expect: Expectation, outcome: Outcome) -> Iterator[str]:
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
