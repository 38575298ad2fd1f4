"""How good a segmenter is: IoU by class and distance, and the facts that come of its maps.

Distances are in m before the lens, by the pinhole camera of the frames. A pixel of the ground has
the distance of the road in its row. A pixel of a pedestrian, vehicle or truck has the distance of
the road where the lowest pixel of its body is. A pixel that is wrongly taken for such a thing has
the distance of the lowest pixel of the cluster that it makes the segmenter see.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sfol.facts import Facts
from vsr.classes import DESCRIPTOR_CLASSES, DYNAMIC_CLASSES
from vsr.entities import ClassMap, class_map, find_entities
from vsr.facts import Pinhole, scene_facts
from vsr.grounding import SegmentationGrounding
from vsr.segmentation import Frame, Segmenter

BANDS = ((0.0, 15.0), (15.0, 30.0), (30.0, 45.0), (45.0, np.inf))
BAND_NAMES = ("0-15 m", "15-30 m", "30-45 m", "beyond")

_BATCH = 8
Counts = NDArray[np.int64]


@dataclass
class SegmentationCounts:
    """Pixels counted over many frames, and facts over the same frames.

    Attributes:
        both: int64 (6, 4), pixels of each descriptor class in each of `BANDS` that were found.
        missed: int64 (6, 4), pixels of the class that were taken for something else.
        invented: int64 (6, 4), pixels of something else that were taken for the class.
        facts: predicate to how often it held of any entity in truth and in the segmenter's eyes,
            in truth alone, and in the segmenter's eyes alone.
    """

    both: Counts
    missed: Counts
    invented: Counts
    facts: dict[str, list[int]]


def count(
    segmenter: Segmenter, frames: Sequence[Frame], grounding: SegmentationGrounding
) -> Iterator[SegmentationCounts]:
    """Yield the counts of batch after batch; `total` adds them up.

    Args:
        segmenter: what is to be judged.
        frames: with the simulator's class and instance maps.
        grounding: the camera of the frames, and how facts are read off a map.
    """
    for start in range(0, len(frames), _BATCH):
        batch = frames[start : start + _BATCH]
        for frame, segmented in zip(batch, segmenter(batch), strict=True):
            yield _count_frame(frame, segmented, grounding)


def total(counts: Iterable[SegmentationCounts]) -> SegmentationCounts:
    """Return the sum of counts."""
    shape = len(DESCRIPTOR_CLASSES), len(BANDS)
    both, missed, invented = (np.zeros(shape, np.int64) for _ in range(3))
    facts: dict[str, list[int]] = {}
    for part in counts:
        both += part.both
        missed += part.missed
        invented += part.invented
        for predicate, numbers in part.facts.items():
            sums = facts.setdefault(predicate, [0, 0, 0])
            facts[predicate] = [a + b for a, b in zip(sums, numbers, strict=True)]
    return SegmentationCounts(both, missed, invented, facts)


def iou_table(counts: SegmentationCounts) -> dict[str, dict[str, float]]:
    """Return IoU by class and band, over all distances, and the means over classes.

    IoU = found / (found + missed + invented), over all pixels of all frames; nan where a class
    neither occurs nor is found.
    """
    union = counts.both + counts.missed + counts.invented
    with np.errstate(invalid="ignore"):
        by_band = counts.both / union
        overall = counts.both.sum(axis=1) / union.sum(axis=1)
        # as far as the rules look
        near = counts.both[:, :3].sum(axis=1) / union[:, :3].sum(axis=1)
    columns = [*by_band.T, near, overall]
    names = [*BAND_NAMES, "0-45 m", "all"]
    rows = [kind.name.lower() for kind in DESCRIPTOR_CLASSES]
    table = {
        row: {name: float(column[i]) for name, column in zip(names, columns, strict=True)}
        for i, row in enumerate(rows)
    }
    means = {name: float(np.mean(column)) for name, column in zip(names, columns, strict=True)}
    return {**table, "mean": means}


def fact_table(counts: SegmentationCounts) -> dict[str, dict[str, float]]:
    """Return precision and recall of "the predicate holds of some entity", frame by frame.

    Precision is nan for what the segmenter never made hold, recall for what never held.
    """
    return {
        predicate: {
            "precision": _share(both, invented),
            "recall": _share(both, missed),
            "frames": both + missed,
        }
        for predicate, (both, missed, invented) in sorted(counts.facts.items())
    }


def _share(part: int, rest: int) -> float:
    return part / (part + rest) if part + rest else float("nan")


def _count_frame(
    frame: Frame, segmented: NDArray[Any], grounding: SegmentationGrounding
) -> SegmentationCounts:
    pinhole = Pinhole.of(grounding.camera, frame.classes.shape)
    found = class_map(segmented)
    shape = len(DESCRIPTOR_CLASSES), len(BANDS)
    both, missed, invented = (np.zeros(shape, np.int64) for _ in range(3))
    by_row = np.array([_band(pinhole.distance(row + 0.5)) for row in range(found.shape[0])])
    ground = np.repeat(by_row[:, None], found.shape[1], axis=1)
    for i, kind in enumerate(DESCRIPTOR_CLASSES):
        truth, seen = frame.classes == kind, found == kind
        if kind in DYNAMIC_CLASSES:
            bodies = np.where(truth, frame.instances + 1, 0)
            clusters, _ = ndimage.label(seen)
            true_bands, seen_bands = _bands(bodies, pinhole), _bands(clusters, pinhole)
        else:
            true_bands = seen_bands = ground
        both[i] = _histogram(true_bands[truth & seen])
        missed[i] = _histogram(true_bands[truth & ~seen])
        invented[i] = _histogram(seen_bands[seen & ~truth])
    true_facts = _predicates(frame.classes, frame.classes, grounding)
    seen_facts = _predicates(segmented, found, grounding)
    facts = {
        predicate: [
            int(predicate in true_facts and predicate in seen_facts),
            int(predicate not in seen_facts),
            int(predicate not in true_facts),
        ]
        for predicate in true_facts | seen_facts
    }
    return SegmentationCounts(both, missed, invented, facts)


def _bands(labels: NDArray[np.integer[Any]], pinhole: Pinhole) -> NDArray[np.int64]:
    """Return the band of every labelled pixel: that of its label's lowest row."""
    bands = np.zeros(int(labels.max()) + 1, np.int64)
    for number, area in enumerate(ndimage.find_objects(labels), start=1):
        if area is not None:
            bands[number] = _band(pinhole.distance(area[0].stop))
    banded: NDArray[np.int64] = bands[labels]
    return banded


def _band(distance: float) -> int:
    return next(i for i, (_, end) in enumerate(BANDS) if distance < end or end == np.inf)


def _histogram(bands: NDArray[np.int64]) -> Counts:
    counts: Counts = np.bincount(bands, minlength=len(BANDS))
    return counts


def _predicates(
    segmented: NDArray[Any], classes: ClassMap, grounding: SegmentationGrounding
) -> set[str]:
    entities = find_entities(segmented, grounding.minimum_area, classes)
    facts = scene_facts(entities, classes, grounding, Facts())
    return set(facts.predicates())
