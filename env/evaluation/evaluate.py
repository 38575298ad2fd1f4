"""The collision test: drivers drive the same episodes in every cell, and all of it is measured.

Source: paper, section "Model Evaluation".
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, get_args

from env.driving.drivers import Driver
from env.driving.policies import TRAINED, file_hash, make_driver, policy_file
from env.driving.rollout import Ending, Transition, rollout
from env.driving.setup import DISCOUNT
from env.evaluation import metrics
from env.evaluation.parallel import in_order
from env.evaluation.statistics import Mean, Share
from env.street.crossing import OccludedCrossing
from env.street.variants import QuietStreet
from env.world import kinematics
from env.world.cells import Cell
from sfol.knowledge_base import KnowledgeBase
from sfol.logs import LoggedStep

FIRST_SEED = 10_000  # of evaluation; nothing is ever tuned or trained on these seeds


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

    driver: str
    policy: str | None
    traffic: str
    occlusion: str
    hazard: bool
    perception: str
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
        called = f"{file.stem}-{policy}" if file and self.driver != TRAINED else self.driver
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
    """What was measured of an episode. None stands for "it has none".

    Attributes:
        seed: of the episode.
        behaviour: of the one who crosses before ego.
        ending: how it ended.
        steps: how many control steps it had.
        seconds: how long it took.
        stopping_distance: see `kinematics.stopping_distance`, in m.
        rms_speed: over all instants, in m/s.
        rms_acceleration: over all steps, in m/s².
        rms_jerk: over all pairs of steps, in m/s³.
        min_ttc: smallest time to collision, in s; 0 on contact.
        impact_speed: ego's speed at the contact, in m/s.
        false_braking: number of steps; see `metrics.false_braking`.
        contact_at_rest: instants at which somebody touched ego while it stood.
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
    stopping_distance: float | None
    rms_speed: float
    rms_acceleration: float
    rms_jerk: float | None
    min_ttc: float | None
    impact_speed: float | None
    false_braking: int
    contact_at_rest: int
    total: float
    discounted: float
    fluctuation: Mapping[str, float]
    heads: Mapping[str, int]
    rules: Mapping[str, int]

    @property
    def near_miss(self) -> bool:
        """Whether a collision was less than 2 s away, and there was none."""
        near = self.min_ttc is not None and self.min_ttc <= metrics.NEAR_MISS
        return near and self.ending != "collision"


@dataclass(frozen=True)
class DrivenEpisode:
    """An episode's measures, and its log if one was asked for."""

    result: EpisodeResult
    log: tuple[LoggedStep, ...] = ()


@dataclass(frozen=True)
class Summary:
    """What was measured of the episodes of a driver in a cell.

    Rates have Wilson's 95 % interval. Means are over those episodes that have the number, and say
    how many those are.

    Attributes:
        steps: of all episodes together.
        success: share of episodes.
        collision: share of episodes.
        timeout: share of episodes.
        near_miss: share of episodes whose smallest time to collision is at most 2 s, without
            collision.
        false_braking: share of all steps; see `metrics.false_braking`. Its interval takes steps
            for independent, which neighbours are not.
        stopping_distance: over episodes with a stop for somebody, in m.
        rms_speed: mean of the episodes', in m/s.
        rms_acceleration: mean of the episodes', in m/s².
        rms_jerk: mean of the episodes', in m/s³.
        min_ttc: over episodes in which somebody was in the way, in s.
        impact_speed: over collisions, in m/s.
        time_to_goal: over successes, in s.
        contact_at_rest: over all episodes, of how many instants somebody touched a standing ego.
        total: ending → mean return of the episodes that ended so.
        discounted: ending → mean discounted return of those.
        fluctuation: weight → mean total variation, in 1/s.
        heads: head → share of steps in which its confidence was above zero.
        rules: rule → share of steps in which it concluded something.
    """

    steps: int
    success: Share
    collision: Share
    timeout: Share
    near_miss: Share
    false_braking: Share
    stopping_distance: Mean
    rms_speed: Mean
    rms_acceleration: Mean
    rms_jerk: Mean
    min_ttc: Mean
    impact_speed: Mean
    time_to_goal: Mean
    contact_at_rest: int
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
    street: OccludedCrossing,
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
    reward = street.pipeline.reward
    steps: list[_Step] = []
    log: list[LoggedStep] = []
    for transition in rollout(street, driver, seed):
        facts = transition.scene.facts
        steps.append(_Step.of(transition, reward.conclude(facts).fired))
        if logs:
            log.append(LoggedStep(transition.time, facts, transition.signals))
    return DrivenEpisode(_measured(street, seed, steps, transition, discount), tuple(log))


