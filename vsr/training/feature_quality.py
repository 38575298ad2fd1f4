"""How good an autoencoder is: what it draws again, and whether its features tell entities apart."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import normalize

from vsr.classes import DYNAMIC_CLASSES
from vsr.entities import Entity, find_entities
from vsr.grounding import SegmentationGrounding
from vsr.hypervectors.codebook import Codebook
from vsr.hypervectors.descriptor import SceneDescriptor
from vsr.networks.autoencoder import Autoencoder
from vsr.networks.inference import Runner, default_device, stack_gray, to_gray, to_input
from vsr.segmentation import Frame
from vsr.training.autoencoder import psnr
from vsr.training.loop import batches

FEWEST_ENTITIES = 4


class Encoder(Protocol):
    """Whatever turns frames into feature maps."""

    def encode(self, frames: Sequence[Frame]) -> Tensor:
        """Return float32 (B, 512, 7, 7)."""
        ...


@dataclass(frozen=True)
class Retrieval:
    """How often an entity's features found the entity again.

    Attributes:
        queries: entities that were looked for, each among all that are in view one step later.
        found: how many of them were the nearest by cosine similarity.
        gone: entities that were no longer in view, which are not looked for.
        candidates: entities in view one step later, summed over the queries.
    """

    queries: int
    found: int
    gone: int
    candidates: int

    @property
    def rate(self) -> float:
        """Share of queries that found their entity; nan without queries."""
        return self.found / self.queries if self.queries else math.nan

    @property
    def chance(self) -> float:
        """About the rate of guessing, one over the mean number of candidates."""
        return self.queries / self.candidates if self.queries else math.nan


def total(parts: Iterable[Retrieval]) -> Retrieval:
    """Return the sum of retrievals."""
    return reduce(_added, parts, Retrieval(0, 0, 0, 0))


def _added(first: Retrieval, second: Retrieval) -> Retrieval:
    return Retrieval(
        first.queries + second.queries,
        first.found + second.found,
        first.gone + second.gone,
        first.candidates + second.candidates,
    )


def retrieve(
    encoder: Encoder, pairs: Iterable[tuple[Frame, Frame]], grounding: SegmentationGrounding
) -> Iterator[Retrieval]:
    """Yield, pair by pair, how often SF_i of one frame finds the same entity in the next.

    An entity is a cluster of the simulator's class map, as everywhere; it is the same as another
    if most pixels of both belong to the same body. Pairs whose first frame has fewer than four
    moving entities are passed over.

    Args:
        encoder: makes the feature maps.
        pairs: frames, each with that one control step later.
        grounding: how small an entity may be.
    """
    descriptor = SceneDescriptor(Codebook(), grounding, fusion="sf")
    for pair in pairs:
        first, second = (_moving(frame, grounding) for frame in pair)
        if len(first) < FEWEST_ENTITIES or not second:
            continue
        layouts = [
            descriptor.layout(entities, frame.classes)
            for entities, frame in zip((first, second), pair, strict=True)
        ]
        features = descriptor.entities(layouts, encoder.encode(pair))
        yield _compare(
            features[: len(first)],
            features[len(first) :],
            [_body(entity, pair[0]) for entity in first],
            [_body(entity, pair[1]) for entity in second],
        )


def _compare(first: Tensor, second: Tensor, bodies: list[int], later: list[int]) -> Retrieval:
    similar = normalize(first) @ normalize(second).T
    nearest = similar.argmax(dim=1).tolist()
    sought = [
        (body, later[best]) for body, best in zip(bodies, nearest, strict=True) if body in later
    ]
    return Retrieval(
        queries=len(sought),
        found=sum(body == found for body, found in sought),
        gone=len(bodies) - len(sought),
        candidates=len(sought) * len(later),
    )


def _moving(frame: Frame, grounding: SegmentationGrounding) -> list[Entity]:
    entities = find_entities(frame.classes, grounding.minimum_area)
    return [entity for entity in entities if entity.kind in DYNAMIC_CLASSES]


def _body(entity: Entity, frame: Frame) -> int:
    bodies, pixels = np.unique(frame.instances[entity.box.area][entity.mask], return_counts=True)
    return int(bodies[pixels.argmax()])


@dataclass(frozen=True, eq=False)
class Redrawn:
    """What an autoencoder draws of N frames.

    Attributes:
        pictures: uint8 (N, H, W).
        psnr: float32 (N,), peak signal-to-noise ratio of each, in dB.
    """

    pictures: NDArray[np.uint8]
    psnr: NDArray[np.float32]


def redraw(autoencoder: Autoencoder, frames: Sequence[Frame]) -> Redrawn:
    """Encode and decode frames.

    Args:
        autoencoder: trained; it is taken over and can't be trained further.
        frames: N of them.
    """
    runner = Runner(autoencoder, "auto", default_device())
    pictures, ratios = [], []
    for part in batches(len(frames), 8):
        drawn = runner(frames[part]).float().cpu()
        originals = to_input(stack_gray(frames[part]))
        ratios.append(psnr(drawn, originals).numpy())
        pictures.append(to_gray(drawn).numpy())
    return Redrawn(np.concatenate(pictures), np.concatenate(ratios))


def side_by_side(
    pictures: Sequence[NDArray[np.uint8]], drawn: Sequence[NDArray[np.uint8]]
) -> NDArray[np.uint8]:
    """Return one picture: originals above, what was drawn of them below, uint8 (2H, nW)."""
    return np.vstack([np.hstack(pictures), np.hstack(drawn)])
