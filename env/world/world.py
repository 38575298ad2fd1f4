"""The street: what is where, how it looks, and whether ego touches, which pybullet answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
import pybullet
from numpy.random import Generator

from env.world import meshes, textures
from env.world.bullet import Client, NotCopied
from env.world.meshes import Figure, Mesh, Point, VehicleSize
from env.world.scenery import Light, Part, Scenery
from env.world.tiny_renderer import Picture, TinyRenderer
from vsr.classes import SemanticClass

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]
Occlusion = Literal["partial", "full", "cpnco"]

PERSON_RADIUS = 0.3  # m, of the upright cylinder that contact is asked of
_PARKING_GAP = 1.0  # m between parked vehicles
_LIMB_SWINGS = (1.0, -1.0, -0.8, 0.8)  # of legs and arms, as shares of the left leg's
_OUT_OF_SIGHT = (-60.0, 0.0, -40.0)
# What can be worn is the same in every process; a seed chooses from it.
_WARDROBE_SEED = 20250


@dataclass(frozen=True)
class StreetGeometry:
    """Where everything is, in m: x along the street from ego's start, y to the left, z up.

    The middle of the carriageway is y = 0; traffic keeps to the right, so ego's lane is at
    negative y, and the near side is ego's right.

    Attributes:
        length: of the street that is driven and walked.
        crosswalk: x of the near and the far edge of the crosswalk.
        goal: x that ego's front has to pass.
        lane_width: width of each of the two lanes.
        strip_width: width of the parking strip between ego's lane and the near kerb.
        sidewalk_width: width of each sidewalk.
        kerb_height: height of the sidewalks above the road.
        parked_gap: from the parked vehicle's front to the crosswalk's near edge.
        start: x where what can be seen begins.
        end: x where what can be seen ends.
    """

    length: float = 100.0
    crosswalk: tuple[float, float] = (60.0, 64.0)
    goal: float = 90.0
    lane_width: float = 3.5
    strip_width: float = 2.3
    sidewalk_width: float = 3.4
    kerb_height: float = 0.12
    parked_gap: float = 1.2
    start: float = -30.0
    end: float = 230.0

    @property
    def ego_lane(self) -> float:
        """The y of the middle of ego's lane, in m."""
        return -self.lane_width / 2

    @property
    def near_kerb(self) -> float:
        """The y of the kerb on ego's side, in m."""
        return -self.lane_width - self.strip_width

    @property
    def far_kerb(self) -> float:
        """The y of the kerb on the other side, in m."""
        return self.lane_width

    @property
    def near_wall(self) -> float:
        """The y where the sidewalk on ego's side ends at the houses, in m."""
        return self.near_kerb - self.sidewalk_width

    @property
    def far_wall(self) -> float:
        """The y where the other sidewalk ends at the houses, in m."""
        return self.far_kerb + self.sidewalk_width

    def on_sidewalk(self, y: Array) -> npt.NDArray[np.bool_]:
        """Tell for each y whether it lies beyond a kerb."""
        return (y < self.near_kerb) | (y > self.far_kerb)


@dataclass(frozen=True)
class ParkedVehicle:
    """A vehicle that stands, facing along the street.

    Attributes:
        kind: VEHICLE, a car, or TRUCK, a box truck.
        size: its outer measures.
        place: x and y of its middle, in m.
    """

    kind: SemanticClass
    size: VehicleSize
    place: tuple[float, float]


class _Model(NamedTuple):
    """A make of vehicle: a car with a boot of this share of its length, or a box truck."""

    size: VehicleSize
    boot: float | None = None

    @property
    def kind(self) -> SemanticClass:
        return SemanticClass.TRUCK if self.boot is None else SemanticClass.VEHICLE

    @property
    def mesh(self) -> Mesh:
        return (
            meshes.box_truck(self.size) if self.boot is None else meshes.car(self.size, self.boot)
        )


