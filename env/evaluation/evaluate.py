"""The collision test: drivers drive the same episodes in every cell, and all of it is measured.

Source: paper, section "Model Evaluation".
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, get_args

from env.driving.drivers import Driver
from env.driving.names import Name, name_like
from env.driving.policies import SHIPPED, file_hash, make_driver, policy_file
from env.driving.rollout import DrivenStep, Ending, rollout
from env.driving.setup import DISCOUNT
from env.evaluation import metrics
from env.evaluation.metrics import METRICS, Course, Pooled, Value
from env.evaluation.parallel import in_order
from env.evaluation.statistics import Mean
from env.street.crossing import OccludedCrossing
from env.street.seeds import FINAL_TEST
from env.street.variants import QuietStreet
from env.street.view import Street
from env.world.cells import Cell, CellOcclusion, Traffic
from sfol.knowledge_base import KnowledgeBase
from sfol.logs import LoggedStep

FIRST_SEED = FINAL_TEST.start


@dataclass(frozen=True)
class Settings:
    """Everything that decides what comes of a drive; equal settings, equal results.

    Attributes:
        driver: name of a scripted driver, or what a policy is called.
        policy: hash of the policy file; None for a scripted driver.
        traffic: of the cell.
        occlusion: of the cell.
        hazard: whether people cross.
        perception: where facts come from.
        episodes: how many.
        seed: of the first one.
        knowledge_base: its name.
        knowledge_base_hash: of its content.
        discount: γ of discounted returns.
    """

    driver: Name
    policy: str | None
    traffic: Traffic
    occlusion: CellOcclusion
    hazard: bool
    perception: Name
    episodes: int
    seed: int
    knowledge_base: str
    knowledge_base_hash: str
    discount: float


@dataclass(frozen=True, eq=False)
class Drive:
    """A driver in a cell.

    Attributes:
        driver: name of a driver, or path of a policy file; see `env.driving.policies.make_driver`.
        cell: of the street.
        rules: what rewards; nobody drives by them.
        episodes: how many.
        seed: of the first one; the others follow.
        perception: where facts come from; see `OccludedCrossing`.
        hazard: whether people cross; else nobody does.
        trust: whether a policy file may lie outside the project's folder.
        name: what a policy is called in the results; by default after its file and its hash.
        discount: γ of discounted returns.
    """

    driver: str
    cell: Cell
    rules: KnowledgeBase
    episodes: int = 100
    seed: int = FIRST_SEED
    perception: str = "simulator"
    hazard: bool = True
    trust: bool = False
    name: str = ""
    discount: float = DISCOUNT

    @property
    def seeds(self) -> range:
        """Of its episodes."""
        return range(self.seed, self.seed + self.episodes)

    @cached_property
    def settings(self) -> Settings:
        """What decides the results, in a form that can be compared and written."""
        file = policy_file(self.driver)
        policy = file_hash(file) if file else None
        called = (
            f"{name_like(file.stem)}-{policy}"
            if file and self.driver not in SHIPPED
            else self.driver
        )
        return Settings(
            driver=self.name or called,
            policy=policy,
            traffic=self.cell.traffic,
            occlusion=self.cell.occlusion,
            hazard=self.hazard,
            perception=self.perception,
            episodes=self.episodes,
            seed=self.seed,
            knowledge_base=self.rules.name,
            knowledge_base_hash=self.rules.hash,
            discount=self.discount,
        )

    def street(self) -> OccludedCrossing:
        """Build the street."""
        kind = OccludedCrossing if self.hazard else QuietStreet
        return kind(
            traffic=self.cell.traffic,
            occlusion=self.cell.occlusion,
            perception=self.perception,
            observation="state",
            rules=self.rules,
        )


@dataclass(frozen=True)
class EpisodeResult:
    """What was measured of an episode.

    Attributes:
        seed: of the episode.
        behaviour: of the one who crosses before ego.
        ending: how it ended.
        steps: how many control steps it had.
        seconds: how long it took.
        measured: metric → its number; None where the episode has none.
        total: Σ r, the return.
        discounted: Σ γ^k r.
        fluctuation: weight → total variation, in 1/s.
        heads: head → number of steps in which its confidence was above zero.
        rules: rule → number of steps in which it concluded something.
    """

    seed: int
    behaviour: str
    ending: Ending
    steps: int
    seconds: float
    measured: Mapping[str, Value]
    total: float
    discounted: float
    fluctuation: Mapping[str, float]
    heads: Mapping[str, int]
    rules: Mapping[str, int]


@dataclass(frozen=True)
class DrivenEpisode:
    """An episode's measures, and its log if one was asked for."""

    result: EpisodeResult
    log: tuple[LoggedStep, ...] = ()


@dataclass(frozen=True)
class Summary:
    """What was measured of the episodes of a driver in a cell.

    Attributes:
        steps: of all episodes together.
        measured: metric → what its row in `env.evaluation.metrics.METRICS` makes of all episodes.
            A summary that was made before there was a metric lacks it.
        total: ending → mean return of the episodes that ended so.
        discounted: ending → mean discounted return of those.
        fluctuation: weight → mean total variation, in 1/s.
        heads: head → share of steps in which its confidence was above zero.
        rules: rule → share of steps in which it concluded something.
    """

    steps: int
    measured: Mapping[str, Pooled]
    total: Mapping[Ending, Mean]
    discounted: Mapping[Ending, Mean]
    fluctuation: Mapping[str, Mean]
    heads: Mapping[str, float]
    rules: Mapping[str, float]


