"""Speed of entities, facts and descriptor, and of torchhd doing the descriptor's work.

Every ratio is taken in one run, on one thread.
"""

from __future__ import annotations

import json
from importlib.util import find_spec
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from sfol.facts import Facts
from sfol.tools.bench import median
from vsr.classes import CLASS_COUNT, DESCRIPTOR_CLASSES, DYNAMIC_CLASSES, SemanticClass
from vsr.entities import Direction, class_map, find_entities
from vsr.facts import scene_facts
from vsr.grounding import SegmentationGrounding
from vsr.hypervectors import attention
from vsr.hypervectors.codebook import GRID, Codebook
from vsr.hypervectors.descriptor import Layout, SceneDescriptor
from vsr.hypervectors.fusion import Fusion
from vsr.networks import network_speed
from vsr.segmentation import Frame
from vsr.threads import one_thread

ENTITIES, NEIGHBOURS, CELLS = 12, 3, 20
SIDE = 224
PAIRS = len(DESCRIPTOR_CLASSES) * len(Direction)


def measure() -> dict[str, Any]:
    """Return the median cost of every stage from a segmentation map to the descriptor.

    Returns:
        Times in ms for a scene of twelve entities, with three neighbours and twenty cells each
        where the descriptor starts from given entities; and, where torchhd is installed, how much
        longer it takes for the same vector, bind by bind.
    """
    with one_thread(), torch.inference_mode():
        return {"entities": ENTITIES, **_perception(), **_descriptor()}


def main() -> None:
    """Print the speed of the descriptor and of the networks as JSON."""
    classes = street()
    frame = Frame(classes * 9, classes, np.full(classes.shape, -1, np.int32))
    print(
        json.dumps({"descriptor": measure(), "networks": network_speed.measure([frame])}, indent=2)
    )


def street() -> NDArray[np.uint8]:
    """Return the class map of a street: ten people, a car and a truck, uint8 (224, 224)."""
    classes = np.full((SIDE, SIDE), SemanticClass.SKY, np.uint8)
    classes[100:] = SemanticClass.SIDEWALK
    classes[112:, 40:184] = SemanticClass.ROAD
    classes[150:160, 40:184] = SemanticClass.CROSSWALK
    classes[100:150, 8:38] = SemanticClass.TRUCK
    classes[104:134, 190:222] = SemanticClass.VEHICLE
    for column in np.linspace(42, 180, ENTITIES - 2).astype(int):
        classes[110:152, column : column + 9] = SemanticClass.PEDESTRIAN
    return classes


def layout(seed: int = 0) -> Layout:
    """Return twelve entities with three neighbours and a block of twenty cells each."""
    rng = np.random.default_rng(seed)
    neighbours = np.zeros((ENTITIES, PAIRS), np.bool_)
    coverage = np.zeros((ENTITIES, GRID, GRID), np.float32)
    for found, covered in zip(neighbours, coverage, strict=True):
        found[rng.choice(PAIRS, NEIGHBOURS, replace=False)] = True
        top, left = rng.integers(GRID - 5), rng.integers(GRID - 4)
        covered[top : top + 5, left : left + 4] = rng.uniform(0.05, 1.0, (5, 4))
    return Layout(
        names=tuple(f"entity{number}" for number in range(ENTITIES)),
        kinds=rng.integers(len(DYNAMIC_CLASSES), size=ENTITIES),
        neighbours=neighbours.reshape(ENTITIES, -1, 3),
        coverage=coverage,
        attention=rng.uniform(0.0, 1.0, (ENTITIES, attention.SIZE, attention.SIZE)).astype("f4"),
    )


def _perception() -> dict[str, float]:
    classes, grounding = street(), SegmentationGrounding()
    probabilities = np.eye(CLASS_COUNT, dtype=np.float32)[classes].transpose(2, 0, 1).copy()
    descriptor = SceneDescriptor(Codebook(), grounding)
    entities = find_entities(probabilities, classes=classes)

    def perceive() -> None:
        seen = class_map(probabilities)
        found = find_entities(probabilities, classes=seen)
        scene_facts(found, seen, grounding, Facts())

    return {
        "entities_and_facts_ms": _ms(median(perceive)),
        "layout_ms": _ms(median(lambda: descriptor.layout(entities, classes))),
    }


def _descriptor() -> dict[str, float]:
    scene = layout()
    weights = np.linspace(0.5, 1.0, ENTITIES)
    features = np.random.default_rng(0).random((1, 512, 7, 7), np.float32)
    codebook = Codebook()
    plain = SceneDescriptor(
        codebook, fusion=Fusion("ssi", normalise_parts=False, normalise_entities=False)
    )
    descriptors = {
        "ssi_unscaled": plain,
        "ssi": SceneDescriptor(codebook),
        "add": SceneDescriptor(codebook, fusion="add"),
    }
    figures = {
        name: median(lambda d=descriptor: d.vsr([scene], [weights], features))  # type: ignore[misc]
        for name, descriptor in descriptors.items()
    }
    result = {f"vsr_{name}_ms": _ms(seconds) for name, seconds in figures.items()}
    if find_spec("torchhd") is not None:
        reference = _TorchHd(codebook, scene, weights)
        difference = float((reference.vsr() - plain.vsr([scene], [weights])[0]).abs().max())
        seconds = median(reference.vsr)
        result["torchhd_ms"] = _ms(seconds)
        result["torchhd_over_vsr"] = round(seconds / figures["ssi_unscaled"], 1)
        result["torchhd_difference"] = difference
    return result


class _TorchHd:
    """The same sum of vectors with torchhd: bind by bind, and sums of many vectors at once.

    What is known of the entities lies ready as symbols and numbers.
    """

    def __init__(self, codebook: Codebook, scene: Layout, weights: NDArray[np.float64]) -> None:
        from torchhd import HRRTensor  # noqa: PLC0415  (a tool of the developers)

        classes, directions, cells = (
            part.as_subclass(HRRTensor)
            for part in (codebook.classes, codebook.directions, codebook.cells)
        )
        self._own = [classes[int(kind)] for kind in scene.kinds]
        self._pairs = [
            [(classes[k], directions[d]) for k, d in np.argwhere(found)]
            for found in scene.neighbours
        ]
        self._cells = [cells[torch.from_numpy(covered > 0)] for covered in scene.coverage]
        self._shares = [
            torch.from_numpy(covered[covered > 0])[:, None] for covered in scene.coverage
        ]
        self._weights = torch.from_numpy(weights.astype(np.float32))[:, None]

    def vsr(self) -> torch.Tensor:
        """Return Σ w_i SSI_i, float32 (D,)."""
        scene = zip(self._own, self._pairs, self._cells, self._shares, strict=True)
        return (self._weights * torch.stack([self._ssi(*entity) for entity in scene])).sum(dim=0)

    @staticmethod
    def _ssi(own: Any, pairs: Any, cells: Any, shares: torch.Tensor) -> Any:
        around = sum(other.bind(direction).bind(own) for other, direction in pairs)
        return own.bind(around).bind((shares * cells).multibundle())


def _ms(seconds: float) -> float:
    return round(1e3 * seconds, 3)


if __name__ == "__main__":
    main()