_CARS = (
    _Model(VehicleSize(4.25, 1.78, 1.46), 0.03),
    _Model(VehicleSize(4.60, 1.82, 1.42), 0.14),
    _Model(VehicleSize(4.05, 1.74, 1.50), 0.02),
)
_TRUCKS = (
    _Model(VehicleSize(6.0, 2.05, 2.75)),
    _Model(VehicleSize(6.6, 2.1, 2.95)),
    _Model(VehicleSize(5.6, 2.0, 2.6)),
)
_CHILD = Figure(height=1.15)  # Euro NCAP's child is as tall as one of seven


class World(NotCopied):
    """The street. Everything is built once; `dress` changes it for an episode.

    Args:
        people: how many pedestrians there are.
        occlusion: what is parked before the crosswalk: ``partial``, a car; ``full``, a box truck;
            ``cpnco``, the stage of Euro NCAP's test of that name: a car, behind it a box truck, and
            the first of the people is a child.
        ego: outer measures of ego.
        geometry: the street.

    Raises:
        UsageError: pybullet does not start; or the street is used after `close`, or copied.

    Attributes:
        light: of the episode.
        heights: float (N,), of the people, in m.
        parked: the vehicles that stand in the street.
        posts: float (M, 3), x, y and radius of tree trunks, lamps and sign posts, in m.
        classes: uint8, the semantic class of each body and, at index -1, of the sky.
    """

    def __init__(
        self,
        people: int,
        occlusion: Occlusion,
        ego: VehicleSize,
        geometry: StreetGeometry | None = None,
    ) -> None:
        self.geometry = geometry or StreetGeometry()
        self.light = Light()
        self._ego_size = ego
        self._client = Client()
        self._tiny_renderer: TinyRenderer | None = None
        self._kinds: list[SemanticClass] = []
        self._parts: list[Part] = []
        rng = np.random.default_rng(_WARDROBE_SEED)
        pictures = self._pictures(rng, truck=occlusion == "full")
        self._build_ground()
        self._build_houses(rng)
        self._build_furniture(rng)
        self._parked = self._build_vehicles(occlusion)
        figures = [_figure(rng) for _ in range(people)]
        if occlusion == "cpnco":
            figures[0] = _CHILD
        self.heights = np.array([figure.height for figure in figures])
        self._people = np.array([self._build_person(figure) for figure in figures])
        self._joints = np.array([meshes.limb_joints(figure) for figure in figures])
        self._ego = self._body(SemanticClass.VEHICLE, meshes.car(ego, 0.05), place=_OUT_OF_SIGHT)
        # Sky has no body: the last entry is what index -1 finds.
        self.classes = np.array([*self._kinds, SemanticClass.SKY], np.uint8)

        numbers = iter(range(sum(map(len, pictures.values()))))
        self._textures = {name: [next(numbers) for _ in some] for name, some in pictures.items()}
        self._scenery = Scenery(self._parts, [one for some in pictures.values() for one in some])
        for sign in self._signs:
            self._wear(sign, "sign", 0)
        self._wear(self._ego, "paintwork", 0)
        self._ego_hull = self._hull(_box(ego))
        self._people_hulls = [self._hull(_cylinder(figure)) for figure in figures]

    @property
    def scenery(self) -> Scenery:
        """What is to be seen now.

        Raises:
            UsageError: the street is closed.
        """
        self._client.check_open()
        return self._scenery

    def dress(self, rng: Generator) -> None:
        """Give the street a new look: light, surfaces, houses, trees, vehicle, clothes."""
        self.light = _draw_light(rng)
        for part, texture in self._surfaces:
            self._wear(part, texture, int(rng.integers(len(self._textures[texture]))))
        self._arrange_houses(rng)
        self._arrange_furniture(rng)
        self._park(rng)
        for person in self._people:
            choice = int(rng.integers(len(self._textures["outfit"])))
            self._wear(person, "outfit", choice)

    def place_people(self, positions: Array, headings: Array, phases: Array, paces: Array) -> None:
        """Move the people and their limbs.

        Args:
            positions: float (N, 2), x and y in m.
            headings: float (N,), in rad from the x axis.
            phases: float (N,), in rad; one stride of both legs is 2π.
            paces: float (N,), speeds in m/s, which give the length of the step.
        """
        ground, poses = self.geometry, self.scenery.poses
        swings = leg_swings(phases, paces)
        sunk = meshes.HIP_HEIGHT * (1.0 - np.cos(swings))
        heights = np.where(ground.on_sidewalk(positions[:, 1]), ground.kerb_height, 0.0) - sunk
        trunks = np.column_stack([positions, heights])
        # Joints lie in the plane across the body, so that a turn moves them along one direction.
        aside = self._joints[..., 1]
        across = np.stack([-np.sin(headings), np.cos(headings)], axis=1)
        limbs = trunks[:, None] + [0.0, 0.0, 1.0] * self._joints
        limbs[..., :2] += aside[..., None] * across[:, None]
        poses.places[self._people[:, 0]] = trunks
        poses.places[self._people[:, 1:]] = limbs
        poses.yaws[self._people] = headings[:, None]
        poses.pitches[self._people[:, 1:]] = swings[:, None] * _LIMB_SWINGS

    def touches(self, front: float, people: Sequence[int], positions: Array) -> bool:
        """Tell whether ego touches one of these people, as pybullet's closest points have it.

        Args:
            front: x of ego's front bumper, in m.
            people: their indices.
            positions: float (len(people), 2), where they are, in m.
        """
        self._move_hull(self._ego_hull, self._place_of_ego(front))
        return any(map(self._touches_ego, people, positions.tolist()))

    def _touches_ego(self, index: int, position: Sequence[float]) -> bool:
        person, client = self._people_hulls[index], self._client.number
        self._move_hull(person, (*position, 0.0))
        points = pybullet.getClosestPoints(self._ego_hull, person, 0.0, physicsClientId=client)
        return bool(points)

    def _move_hull(self, hull: int, place: Sequence[float]) -> None:
        pybullet.resetBasePositionAndOrientation(
            hull, place, (0.0, 0.0, 0.0, 1.0), physicsClientId=self._client.number
        )

    def show_ego(self, front: float) -> None:
        """Show ego where ego is."""
        self._put(self._ego, self._place_of_ego(front))

    def hide_ego(self) -> None:
        """Take ego out of the way of the dash camera."""
        self._put(self._ego, _OUT_OF_SIGHT)

    def _place_of_ego(self, front: float) -> tuple[float, float, float]:
        return front - self._ego_size.length / 2, self.geometry.ego_lane, 0.0

    def render(
        self, view: Sequence[float], projection: Sequence[float], size: tuple[int, int]
    ) -> Picture:
        """Draw the street by pybullet's TinyRenderer.

        Args:
            view: pybullet's view matrix.
            projection: pybullet's projection matrix.
            size: width and height, in px.
        """
        if self._tiny_renderer is None:
            self._tiny_renderer = TinyRenderer(self.scenery)
        return self._tiny_renderer.render(self.light, view, projection, size)

    def close(self) -> None:
        """Disconnect from pybullet; a second call does nothing."""
        self._client.close()
        if self._tiny_renderer is not None:
            self._tiny_renderer.close()

    # Building

    def _pictures(self, rng: Generator, truck: bool) -> dict[str, list[textures.Picture]]:
        street = self.geometry
        across = street.far_kerb - street.near_kerb
        return {
            "outfit": [textures.outfit(rng) for _ in range(48)],
            "paintwork": [textures.paintwork(rng, truck) for _ in range(16)],
            "furniture": [textures.furniture(rng) for _ in range(4)],
            "facade": [textures.facade(rng) for _ in range(16)],
            "asphalt": [
                textures.asphalt(rng, across, -street.near_kerb, street.strip_width)
                for _ in range(4)
            ],
            "zebra": [textures.zebra(rng) for _ in range(3)],
            "paving": [textures.paving(rng) for _ in range(4)],
            "kerbstone": [textures.kerbstone(rng)],
            "grass": [textures.grass(rng)],
            "sign": [textures.crosswalk_sign()],
        }

    def _build_ground(self) -> None:
        street = self.geometry
        near, far = street.near_kerb, street.far_kerb
        before, after = street.crosswalk
        lengths = _pieces(street.start, before) + _pieces(after, street.end)
        # The crosswalk fills a gap of the road: one surface above the other would flicker.
        zebra = meshes.slab((before, near), (after, far), 0.0, (1.0, 1.0))
        road, slabs, stones = [], [], []
        for x0, x1 in lengths:
            road.append(meshes.slab((x0, near), (x1, far), 0.0, (6.0, far - near)))
        for x0, x1 in _pieces(street.start, street.end):
            for kerb, wall in ((near, street.near_wall), (far, street.far_wall)):
                pavement, stone = self._sidewalk(x0, x1, kerb, wall)
                slabs.append(pavement)
                stones.append(stone)
        lawn = meshes.slab((street.end, -60.0), (street.end + 40.0, 60.0), 0.0, (4.0, 4.0))
        self._surfaces = [
            (self._body(SemanticClass.ROAD, meshes.merge(*road)), "asphalt"),
            (self._body(SemanticClass.CROSSWALK, zebra), "zebra"),
            (self._body(SemanticClass.SIDEWALK, meshes.merge(*slabs)), "paving"),
            (self._body(SemanticClass.SIDEWALK, meshes.merge(*stones)), "kerbstone"),
            (self._body(SemanticClass.TERRAIN, lawn), "grass"),
        ]

    def _sidewalk(self, x0: float, x1: float, kerb: float, wall: float) -> tuple[Mesh, Mesh]:
        """Return pavement and kerbstones between x0 and x1."""
        top, side = self.geometry.kerb_height, np.sign(wall)
        edge = kerb + side * 0.2
        low, high = sorted((edge, wall + side))
        pavement = meshes.slab((x0, low), (x1, high), top, (2.0, 2.0))
        low, high = sorted((kerb, edge))
        stone = meshes.slab((x0, low), (x1, high), top, (2.0, 0.2))
        first, last = (x0, x1) if side > 0 else (x1, x0)
        face = meshes.panel((first, kerb, 0.0), (last, kerb, top), (0.0, 0.0, (x1 - x0) / 2, 0.5))
        return pavement, meshes.merge(stone, face)

    def _build_houses(self, rng: Generator) -> None:
        street = self.geometry
        self._houses: list[list[tuple[int, float]]] = []
        for _ in range(2):
            widths = rng.uniform(10.0, 14.0, 22)
            widths *= (street.end - street.start) / widths.sum()
            floors = rng.permutation(np.resize([2, 3, 4, 3], len(widths)))
            self._houses.append(
                [
                    (self._body(SemanticClass.BUILDING, _house(width, int(count))), float(width))
                    for width, count in zip(widths, floors, strict=True)
                ]
            )
        # A house across the end of the street, so that the view ends in something.
        self._last_house = self._body(
            SemanticClass.BUILDING,
            _house(40.0, 4, 3.0),
            place=(street.end + 25.0, 20.0, 0.0),
            yaw=-0.5 * np.pi,
        )

    def _build_furniture(self, rng: Generator) -> None:
        street = self.geometry
        self._trees = [
            self._body(SemanticClass.VEGETATION, meshes.tree(float(rng.uniform(5.0, 7.0))))
            for _ in range(14)
        ]
        self._lamps = [self._body(SemanticClass.POLE, meshes.lamp()) for _ in range(6)]
        self._sign_places = (
            (street.crosswalk[0] - 0.2, street.far_kerb + 0.5),
            (street.crosswalk[1] + 0.4, street.near_kerb - 0.5),
        )
        self._sign_posts = [
            self._body(SemanticClass.POLE, meshes.sign_post(), place=(x, y, 0.0))
            for x, y in self._sign_places
        ]
        self._signs = [
            self._body(
                SemanticClass.TRAFFIC_SIGN,
                meshes.panel((x - 0.06, y + 0.4, 2.2), (x - 0.06, y - 0.4, 3.0)),
            )
            for x, y in self._sign_places
        ]

    def _build_vehicles(self, occlusion: Occlusion) -> list[list[tuple[int, _Model]]]:
        """Return what may park in each place, the place at the crosswalk first."""
        places = {"partial": [_CARS], "full": [_TRUCKS], "cpnco": [_CARS, _TRUCKS]}[occlusion]
        return [[(self._body(model.kind, model.mesh), model) for model in some] for some in places]

    def _build_person(self, figure: Figure) -> list[int]:
        """Return the trunk's part, and those of left leg, right leg, left arm and right arm."""
        leg, arm = meshes.leg(figure), meshes.arm(figure)
        first = self._body(SemanticClass.PEDESTRIAN, meshes.trunk(figure), leg, leg, arm, arm)
        return list(range(first, first + 5))

    def _body(
        self, kind: SemanticClass, *parts: Mesh, place: Point = (0.0, 0.0, 0.0), yaw: float = 0.0
    ) -> int:
        """Add a body and return the index of its first part."""
        first, body = len(self._parts), len(self._kinds)
        self._kinds.append(kind)
        self._parts += [Part(mesh, body, place, yaw) for mesh in parts]
        return first

    def _hull(self, shape: Mapping[str, Any]) -> int:
        client = self._client.number
        collision = pybullet.createCollisionShape(**shape, physicsClientId=client)
        return int(
            pybullet.createMultiBody(
                baseMass=0.0, baseCollisionShapeIndex=collision, physicsClientId=client
            )
        )

    # Dressing

    def _wear(self, parts: int | Indices, texture: str, choice: int) -> None:
        self.scenery.wear(parts, self._textures[texture][choice])

    def _put(self, part: int, place: Point, yaw: float = 0.0) -> None:
        self.scenery.put(part, place, yaw)

    def _arrange_houses(self, rng: Generator) -> None:
        street = self.geometry
        for row, wall, yaw in zip(
            self._houses, (street.near_wall, street.far_wall), (np.pi, 0.0), strict=True
        ):
            x = street.start
            for index in rng.permutation(len(row)):
                house, width = row[index]
                # A house's origin is its left end as seen from the street.
                left = x + width if yaw else x
                self._put(house, (left, wall, 0.0), yaw)
                self._wear(house, "facade", int(rng.integers(len(self._textures["facade"]))))
                x += width
        self._wear(self._last_house, "facade", int(rng.integers(len(self._textures["facade"]))))

    def _arrange_furniture(self, rng: Generator) -> None:
        street = self.geometry
        clear_of_crosswalk = [8.0, 20.0, 32.0, 44.0, 78.0, 92.0, 110.0]
        spots = [(x, street.near_kerb - 0.5) for x in clear_of_crosswalk]
        spots += [(x + 5.0, street.far_kerb + 0.5) for x in clear_of_crosswalk]
        leaves = int(rng.integers(len(self._textures["furniture"])))
        posts = [(x, y, 0.04) for x, y in self._sign_places]
        for tree, (x, y) in zip(self._trees, spots, strict=True):
            place = (x + rng.uniform(-2.5, 2.5), y, 0.0)
            self._put(tree, place, rng.uniform(0.0, 6.28))
            self._wear(tree, "furniture", leaves)
            posts.append((*place[:2], 0.14))
        first = rng.uniform(0.0, 8.0)
        for number, pole in enumerate(self._lamps):
            place = (first + 26.0 * number, street.far_kerb + 0.35, 0.0)
            self._put(pole, place, np.pi)
            self._wear(pole, "furniture", leaves)
            posts.append((*place[:2], 0.08))
        self.posts = np.array(posts)
        for post in self._sign_posts:
            self._wear(post, "furniture", leaves)

    def _park(self, rng: Generator) -> None:
        street = self.geometry
        front = street.crosswalk[0] - street.parked_gap
        middle = street.near_kerb + 0.5 * street.strip_width
        self.parked = []
        for choices in self._parked:
            chosen = int(rng.integers(len(choices)))
            for body, _ in choices:
                self._put(body, _OUT_OF_SIGHT)
            body, model = choices[chosen]
            place = (front - model.size.length / 2, middle)
            self._put(body, (*place, 0.0))
            self._wear(body, "paintwork", int(rng.integers(len(self._textures["paintwork"]))))
            self.parked.append(ParkedVehicle(model.kind, model.size, place))
            front -= model.size.length + _PARKING_GAP