def evaluate(
    drives: Sequence[Drive], *, workers: int = 1, logs: bool = False
) -> Iterator[DrivenEpisode]:
    """Drive all episodes of all drives, and yield them in their order.

    What comes of an episode depends on its drive and its seed alone.

    Args:
        drives: drivers in cells.
        workers: how many processes drive.
        logs: whether facts and signals of every step are kept.

    Raises:
        SfolError: a driver or a street can't be made, or a worker was killed.
    """
    jobs = [_Job(drive, seed, logs) for drive in drives for seed in drive.seeds]
    try:
        yield from in_order(_do, jobs, workers)
    finally:
        _workplace.leave()


def drive_episode(
    street: Street,
    driver: Driver,
    seed: int,
    *,
    discount: float = DISCOUNT,
    logs: bool = False,
) -> DrivenEpisode:
    """Drive one episode and return its measures; no frame is kept.

    Args:
        street: the environment; it is reset.
        driver: chooses the actions; it is reset.
        seed: decides everything that the environment draws.
        discount: γ of the discounted return.
        logs: whether facts and signals of every step are kept.
    """
    steps: list[_Step] = []
    log: list[LoggedStep] = []
    for driven in rollout(street, driver, seed):
        steps.append(_Step.of(driven))
        if logs:
            log.append(LoggedStep(driven.time, driven.scene.facts, driven.signals))
    return DrivenEpisode(_measured(street, seed, steps, driven, discount), tuple(log))


def summarize(results: Sequence[EpisodeResult]) -> Summary:
    """Return the summary of episodes under one knowledge base."""
    steps = sum(result.steps for result in results)

    def by_ending(name: str) -> dict[Ending, Mean]:
        return {
            ending: Mean.over(getattr(r, name) for r in results if r.ending == ending)
            for ending in get_args(Ending)
        }

    def of_steps(name: str) -> dict[str, float]:
        counts: Counter[str] = Counter()
        for result in results:
            counts.update(getattr(result, name))
        return {key: count / steps for key, count in counts.items()}

    weights = dict.fromkeys(name for result in results for name in result.fluctuation)
    return Summary(
        steps=steps,
        measured={
            metric.name: metric.pool([result.measured[metric.name] for result in results], steps)
            for metric in METRICS
        },
        total=by_ending("total"),
        discounted=by_ending("discounted"),
        fluctuation={w: Mean.over(r.fluctuation[w] for r in results) for w in weights},
        heads=of_steps("heads"),
        rules=of_steps("rules"),
    )


class _Step(NamedTuple):
    """The numbers of a step that are kept until its episode ends."""

    speed: float
    speed_next: float
    distance: float
    ttc: float
    crosswalk_free: bool
    reward: float
    weights: Mapping[str, float]
    heads: Sequence[str]
    rules: frozenset[str]

    @classmethod
    def of(cls, driven: DrivenStep) -> _Step:
        info, confidences = driven.info, driven.outcome.confidences
        return cls(
            speed=driven.speed,
            speed_next=info["speed"],
            distance=info["distance"],
            ttc=info["ttc"],
            crosswalk_free=driven.crosswalk_free,
            reward=driven.outcome.reward,
            weights=driven.outcome.weights,
            heads=[head for head, confidence in confidences.items() if confidence > 0.0],
            rules=driven.outcome.fired,
        )


def _measured(
    street: Street, seed: int, steps: Sequence[_Step], last: DrivenStep, discount: float
) -> EpisodeResult:
    kb, dt = street.pipeline.kb, street.control_dt
    course = Course(
        dt=dt,
        speeds=[steps[0].speed, *(step.speed_next for step in steps)],
        distances=[step.distance for step in steps],
        ttcs=[step.ttc for step in steps],
        crosswalk_free=[step.crosswalk_free for step in steps],
        ending=last.ending,
        info=last.info,
    )
    rewards = [step.reward for step in steps]
    heads = Counter(head for step in steps for head in step.heads)
    rules = Counter(rule for step in steps for rule in step.rules)
    return EpisodeResult(
        seed=seed,
        behaviour=street.behaviour,
        ending=course.ending,
        steps=len(steps),
        seconds=course.seconds,
        measured={metric.name: metric.of(course) for metric in METRICS},
        total=sum(rewards),
        discounted=metrics.discounted_return(rewards, discount),
        fluctuation={w: metrics.fluctuation([s.weights[w] for s in steps], dt) for w in kb.weights},
        heads={head: heads[head] for head in kb.heads},
        rules={rule: rules[rule] for rule in kb.rules},
    )


class _Job(NamedTuple):
    drive: Drive
    seed: int
    logs: bool


class _Workplace:
    """Street and driver of this process. Expensive to build, they are kept for the next job."""

    def __init__(self) -> None:
        self._settings: Settings | None = None

    def enter(self, drive: Drive) -> tuple[OccludedCrossing, Driver]:
        """Return the street and the driver of a drive."""
        if drive.settings != self._settings:
            self.leave()
            self._driver = make_driver(drive.driver, trust=drive.trust)
            self._street = drive.street()
            self._settings = drive.settings
        return self._street, self._driver

    def leave(self) -> None:
        """Close the street, if there is one."""
        if self._settings is not None:
            self._street.close()
            self._settings = None


_workplace = _Workplace()


def _do(job: _Job) -> DrivenEpisode:
    street, driver = _workplace.enter(job.drive)
    return drive_episode(street, driver, job.seed, discount=job.drive.discount, logs=job.logs)
