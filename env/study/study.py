"""The study: setups are trained with several seeds, and driven in every cell, resumably."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import sfol
from env.driving.policies import file_hash, make_driver
from env.driving.rollout import DrivenStep, rollout
from env.driving.setup import Setup, Stage, changed, training_name
from env.evaluation.evaluate import FIRST_SEED, Drive, evaluate
from env.evaluation.results import versions
from env.study.study_results import (
    CurvePoint,
    StudyFolder,
    TrainingResult,
    Trajectory,
)
from env.world.cells import Cell
from sfol.errors import UsageError
from sfol.tools.ray_cluster import on_ray

_CURVE_POINTS = 60  # of a training

# Done so far, of so many, and what they are.
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class StudyPlan:
    """What a study does.

    Attributes:
        setups: to train, each with every seed, by the file or name that they were asked for by.
        seeds: of the trainings.
        cells: in which the policies drive. Of the last one, a trajectory is kept: with all cells
            that is one with high traffic, as in the paper.
        episodes: in each cell.
        in_short: whether setups are cut, see `quick`.
        workers: how many processes drive.
        trainings: folder for checkpoints and policies, one for each setup and seed.
        results: folder for what is found.
        ray: address of a Ray cluster, whose machines see both folders; None: all is done here.
    """

    setups: Mapping[str, Setup]
    seeds: tuple[int, ...]
    cells: tuple[Cell, ...]
    episodes: int
    in_short: bool
    workers: int
    trainings: Path
    results: StudyFolder
    ray: str | None = None


def quick(setup: Setup) -> Setup:
    """Return a setup cut to three updates of PPO: it learns nothing, and shows that all works."""
    update = 64 * setup.streets
    learning = setup.learning.model_copy(
        update={"rollout_steps": update, "batch_size": 64, "value_steps": update}
    )
    return setup.model_copy(
        update={
            "stages": (Stage(steps=3 * update, traffic=("low", "high"), occlusion=("full",)),),
            "checkpoint_steps": update,
            "evaluation_episodes": setup.streets,
            "learning": learning,
        }
    )


def run_study(plan: StudyPlan, progress: Progress) -> None:
    """Train and drive whatever of a plan has no result yet.

    Args:
        plan: what is to be done.
        progress: called with what is being done, how much of it is done, and of how much.

    Raises:
        SfolError: a setup can't be trained, or results can't be written, which shows before
            anything is trained; or what `env.learning.training.train` raises.
    """
    _check(plan)
    trainings = [
        _Training(quick(seeded) if plan.in_short else seeded, _command(plan, source, seed))
        for source, setup in plan.setups.items()
        for seed in plan.seeds
        for seeded in [setup.model_copy(update={"seed": seed})]
    ]
    if plan.ray is None:
        for training in trainings:
            _study_one(plan, training, progress)
        return
    processors = max(setup.streets for setup in plan.setups.values())
    work = partial(_study_there, replace(plan, workers=processors))
    progress("trainings", 0, len(trainings))
    for done, _ in enumerate(on_ray(work, trainings, plan.ray, processors=processors), start=1):
        progress("trainings", done, len(trainings))


class _Training(NamedTuple):
    """A setup with its seed, and what makes its results again."""

    setup: Setup
    command: str


def _study_there(plan: StudyPlan, training: _Training) -> None:
    """Do a part of a study on another machine."""
    _study_one(plan, training, lambda what, done, total: None)


def _check(plan: StudyPlan) -> None:
    """Refuse what would fail later, after hours."""
    setups = list(plan.setups.values())
    for name, count in Counter(setup.name for setup in setups).items():
        if count > 1:
            raise UsageError(
                f"{count} setups are called '{name}', and results go by names",
                name=name,
                suggestion="a name of its own for each",
            )
    seeded = [changed(setup, seed=seed) for setup in setups for seed in plan.seeds]
    for setup in setups:
        sfol.KnowledgeBase.load(*setup.rules)
    plan.results.check([training_name(setup.name, setup.seed) for setup in seeded])


def _study_one(plan: StudyPlan, training: _Training, progress: Progress) -> None:
    setup, command = training
    name = training_name(setup.name, setup.seed)
    rules = sfol.KnowledgeBase.load(*setup.rules)
    if _is_complete(plan, setup, name, rules):
        return
    policy = _trained(plan, setup, rules, command, progress)
    drives = [
        Drive(
            driver=str(policy),
            cell=cell,
            rules=rules,
            episodes=plan.episodes,
            perception=setup.perception,
            name=name,
        )
        for cell in plan.cells
    ]
    _drive(plan, drives, command, progress)
    _record_trajectory(plan, drives[-1], command)


def _is_complete(plan: StudyPlan, setup: Setup, name: str, rules: sfol.KnowledgeBase) -> bool:
    """Tell whether the results of a setup are all there, even if its policy is not."""
    training, trajectory = plan.results.training(name), plan.results.trajectory(name)
    if training is None or trajectory is None or training.setup_hash != setup.hash:
        return False
    drives = [r.settings for r in plan.results.drive_results() if r.settings.driver == name]
    return (
        {(drive.traffic, drive.occlusion) for drive in drives} >= set(plan.cells)
        and {drive.episodes for drive in drives} == {plan.episodes}
        and {drive.policy for drive in drives} == {training.policy, trajectory.policy}
        and {drive.knowledge_base_hash for drive in drives} == {rules.hash}
        and trajectory.knowledge_base_hash == rules.hash
    )


def _trained(
    plan: StudyPlan, setup: Setup, rules: sfol.KnowledgeBase, command: str, progress: Progress
) -> Path:
    """Train a setup unless it is trained, and return its policy."""
    from env.learning.training import train  # noqa: PLC0415  (slow to import, and few need it)

    name = training_name(setup.name, setup.seed)
    trained = train(
        setup,
        plan.trainings / name,
        progress=lambda steps, _: progress(f"{name}: training", steps, setup.steps),
    )
    result = TrainingResult(
        setup=setup.name,
        setup_hash=setup.hash,
        seed=setup.seed,
        steps=trained.steps,
        seconds=trained.seconds,
        knowledge_base=rules.name,
        knowledge_base_hash=rules.hash,
        policy=file_hash(trained.policy),
        command=command,
        versions=versions(),
        evaluations=trained.evaluations,
        curve=tuple(_curve(trained.episodes, setup.steps)),
    )
    known = plan.results.training(name)
    if known is None or (known.policy, known.setup_hash) != (result.policy, result.setup_hash):
        plan.results.write_training(name, result)
    return trained.policy


def _curve(episodes: Sequence[dict[str, float]], steps: int) -> Iterator[CurvePoint]:
    """Yield the means of the episodes in stretches of equal length; empty ones are left out."""
    width = math.ceil(steps / _CURVE_POINTS)
    for end in range(width, steps + width, width):
        some = [row for row in episodes if end - width < row["steps"] <= end]
        if some:
            yield CurvePoint(
                steps=end,
                episodes=len(some),
                total=_mean(some, "return"),
                success=_mean(some, "is_success"),
                collision=_mean(some, "collision"),
                timeout=_mean(some, "timeout"),
            )


def _mean(rows: Sequence[dict[str, float]], name: str) -> float:
    return sum(row[name] for row in rows) / len(rows)


def _command(plan: StudyPlan, source: str, seed: int) -> str:
    """Return what makes a setup's results again."""
    short = " --quick" if plan.in_short else ""
    return f"aeb study --setup {source} --seed {seed} --episodes {plan.episodes}{short}"