def _box(size: VehicleSize) -> dict[str, Any]:
    """Return pybullet's arguments for a vehicle's hull."""
    return {
        "shapeType": pybullet.GEOM_BOX,
        "halfExtents": (size.length / 2, size.width / 2, size.height / 2),
        "collisionFramePosition": (0.0, 0.0, size.height / 2),
    }


def _cylinder(figure: Figure) -> dict[str, Any]:
    """Return pybullet's arguments for a person's hull."""
    return {
        "shapeType": pybullet.GEOM_CYLINDER,
        "radius": PERSON_RADIUS,
        "height": figure.height,
        "collisionFramePosition": (0.0, 0.0, figure.height / 2),
    }


def leg_swings(phases: Array, paces: Array) -> Array:
    """Return by how much walkers' left legs are swung back, the right ones forward, in rad.

    Args:
        phases: float (N,), in rad; one stride of both legs is 2π.
        paces: float (N,), speeds in m/s.
    """
    return np.minimum(0.3 * paces, 0.5) * np.sin(phases)


def _pieces(start: float, end: float) -> list[tuple[float, float]]:
    """Cut a length into pieces: the renderer visits the whole box around a triangle."""
    cuts = np.linspace(start, end, max(round((end - start) / 6.0), 1) + 1)
    return list(zip(cuts.tolist(), cuts[1:].tolist(), strict=False))


