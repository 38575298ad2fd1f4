"""From camera frames to scenes: the one place where perception and reward are put together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

import sfol
from sfol.engines.conclusions import Conclusions
from sfol.errors import UsageError
from sfol.temporal import Memory
from vsr.entities import ClassMap, Entity, class_map, find_entities
from vsr.facts import scene_facts
from vsr.grounding import SegmentationGrounding
from vsr.segmentation import Frame, Segmenter, SimulatorSegmenter
from vsr.tracking import Tracker

# Takes the entities of one picture and returns them, in their order, with the names to use.
Naming = Callable[[Sequence[Entity]], tuple[Entity, ...]]


@dataclass(frozen=True, eq=False)
class Scene:
    """What perception makes of one frame.

    Attributes:
        entities: pedestrians, vehicles, trucks and crosswalks that are seen.
        facts: what they say about the scene.
        conclusions: what follows from the facts.
        class_map: uint8 (H, W), the segmenter's most likely class of each pixel; None where the
            facts come from no picture.
    """

    entities: tuple[Entity, ...]
    facts: sfol.Facts
    conclusions: Conclusions
    class_map: ClassMap | None = None

    @property
    def classes(self) -> ClassMap:
        """The class map.

        Raises:
            UsageError: there is none.
        """
        if self.class_map is None:
            raise UsageError(
                "perception 'truth' makes no class map", name="truth", suggestion="simulator"
            )
        return self.class_map


class ScenePipeline:
    """Segmenter, entities, facts and reward of one knowledge base.

    Args:
        rules: a knowledge base, the path of one, or the name of a bundled one.
        segmenter: makes segmentation maps of frames; the simulator's own by default.

    Attributes:
        kb: the knowledge base.
        reward: its reward function.
        grounding: how facts are read off a segmentation map.

    Raises:
        InvalidKnowledgeBase: the rules have errors.
    """

    def __init__(
        self,
        rules: sfol.KnowledgeBase | str | Path = "crossing",
        segmenter: Segmenter | None = None,
    ) -> None:
        self.reward = sfol.RewardFunction(rules)
        self.kb = self.reward.kb
        self.grounding = self.kb.grounding_of("segmentation", SegmentationGrounding)
        self._segmenter = segmenter or SimulatorSegmenter()
        self._remembers = self.kb.has_memory

    def naming(self, step: float) -> Naming:
        """Return what names the entities of an episode, picture after picture.

        By the knowledge base's ``grounding.segmentation.tracking`` they keep their names; without
        it the names count within each picture.

        Args:
            step: from one picture to the next, in s.
        """
        tracking = self.grounding.tracking
        return tuple if tracking is None else Tracker(tracking, step)

    def perceive(self, frames: Sequence[Frame], naming: Naming = tuple) -> list[Scene]:
        """Return the scene of each frame; the segmenter runs once for all of them.

        Args:
            frames: B frames; with a naming they follow each other in one episode.
            naming: of that episode. Without any, names count within each picture.
        """
        return [self._read(segmented, naming) for segmented in self._segmenter(frames)]

    def scene(
        self, entities: tuple[Entity, ...], facts: sfol.Facts, classes: ClassMap | None = None
    ) -> Scene:
        """Return the scene of what was seen; this is where its conclusions are drawn, once."""
        return Scene(entities, facts, self.conclude(facts), classes)

    def conclude(self, facts: sfol.Facts) -> Conclusions:
        """Return what follows from the facts of a scene alone.

        Rules over time take it for the first of an episode; a street, which knows what came before,
        puts its own conclusions in the place of these.
        """
        if self._remembers:
            return self.reward.conclude_after(facts, Memory())
        return self.reward.conclude(facts)

    def _read(self, segmented: NDArray[Any], naming: Naming) -> Scene:
        classes = class_map(segmented)
        entities = naming(find_entities(segmented, self.grounding.minimum_area, classes))
        facts = scene_facts(entities, classes, self.grounding, self.reward.facts(), self.kb.subject)
        return self.scene(entities, facts, classes)