def _drive(plan: StudyPlan, drives: Sequence[Drive], command: str, progress: Progress) -> None:
    folder = plan.results.drives
    missing = [drive for drive in drives if folder.find(drive) is None]
    driven = evaluate(missing, workers=plan.workers)
    for drive in missing:
        episodes = []
        for episode in islice(driven, drive.episodes):
            episodes.append(episode)
            progress(f"{drive.name}: {drive.cell}", len(episodes), drive.episodes)
        folder.write(drive, episodes, command)


def _record_trajectory(plan: StudyPlan, drive: Drive, command: str) -> None:
    """Drive the first episode once more, and keep every step of it."""
    known, settings = plan.results.trajectory(drive.name), drive.settings
    if known is not None and (known.policy, known.knowledge_base_hash) == (
        settings.policy,
        settings.knowledge_base_hash,
    ):
        return
    plan.results.write_trajectory(drive.name, trajectory(drive, FIRST_SEED, command))


def trajectory(drive: Drive, seed: int, command: str) -> Trajectory:
    """Drive one episode and return it step by step.

    Args:
        drive: who drives, and where.
        seed: of the episode.
        command: makes the same again.
    """
    street = drive.street()
    try:
        driver = make_driver(drive.driver, trust=drive.trust)
        moments = []
        for step in rollout(street, driver, seed):
            moments.append(_Moment.of(step))
        ending = step.ending
        crosswalk = street.world.geometry.crosswalk
    finally:
        street.close()
    settings = drive.settings
    return Trajectory(
        driver=settings.driver,
        policy=settings.policy,
        traffic=settings.traffic,
        occlusion=settings.occlusion,
        seed=seed,
        ending=ending,
        knowledge_base=settings.knowledge_base,
        knowledge_base_hash=settings.knowledge_base_hash,
        command=command,
        control_dt=street.control_dt,
        crosswalk=crosswalk,
        position=tuple(moment.position for moment in moments),
        speed=tuple(moment.speed for moment in moments),
        action=tuple(moment.action for moment in moments),
        distance=tuple(moment.distance for moment in moments),
        reward=tuple(moment.reward for moment in moments),
        confidences=_columns([moment.confidences for moment in moments]),
        weights=_columns([moment.weights for moment in moments]),
    )


class _Moment(NamedTuple):
    """What a trajectory keeps of a step."""

    position: float
    speed: float
    action: float
    distance: float | None
    reward: float
    confidences: Mapping[str, float]
    weights: Mapping[str, float]

    @classmethod
    def of(cls, step: DrivenStep) -> _Moment:
        distance = step.info["distance"]
        return cls(
            position=step.position,
            speed=step.speed,
            action=step.action,
            distance=distance if math.isfinite(distance) else None,
            reward=step.outcome.reward,
            confidences=step.outcome.confidences,
            weights=step.outcome.weights,
        )


def _columns(rows: Sequence[Mapping[str, float]]) -> dict[str, tuple[float, ...]]:
    return {name: tuple(row[name] for row in rows) for name in rows[0]}
