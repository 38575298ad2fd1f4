"""Episodes recorded with everything that a report shows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import torch

from env.demo.episode import Episode, SeenEntity, Step
from env.driving.drivers import Driver
from env.driving.rollout import DrivenStep, rollout
from env.street.crossing import OccludedCrossing
from sfol.facts import Facts
from sfol.knowledge_base import KnowledgeBase
from sfol.logs import LogWriter
from sfol.syntax import Atom
from vsr.classes import DYNAMIC_CLASSES
from vsr.hypervectors.codebook import Codebook
from vsr.hypervectors.descriptor import SceneDescriptor

Progress = Callable[[Step], None]


def drive(
    street: OccludedCrossing,
    driver: Driver,
    seed: int,
    *,
    name: str,
    progress: Progress = lambda step: None,
) -> Episode:
    """Drive one episode and record every step of it.

    Args:
        street: the environment; it is reset.
        driver: chooses the actions; it is reset.
        seed: decides everything that the environment draws.
        name: the driver's name, for the record.
        progress: called after every step.

    Returns:
        The episode, from reset to its end.
    """
    descriptor = SceneDescriptor(Codebook(), street.pipeline.grounding)
    steps: list[Step] = []
    for driven in rollout(street, driver, seed, frames_every=1):
        steps.append(_recorded(driven, street, descriptor))
        progress(steps[-1])
    return Episode(
        driver=name,
        traffic=street.traffic,
        occlusion=street.occlusion,
        behaviour=street.behaviour,
        seed=seed,
        control_dt=street.control_dt,
        steps=tuple(steps),
        ending=driven.ending,
        info=dict(driven.info),
    )


def _recorded(driven: DrivenStep, street: OccludedCrossing, descriptor: SceneDescriptor) -> Step:
    scene, frame, reward = driven.scene, driven.frame, street.pipeline.reward
    assert frame is not None  # it was asked for
    weights = reward.entity_weights(scene.conclusions, [entity.name for entity in scene.entities])
    about = _atoms_by_entity(scene.facts)
    moving = [weights[entity.name] for entity in scene.entities if entity.kind in DYNAMIC_CLASSES]
    with torch.inference_mode():
        vectors = descriptor.ssi(scene.entities, scene.classes)
        bundle = descriptor.bundle(vectors, moving)
    return Step(
        time=driven.time,
        position=driven.position,
        speed=driven.speed,
        speed_next=driven.info["speed"],
        action=driven.action,
        distance=driven.info["distance"],
        ttc=driven.info["ttc"],
        frame=frame.gray,
        classes=scene.classes,
        entities=tuple(
            SeenEntity(
                name=entity.name,
                kind=entity.kind.name.lower(),
                confidence=entity.confidence,
                box=entity.box,
                weight=weights[entity.name],
                facts=about.get(entity.name, ()),
            )
            for entity in scene.entities
        ),
        facts=str(scene.facts),
        reward=driven.outcome.reward,
        terms=dict(driven.outcome.terms),
        weights=dict(driven.outcome.weights),
        confidences=dict(driven.outcome.confidences),
        descriptor=bundle.numpy(),
    )


def most_dangerous(episodes: Sequence[Episode]) -> tuple[int, int]:
    """Return the episode and the step of the most dangerous moment.

    A contact comes first; without one it is the smallest time to collision, and without any of
    that the smallest distance.

    Args:
        episodes: at least one, each with at least one step.
    """
    moments = [(i, j) for i, episode in enumerate(episodes) for j in range(len(episode.steps))]

    def danger(moment: tuple[int, int]) -> tuple[bool, float, float]:
        episode = episodes[moment[0]]
        step = episode.steps[moment[1]]
        contact = episode.ending == "collision" and step is episode.steps[-1]
        return not contact, step.ttc, step.distance

    return min(moments, key=danger)


def coverage(episodes: Iterable[Episode], heads: Iterable[str]) -> dict[str, int]:
    """Return for every head in how many steps its confidence was above zero."""
    steps = [step for episode in episodes for step in episode.steps]
    return {head: sum(step.confidences.get(head, 0.0) > 0.0 for step in steps) for head in heads}


def write_log(path: Path, episodes: Iterable[Episode], kb: KnowledgeBase) -> None:
    """Write facts and signals of every step, for ``sfol diff --log`` and ``sfol replay``.

    Args:
        path: the file, which is replaced if it exists.
        episodes: driven under the knowledge base.
        kb: the knowledge base.
    """
    with LogWriter(path, kb) as log:
        for episode in episodes:
            for step in episode.steps:
                facts = Facts.parse(step.facts, margin=kb.grounding.margin)
                log.step(facts, step.time, **signals_of(step))
            log.end_episode(episode.ending)


def signals_of(step: Step) -> dict[str, float]:
    """Return the signals that a step's reward was computed from."""
    return {"v": step.speed, "v_next": step.speed_next, "d": step.distance}


def _atoms_by_entity(facts: Iterable[Atom]) -> dict[str, tuple[str, ...]]:
    atoms: dict[str, list[str]] = {}
    for atom in facts:
        for entity in dict.fromkeys(atom.arguments):
            atoms.setdefault(entity, []).append(str(atom))
    return {entity: tuple(texts) for entity, texts in atoms.items()}
