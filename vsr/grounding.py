"""The section `grounding.segmentation` of a knowledge base: how a segmentation map gives facts."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

# The predicates for which a segmenter gives no confidence (paper, Table of predicates: the
# spatial ones and those of explicit negation).
UnratedPredicate = Literal[
    "LeftOf",
    "CenterOf",
    "RightOf",
    "Approaching",
    "IsAt",
    "OnRoad",
    "OnCrosswalk",
    "IsNear",
    "Occludes",
    "IsClear",
    "NoCrosswalk",
    "EmptyLane",
]

# Strictness would refuse the lists that YAML writes for pairs; the numbers in them stay strict.
Pair = Annotated[tuple[float, float], Field(strict=False)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Camera(_Section):
    """A pinhole camera that looks straight ahead, its axis level and over ego's centre line."""

    fov: float = Field(
        default=50.0,
        gt=0.0,
        lt=180.0,
        description="Horizontal field of view, in degrees.",
    )
    height: float = Field(
        default=1.5,
        gt=0.0,
        description="Height of the lens above the road, in m.",
    )

    def focal_length(self, width: int) -> float:
        """Return the focal length in px of a picture that is `width` px wide (square pixels)."""
        return width / 2 / math.tan(math.radians(self.fov) / 2)


class Tracking(_Section):
    """How entities keep their names from picture to picture; see `vsr.tracking`."""

    lost_after: float = Field(
        default=1.0,
        ge=0.0,
        description="How long the name of an entity that is not seen is kept, in s.",
    )
    slack: float = Field(
        default=2.0,
        ge=0.0,
        description=(
            "By how much boxes are widened on each side before they are compared, in px, so that "
            "what is far away and small may move by its own breadth."
        ),
    )


class SegmentationGrounding(_Section):
    """How facts are read off a segmentation map.

    The defaults are the paper's numbers where it gives any (window and approach distances); the
    others are the plainest choice, or fit a street with two lanes of 3.5 m.
    """

    window: int = Field(
        default=15,
        ge=1,
        le=4096,
        description="How far below and beside an entity its surroundings are searched, in px.",
    )
    approaching: Pair = Field(
        default=(50.0, 200.0),
        description=(
            "Distances to a crosswalk, in m, between which ego is approaching it; closer than "
            "the first, ego is at it, and beyond the second it does not count yet."
        ),
    )
    minimum_area: int = Field(
        default=1,
        ge=1,
        description="Pixels that a cluster needs to be an entity, in px.",
    )
    minimum_pixels: int = Field(
        default=1,
        ge=1,
        description=(
            "Pixels of something that count as evidence for being near, in the way or hidden, "
            "in px."
        ),
    )
    camera: Camera = Field(default=Camera(), description="The camera's lens and place.")
    road: Pair = Field(
        default=(-5.25, 1.75),
        description=(
            "Left and right edge of the carriageway, in m to the right of ego's centre line; "
            "a crosswalk is taken to reach from one to the other, seen or hidden."
        ),
    )
    lane_half_width: float = Field(
        default=1.75,
        gt=0.0,
        description="Half the width of ego's lane, in m.",
    )
    clear_requires_unoccluded: bool = Field(
        default=False,
        description="Whether a crosswalk that something hides in part can be clear (no unit).",
    )
    tracking: Tracking | None = Field(
        default=None,
        description=(
            "How entities keep their names over time; without it, names count within each "
            "picture, nearest first. `{}` has the defaults."
        ),
    )
    bounds: dict[UnratedPredicate, Pair] = Field(
        default_factory=dict,
        description=(
            "Lower and upper bound, 0 to 1 without unit, of predicates that the segmenter gives "
            "no confidence for; those left out are certain, [1, 1]."
        ),
    )

    @field_validator("approaching", "road")
    @classmethod
    def _ascending(cls, pair: tuple[float, float]) -> tuple[float, float]:
        if pair[0] >= pair[1]:
            raise ValueError(f"{list(pair)} does not ascend")
        return pair

    @field_validator("approaching")
    @classmethod
    def _ahead(cls, pair: tuple[float, float]) -> tuple[float, float]:
        if pair[0] < 0.0:
            raise ValueError(f"{list(pair)} has a negative distance")
        return pair

    @field_validator("bounds")
    @classmethod
    def _within_unit(
        cls, bounds: dict[UnratedPredicate, tuple[float, float]]
    ) -> dict[UnratedPredicate, tuple[float, float]]:
        for predicate, (lower, upper) in bounds.items():
            if not 0.0 <= lower <= upper <= 1.0:
                raise ValueError(f"{predicate} has no bound with 0 ≤ lower ≤ upper ≤ 1")
        return bounds
