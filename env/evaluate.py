"""Drive episodes and keep what happened."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from env.crossing import OccludedCrossing
from env.drivers import Driver
from env.episode import Ending, Episode, SeenEntity, Step
from sfol.facts import Facts
from sfol.knowledge_base import KnowledgeBase
from sfol.logs import LogWriter
from sfol.syntax import Atom
from vsr.classes import DYNAMIC_CLASSES
from vsr.codebook import Codebook
from vsr.descriptor import SceneDescriptor

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
    street.reset(seed=seed)
    driver.reset()
    descriptor = SceneDescriptor(Codebook(), street.pipeline.grounding)
    steps: list[Step] = []
    while True:
        seen = _Seen(street, descriptor)
        action = driver(street)
        _, reward, terminated, truncated, info = street.step(np.array([action], np.float32))
        steps.append(seen.step(len(steps) * street.control_dt, action, float(reward), info))
        progress(steps[-1])
        if terminated or truncated:
            break
    return Episode(
        driver=name,
        traffic=street.traffic,
        occlusion=street.occlusion,
        behaviour=street.behaviour,
        seed=seed,
        control_dt=street.control_dt,
        steps=tuple(steps),
        ending=_ending(info),
        info=info,
    )


class _Seen:
    """The state before an action: what the camera shows and what it means."""

    def __init__(self, street: OccludedCrossing, descriptor: SceneDescriptor) -> None:
        scene = street.scene
        reward = street.pipeline.reward
        names = [entity.name for entity in scene.entities]
        weights = reward.entity_weights(scene.facts, names)
        about = _atoms_by_entity(scene.facts)
        moving = [entity.name for entity in scene.entities if entity.kind in DYNAMIC_CLASSES]
        self._speed = street.ego.speed
        self._position = street.ego.position
        self._frame = street.frame.gray
        self._facts = str(scene.facts)
        self._entities = tuple(
            SeenEntity(
                name=entity.name,
                kind=entity.kind.name.lower(),
                confidence=entity.confidence,
                box=entity.box,
                weight=weights[entity.name],
                facts=about.get(entity.name, ()),
            )
            for entity in scene.entities
        )
        with torch.inference_mode():
            vectors = descriptor.ssi(scene.entities, scene.classes)
            bundle = descriptor.bundle(vectors, [weights[name] for name in moving])
        self._descriptor = bundle.numpy()

    def step(self, time: float, action: float, reward: float, info: Mapping[str, Any]) -> Step:
        """Return the whole transition, once it is known what came of the action."""
        return Step(
            time=time,
            position=self._position,
            speed=self._speed,
            speed_next=info["speed"],
            action=action,
            distance=info["distance"],
            ttc=info["ttc"],
            frame=self._frame,
            entities=self._entities,
            facts=self._facts,
            reward=reward,
            terms=_named(info, "reward_"),
            weights=_named(info, "weight_"),
            confidences=_named(info, "confidence_"),
            descriptor=self._descriptor,
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
                log.step(facts, time=step.time, **signals_of(step))
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


def _named(info: Mapping[str, Any], prefix: str) -> dict[str, float]:
    return {
        key.removeprefix(prefix): float(value)
        for key, value in info.items()
        if key.startswith(prefix)
    }


def _ending(info: Mapping[str, Any]) -> Ending:
    if info["collision"]:
        return "collision"
    return "success" if info["is_success"] else "timeout"
