"""Hand-made segmentation maps for the tests."""

from __future__ import annotations

import numpy as np

from sfol.facts import Facts
from vsr.classes import CLASS_COUNT, SemanticClass
from vsr.entities import find_entities
from vsr.facts import scene_facts
from vsr.grounding import SegmentationGrounding

SIZE = 224
HORIZON = SIZE // 2

# A lens of 90° over a road of two lanes: the focal length is 112 px, so that with 1.5 m of height
# the road Z m ahead is 168 / Z px below the horizon.
GROUNDING = SegmentationGrounding.model_validate(
    {"camera": {"fov": 90, "height": 1.5}, "approaching": [8, 40], "road": [-5, 5]}
)


class Painting:
    """A class map on which rectangles are painted over one another."""

    def __init__(self, size: int = SIZE) -> None:
        self.classes = np.full((size, size), SemanticClass.SKY, np.uint8)

    def rectangle(
        self, kind: SemanticClass, rows: tuple[int, int], columns: tuple[int, int]
    ) -> Painting:
        self.classes[slice(*rows), slice(*columns)] = kind
        return self

    @property
    def one_hot(self) -> np.ndarray:
        return np.eye(CLASS_COUNT, dtype=np.float32)[self.classes].transpose(2, 0, 1).copy()

    def entities(self, minimum_area: int = 1):
        return find_entities(self.one_hot, minimum_area)

    def facts(self, grounding: SegmentationGrounding = GROUNDING) -> Facts:
        return scene_facts(self.entities(), self.classes, grounding, Facts())


def street() -> Painting:
    """A road from edge to edge below the horizon, with sidewalks left and right."""
    return (
        Painting()
        .rectangle(SemanticClass.ROAD, (HORIZON, SIZE), (40, 184))
        .rectangle(SemanticClass.SIDEWALK, (HORIZON, SIZE), (0, 40))
        .rectangle(SemanticClass.SIDEWALK, (HORIZON, SIZE), (184, SIZE))
    )


def atoms(facts: Facts, *predicates: str) -> set[str]:
    """Return the texts of all atoms of these predicates."""
    return {str(atom) for atom in facts if atom.predicate in predicates}
