"""Perception without a picture: facts from the world's state and rays cast through it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from env.perception.pipeline import Naming, Scene, ScenePipeline
from env.perception.ray_casting import (
    UNSEEN,
    Bodies,
    Camera,
    Eye,
    Ground,
    Integers,
    Parked,
    Reading,
    Sight,
    cast,
)
from env.world.actors import Walkers
from env.world.camera import DashCameraParameters
from env.world.world import ParkedVehicle, World, leg_swings
from vsr.classes import ENTITY_CLASSES, SemanticClass
from vsr.entities import Box, Entity
from vsr.facts import Pinhole, UnratedAtom, add_facts, unrated_atoms
from vsr.grounding import SegmentationGrounding

# By their numbers: those of Python are faster keys than members of an enumeration.
_KINDS = {int(kind): kind for kind in SemanticClass}
_NAMES = {int(kind): kind.name.lower() for kind in ENTITY_CLASSES}


class TruthPerception:
    """Makes scenes of the world's state.

    Args:
        world: the street.
        lens: the dash camera.
        pipeline: of the knowledge base, which says how a picture would be read.
    """

    def __init__(self, world: World, lens: DashCameraParameters, pipeline: ScenePipeline) -> None:
        self._pipeline = pipeline
        self._rays = RayCaster(world, lens, pipeline.grounding)
        self._said: tuple[list[str], list[UnratedAtom]] = [], []
        self._facts = pipeline.reward.facts()
        self._conclusions = pipeline.conclude(self._facts)

    def perceive(self, front: float, people: Walkers, naming: Naming = tuple) -> Scene:
        """Return what the dash camera could see.

        Args:
            front: x of ego's front bumper, in m.
            people: where they are.
            naming: of the episode; see `ScenePipeline.naming`.

        Returns:
            The scene, without a class map.
        """
        evidence, pipeline = self._rays.cast(front, people, naming), self._pipeline
        atoms = unrated_atoms(evidence, pipeline.grounding, self._rays.pinhole, pipeline.kb.subject)
        said = [entity.name for entity in evidence.entities], list(atoms)
        # From step to step often the same is said, and the same follows from it.
        if said != self._said:
            facts = add_facts(
                pipeline.reward.facts(), evidence.entities, said[1], pipeline.grounding
            )
            self._said, self._facts = said, facts
            self._conclusions = pipeline.conclude(facts)
        return Scene(evidence.entities, self._facts.copy(), self._conclusions)


class RayCaster:
    """Casts the dash camera's rays; see `env.perception.ray_casting`.

    Args:
        world: the street.
        lens: the dash camera.
        grounding: how much must show of something for it to be seen, and the windows around people.

    Attributes:
        pinhole: the camera.
    """

    def __init__(
        self, world: World, lens: DashCameraParameters, grounding: SegmentationGrounding
    ) -> None:
        self._world = world
        self._setback = lens.setback
        self.pinhole = pinhole = Pinhole.of(grounding.camera, (lens.size, lens.size))
        # The renderer samples a pixel at its lower left corner. A trifle more, or one ray would run
        # along the street and never enter a box from the side.
        columns = np.arange(lens.size) + 1e-6
        rays = (columns - pinhole.middle) / pinhole.focal
        camera = Camera(
            lens.size,
            lens.near,
            pinhole.focal,
            pinhole.height,
            pinhole.horizon,
            pinhole.middle,
            steepness=1.0 / -float(rays[0]),
        )
        street = world.geometry
        ground = Ground(
            street.ego_lane,
            street.near_kerb,
            street.far_kerb,
            street.kerb_height,
            *street.crosswalk,
        )
        reading = Reading(
            grounding.minimum_area, grounding.window, *grounding.road, grounding.lane_half_width
        )
        self._eye = Eye(camera, ground, reading, columns, rays)
        # Every entity fills its box, so that all masks are parts of this one.
        self._filled = np.ones((lens.size, lens.size), np.bool_)
        self._filled.flags.writeable = False

    def cast(self, front: float, people: Walkers, naming: Naming = tuple) -> RayEvidence:
        """Return what the dash camera could see.

        Args:
            front: x of ego's front bumper, in m.
            people: where they are.
            naming: of the episode; see `ScenePipeline.naming`.
        """
        world = self._world
        swings = leg_swings(people.phases, people.speeds)
        sight = cast(
            front - self._setback,
            self._eye,
            world.posts,
            _parked(tuple(world.parked)),
            Bodies(people.positions, people.headings, swings, world.heights),
        )
        return RayEvidence(sight, naming(self._entities(sight)))

    def _entities(self, sight: Sight) -> tuple[Entity, ...]:
        """Return what is seen; names count within a class."""
        counts = dict.fromkeys(_NAMES, 0)
        entities = []
        for number, top, left, bottom, right in sight.things[:, :5].tolist():
            counts[number] += 1
            name = f"{_NAMES[number]}{counts[number]}"
            mask = self._filled[: bottom - top, : right - left]
            box = Box(top, left, bottom, right)
            entities.append(Entity(name, _KINDS[number], 1.0, box, mask))
        return tuple(entities)


class RayEvidence:
    """What rays show of the entities that they meet; see `vsr.facts.Evidence`.

    Args:
        sight: what the rays met.
        entities: the same, one for each of its things.

    Attributes:
        entities: persons, vehicles and crosswalks that are seen.
        standing: each person's ground; None where none is seen.
    """

    def __init__(self, sight: Sight, entities: tuple[Entity, ...]) -> None:
        people, count = sight.beside.shape
        self.entities = entities
        persons, vehicles = entities[:people], entities[people : people + count]
        notes = sight.things[:, 5].tolist()
        self.standing: Mapping[Entity, SemanticClass | None] = {
            person: None if note == UNSEEN else _KINDS[note]
            for person, note in zip(persons, notes, strict=False)
        }
        self._in_lane = dict(zip(vehicles, notes[people:], strict=False))
        self._beside = _by_vehicle(persons, vehicles, sight.beside)
        # What comes after the vehicles is the crosswalk, if one is seen.
        others = (*persons, *entities[people + count :])
        self._before = _by_vehicle(others, vehicles, sight.before)

    def beside(self, person: Entity) -> Mapping[Entity, int]:
        """See `vsr.facts.Evidence`."""
        return self._beside.get(person, {})

    def before(self, other: Entity) -> Mapping[Entity, int]:
        """See `vsr.facts.Evidence`; a crosswalk reaches from kerb to kerb."""
        return self._before.get(other, {})

    def is_trodden(self, crosswalk: Entity) -> bool:
        """See `vsr.facts.Evidence`; the street has one crosswalk."""
        return SemanticClass.CROSSWALK in self.standing.values()

    def in_lane(self, vehicle: Entity) -> int:
        """See `vsr.facts.Evidence`."""
        return self._in_lane[vehicle]


def _by_vehicle(
    others: Sequence[Entity], vehicles: Sequence[Entity], pixels: Integers
) -> dict[Entity, dict[Entity, int]]:
    """Return how many pixels of each vehicle belong to others; those of whom none do are left out.

    Args:
        others: persons or crosswalks.
        vehicles: all V of them.
        pixels: int64 (P, V), with at least a row for each of the others.
    """
    if not vehicles:
        return {}
    rows = zip(others, pixels.tolist(), strict=False)
    return {other: dict(zip(vehicles, row, strict=True)) for other, row in rows if any(row)}


@lru_cache(maxsize=64)  # a street has few models, and they stay for an episode
def _parked(vehicles: tuple[ParkedVehicle, ...]) -> Parked:
    """Return the parked vehicles as the rays need them."""
    blocks = [block for vehicle in vehicles for block in _blocks(vehicle)]
    owners = [place for place, vehicle in enumerate(vehicles) for _ in _blocks(vehicle)]
    hulls = [
        (y, x - 0.31 * vehicle.size.length, x + vehicle.size.length / 2)
        for vehicle in vehicles
        for x, y in [vehicle.place]
    ]
    kinds = [int(vehicle.kind) for vehicle in vehicles]
    return Parked(
        np.array(hulls), np.array(kinds, np.int64), np.array(blocks), np.array(owners, np.int64)
    )


def _blocks(vehicle: ParkedVehicle) -> list[tuple[float, float, float, float]]:
    """Return the boxes of a vehicle: first and last x, half its width, and its height, in m."""
    x, length, side = vehicle.place[0], vehicle.size.length, vehicle.size.width / 2
    rear, front, top = x - length / 2, x + length / 2, vehicle.size.height
    if vehicle.kind is SemanticClass.TRUCK:
        cab = front - 1.75
        return [
            (rear, cab, side, top),
            (cab, front - 0.35, side - 0.1, 2.1),
            (cab, front, side - 0.06, 1.25),
        ]
    return [
        (rear, front - 0.1, side - 0.015, 0.6 * top),
        (x - 0.42 * length, x + 0.16 * length, side - 0.14, top),
    ]
