"""A sweep like Euro NCAP's CPNCO: a child from behind parked vehicles, at many speeds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from env.driving.policies import make_driver
from env.driving.rollout import Ending, rollout
from env.evaluation.parallel import in_order
from env.street.variants import Approach, ChildCrossing
from env.world.kinematics import STANDSTILL
from sfol.knowledge_base import KnowledgeBase
from vsr.json_files import valid_text

SPEEDS = tuple(float(speed) for speed in range(10, 65, 5))  # km/h
IMPACTS = (0.25, 0.5, 0.75)  # of ego's width, from the near side
APPROACHES = tuple(Approach(speed, impact) for speed in SPEEDS for impact in IMPACTS)


@dataclass(frozen=True, eq=False)
class Sweep:
    """A driver and how it comes towards the child.

    Attributes:
        driver: name of a scripted driver, or path of a policy file.
        rules: what rewards; its grounding has the camera.
        approaches: speeds and points of impact.
        perception: where facts come from; see `OccludedCrossing`.
        seed: of the street's looks.
        trust: whether a policy file may lie outside the project's folder.
    """

    driver: str
    rules: KnowledgeBase
    approaches: Sequence[Approach] = APPROACHES
    perception: str = "simulator"
    seed: int = 0
    trust: bool = False


@dataclass(frozen=True)
class ApproachResult:
    """What came of an approach.

    Attributes:
        driver: who drove.
        speed: at which ego came, in km/h.
        impact: where the child would be hit if nobody braked, as a share of ego's width.
        ending: how it ended; a car that never goes on times out.
        impact_speed: of ego at the contact, in km/h; None without one.
        stopped: whether ego came to stand.
    """

    driver: str
    speed: float
    impact: float
    ending: Ending
    impact_speed: float | None
    stopped: bool


def run_sweeps(sweeps: Sequence[Sweep], workers: int = 1) -> Iterator[ApproachResult]:
    """Drive all approaches of all sweeps, and yield what comes of them, in their order.

    Args:
        sweeps: a driver each.
        workers: how many processes drive.

    Raises:
        SfolError: a driver or the street can't be made, or a worker was killed.
    """
    # A street is dear to build, so it serves a run of approaches.
    jobs = [
        (sweep, sweep.approaches[first : first + length])
        for sweep in sweeps
        for length in [-(-len(sweep.approaches) // workers)]
        for first in range(0, len(sweep.approaches), length)
    ]
    for results in in_order(_do, jobs, workers):
        yield from results


def _do(job: tuple[Sweep, Sequence[Approach]]) -> list[ApproachResult]:
    sweep, approaches = job
    driver = make_driver(sweep.driver, trust=sweep.trust)
    street = ChildCrossing(perception=sweep.perception, rules=sweep.rules)
    try:
        results = []
        for approach in approaches:
            street.approach = approach
            stopped = False
            for transition in rollout(street, driver, sweep.seed):
                stopped |= transition.info["speed"] < STANDSTILL
            hit = transition.info["collision"]
            results.append(
                ApproachResult(
                    driver=valid_text(sweep.driver),
                    speed=approach.speed,
                    impact=approach.impact,
                    ending=transition.ending,
                    impact_speed=3.6 * transition.info["speed"] if hit else None,
                    stopped=stopped,
                )
            )
        return results
    finally:
        street.close()