def summarize(results: Sequence[EpisodeResult]) -> Summary:
    """Return the summary of episodes under one knowledge base."""
    steps = sum(result.steps for result in results)

    def share(ending: Ending) -> Share:
        return Share.over(result.ending == ending for result in results)

    def mean(name: str) -> Mean:
        return Mean.over(getattr(result, name) for result in results)

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
        success=share("success"),
        collision=share("collision"),
        timeout=share("timeout"),
        near_miss=Share.over(result.near_miss for result in results),
        false_braking=Share.out_of(sum(result.false_braking for result in results), steps),
        stopping_distance=mean("stopping_distance"),
        rms_speed=mean("rms_speed"),
        rms_acceleration=mean("rms_acceleration"),
        rms_jerk=mean("rms_jerk"),
        min_ttc=mean("min_ttc"),
        impact_speed=mean("impact_speed"),
        time_to_goal=Mean.over(r.seconds for r in results if r.ending == "success"),
        contact_at_rest=sum(result.contact_at_rest for result in results),
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
    def of(cls, transition: Transition, rules: frozenset[str]) -> _Step:
        info, confidences = transition.info, transition.parts("confidence_")
        return cls(
            speed=transition.speed,
            speed_next=info["speed"],
            distance=info["distance"],
            ttc=info["ttc"],
            crosswalk_free=transition.crosswalk_free,
            reward=transition.reward,
            weights=transition.parts("weight_"),
            heads=[head for head, confidence in confidences.items() if confidence > 0.0],
            rules=rules,
        )


def _measured(
    street: OccludedCrossing, seed: int, steps: Sequence[_Step], last: Transition, discount: float
) -> EpisodeResult:
    kb, dt, info = street.pipeline.kb, street.control_dt, last.info
    speeds = [steps[0].speed, *(step.speed_next for step in steps)]
    accelerations = kinematics.rate(speeds, dt)
    rewards = [step.reward for step in steps]
    heads = Counter(head for step in steps for head in step.heads)
    rules = Counter(rule for step in steps for rule in step.rules)
    return EpisodeResult(
        seed=seed,
        behaviour=street.behaviour,
        ending=last.ending,
        steps=len(steps),
        seconds=len(steps) * dt,
        stopping_distance=_known(info["stopping_distance"]),
        rms_speed=kinematics.rms(speeds),
        rms_acceleration=kinematics.rms(accelerations),
        rms_jerk=_known(kinematics.rms(kinematics.rate(accelerations, dt))),
        min_ttc=_known(min(step.ttc for step in steps)),
        impact_speed=info["speed"] if info["collision"] else None,
        false_braking=metrics.false_braking(
            accelerations,
            [step.distance for step in steps],
            [step.crosswalk_free for step in steps],
        ),
        contact_at_rest=info["contact_at_rest"],
        total=sum(rewards),
        discounted=metrics.discounted_return(rewards, discount),
        fluctuation={w: metrics.fluctuation([s.weights[w] for s in steps], dt) for w in kb.weights},
        heads={head: heads[head] for head in kb.heads},
        rules={rule: rules[rule] for rule in kb.rules},
    )


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None


class _Job(NamedTuple):
    drive: Drive
    seed: int
    logs: bool


class _Workplace:
    """Street and driver of this process. They are dear to build, and so kept for the next job."""

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
