"""The 28 semantic classes of a segmentation map, in CARLA's tag order, and their colours."""

from __future__ import annotations

from enum import IntEnum


class SemanticClass(IntEnum):
    """One channel of a segmentation map.

    The numbers are CARLA's semantic tags 0 to 27. CARLA has no tag for crosswalks, so tag 27
    (RailTrack there) stands for the crosswalk here, and the map keeps the paper's 28 channels.
    """

    UNLABELED = 0
    ROAD = 1
    SIDEWALK = 2
    BUILDING = 3
    WALL = 4
    FENCE = 5
    POLE = 6
    TRAFFIC_LIGHT = 7
    TRAFFIC_SIGN = 8
    VEGETATION = 9
    TERRAIN = 10
    SKY = 11
    PEDESTRIAN = 12
    RIDER = 13
    VEHICLE = 14
    TRUCK = 15
    BUS = 16
    TRAIN = 17
    MOTORCYCLE = 18
    BICYCLE = 19
    STATIC = 20
    DYNAMIC = 21
    OTHER = 22
    WATER = 23
    ROAD_LINE = 24
    GROUND = 25
    BRIDGE = 26
    CROSSWALK = 27


CLASS_COUNT = len(SemanticClass)

# The classes that the scene descriptor knows (paper, section on SSI) …
DESCRIPTOR_CLASSES = (
    SemanticClass.PEDESTRIAN,
    SemanticClass.VEHICLE,
    SemanticClass.TRUCK,
    SemanticClass.ROAD,
    SemanticClass.CROSSWALK,
    SemanticClass.SIDEWALK,
)
# … those of them that move …
DYNAMIC_CLASSES = (SemanticClass.PEDESTRIAN, SemanticClass.VEHICLE, SemanticClass.TRUCK)
# … and those whose clusters become entities of the knowledge base.
ENTITY_CLASSES = (*DYNAMIC_CLASSES, SemanticClass.CROSSWALK)

# Drawing colours (RGB, 0 to 255) from the Okabe-Ito palette, which colour-blind people can tell
# apart. Classes without an entry are background and are drawn grey.
COLOURS: dict[SemanticClass, tuple[int, int, int]] = {
    SemanticClass.PEDESTRIAN: (213, 94, 0),
    SemanticClass.VEHICLE: (0, 114, 178),
    SemanticClass.TRUCK: (204, 121, 167),
    SemanticClass.CROSSWALK: (240, 228, 66),
    SemanticClass.ROAD: (90, 90, 90),
    SemanticClass.SIDEWALK: (170, 170, 170),
}