def _figure(rng: Generator) -> Figure:
    return Figure(
        height=float(rng.uniform(1.55, 1.88)),
        breadth=float(rng.uniform(0.92, 1.12)),
        skirt=bool(rng.random() < 0.2),
        backpack=bool(rng.random() < 0.25),
        long_hair=bool(rng.random() < 0.4),
    )


def _house(width: float, floors: int, repeats: float = 1.0) -> Mesh:
    """Return a house that shows towards -y, its front's lower left corner in the origin."""
    height, depth, hidden = 3.2 * floors, 5.0, 5.8
    top = 1.0 - floors / textures.FACADE_FLOORS
    plain = (0.01, 0.01, 0.02, 0.02)
    return meshes.merge(
        meshes.panel((0.0, 0.0, 0.0), (width, 0.0, height), (0.0, top, repeats, 0.999)),
        # Below the lowest neighbour's roof the side walls cannot be seen.
        meshes.panel((width, 0.0, hidden), (width, depth, height), plain),
        meshes.panel((0.0, depth, hidden), (0.0, 0.0, height), plain),
    )


def _draw_light(rng: Generator) -> Light:
    azimuth, elevation = rng.uniform(-np.pi, np.pi), rng.uniform(0.7, 1.2)
    ambient = rng.uniform(0.62, 0.74)
    zenith = rng.uniform(150.0, 195.0)
    level = np.cos(elevation)
    return Light(
        direction=(
            float(level * np.cos(azimuth)),
            float(level * np.sin(azimuth)),
            float(np.sin(elevation)),
        ),
        ambient=float(ambient),
        diffuse=float(rng.uniform(1.08, 1.25) - ambient),
        sky=(float(zenith), float(min(zenith + 55.0, 245.0))),
    )
