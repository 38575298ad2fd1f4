"""Perception without a picture: facts from the world's state and rays cast through it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from env.perception.pipeline import Scene, ScenePipeline
from env.perception.ray_casting import Person, RayCaster, Sighting, Vehicle
from env.world.actors import Walkers
from env.world.camera import DashCameraParameters
from env.world.world import World
from vsr.classes import SemanticClass
from vsr.entities import Box, Entity
from vsr.facts import add_facts, unrated_atoms
from vsr.grounding import SegmentationGrounding


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

    def perceive(self, front: float, people: Walkers) -> Scene:
        """Return what the dash camera could see.

        Args:
            front: x of ego's front bumper, in m.
            people: where they are.

        Returns:
            The scene, without a class map.
        """
        grounding, pinhole = self._pipeline.grounding, self._rays.pinhole
        evidence = RayEvidence(self._rays.cast(front, people), self._rays, grounding)
        atoms = unrated_atoms(evidence, grounding, pinhole, self._pipeline.kb.subject)
        facts = add_facts(self._pipeline.reward.facts(), evidence.entities, atoms, grounding)
        return self._pipeline.scene(evidence.entities, facts)


class RayEvidence:
    """What rays show of the entities that they meet; see `vsr.facts.Evidence`.

    Args:
        sighting: what the rays met.
        rays: the rays.
        grounding: how a picture would be read.
    """

    def __init__(
        self, sighting: Sighting, rays: RayCaster, grounding: SegmentationGrounding
    ) -> None:
        self.standing = sighting.standing
        self.entities = (
            *(person.entity for person in sighting.persons),
            *(vehicle.entity for vehicle in sighting.vehicles),
            *sighting.crosswalks,
        )
        self._persons: dict[str, Person] = {p.entity.name: p for p in sighting.persons}
        self._vehicles = sighting.vehicles
        self._named: dict[str, Vehicle] = {v.entity.name: v for v in sighting.vehicles}
        self._rays = rays
        self._grounding = grounding

    def beside(self, person: Entity) -> Mapping[Entity, float]:
        """See `vsr.facts.Evidence`."""
        return {v.entity: self._beside(person, v) for v in self._vehicles}

    def before(self, other: Entity) -> Mapping[Entity, float]:
        """See `vsr.facts.Evidence`; a crosswalk reaches from kerb to kerb."""
        if other.kind is SemanticClass.CROSSWALK:
            return {v.entity: self._before_crosswalk(v, other) for v in self._vehicles}
        person = self._persons[other.name]
        return {v.entity: self._before_person(v, person) for v in self._vehicles}

    def is_trodden(self, crosswalk: Entity) -> bool:
        """See `vsr.facts.Evidence`; the street has one crosswalk."""
        return SemanticClass.CROSSWALK in self.standing.values()

    def in_lane(self, vehicle: Entity) -> float:
        """See `vsr.facts.Evidence`."""
        seen, part = self._named[vehicle.name], vehicle.box.area[1]
        laterals = self._rays.pinhole.laterals(self._rays.columns[part], seen.bottoms[part])
        inside = np.abs(laterals) < self._grounding.lane_half_width
        visible = seen.bottoms[part] > seen.tops[part]
        return int(np.count_nonzero(inside & visible))

    def _beside(self, person: Entity, vehicle: Vehicle) -> float:
        window = self._grounding.window
        box, other = person.box, vehicle.entity.box
        if box.left - window >= other.right or box.right + window <= other.left:
            return 0.0
        left = slice(max(box.left - window, 0), box.left)
        right = slice(box.right, box.right + window)
        return vehicle.rows(left, box) + vehicle.rows(right, box)

    def _before_person(self, vehicle: Vehicle, person: Person) -> float:
        top, left, bottom, right = person.entity.box
        other, (first, last) = vehicle.entity.box, person.columns
        if other.bottom <= bottom or first >= other.right or last <= other.left:
            return 0.0
        return vehicle.rows(slice(first, last), Box(top, left, bottom + 1, right))

    def _before_crosswalk(self, vehicle: Vehicle, crosswalk: Entity) -> float:
        if vehicle.entity.bottom <= crosswalk.centre[0]:
            return 0.0
        rows = np.arange(crosswalk.box.top, crosswalk.box.bottom)[:, None] + 0.5
        left, right = (self._rays.pinhole.columns(side, rows) for side in self._grounding.road)
        part = vehicle.entity.box.area[1]
        band = (self._rays.columns[part] > left) & (self._rays.columns[part] < right)
        before = band & (rows > vehicle.tops[part]) & (rows < vehicle.bottoms[part])
        return int(np.count_nonzero(before))
