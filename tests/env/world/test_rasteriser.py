"""The street's renderer draws what pybullet's TinyRenderer draws, and what rays would meet."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pybullet
import pytest
from hypothesis import given
from hypothesis import strategies as st

from env.driving.drivers import Cautious
from env.driving.rollout import rollout
from env.street.crossing import OccludedCrossing
from env.world import meshes, textures
from env.world.camera import DashCamera, luma
from env.world.meshes import Swatch, VehicleSize
from env.world.rasteriser import View, draw
from env.world.scenery import Light, Part, Scenery
from env.world.tiny_renderer import TinyRenderer
from vsr.classes import SemanticClass

SIZE = 64
VIEW = View(0.0, 0.0, 0.0, 60.0, 0.3, 100.0)  # x, y, z, focal, near, far
LIGHT = Light((0.0, 0.0, 1.0), ambient=0.5, diffuse=0.5)
SKY = 255
WHITE = np.full((1, 1, 3), 200, np.uint8)


def drawn(*parts, pictures=(WHITE,), light=LIGHT, view=VIEW, prepare=lambda scenery: None):
    """Draw meshes, each a body of its own; a body's class is its number."""
    scenery = Scenery([Part(mesh, body) for body, mesh in enumerate(parts)], pictures)
    prepare(scenery)
    sky = np.full((SIZE, SIZE), SKY, np.uint8)
    return draw(scenery, light, view, sky, np.array([*range(len(parts)), 27], np.uint8))


def wall(x, y0, y1, z0=-1.0, z1=1.0):
    """Return a wall that shows to the lens, which looks along x; y is to the left."""
    return meshes.panel((x, y1, z0), (x, y0, z1))


def moments(traffic, occlusion, renderer):
    """Yield frames of a drive."""
    with OccludedCrossing(
        traffic=traffic, occlusion=occlusion, perception="none", renderer=renderer
    ) as street:
        for index, _ in enumerate(rollout(street, Cautious(), seed=5)):
            if index % 50 == 10:
                yield street.frame


@pytest.fixture(scope="module", params=[("low", "partial"), ("medium", "cpnco"), ("high", "full")])
def both(request):
    """Frames of one drive by both renderers, (F, H, W): grey values, classes, bodies."""
    frames = [list(moments(*request.param, renderer)) for renderer in ("street", "tiny")]
    return [
        [np.stack([getattr(f, name) for f in some]) for name in ("gray", "classes", "instances")]
        for some in frames
    ]


def test_both_renderers_show_the_same_bodies(both):
    (_, classes, bodies), (_, tiny_classes, tiny_bodies) = both
    assert np.mean(bodies == tiny_bodies) >= 0.999
    for kind in np.unique(tiny_classes):
        here, there = classes == kind, tiny_classes == kind
        wrong = np.count_nonzero(here != there)
        # A thin crack of TinyRenderer's between pavement and road is half of what differs.
        assert wrong <= max(0.02 * np.count_nonzero(there), 2.0), SemanticClass(kind).name


def test_both_renderers_have_the_same_grey_values(both):
    (gray, classes, _), (tiny_gray, tiny_classes, _) = both
    differences = np.abs(gray.astype(int) - tiny_gray)
    assert np.mean(differences <= 1) >= 0.98
    for kind in np.unique(tiny_classes):
        same = (classes == kind) & (tiny_classes == kind)
        assert np.median(differences[same]) <= 1.0, SemanticClass(kind).name
    assert abs(np.mean(gray.astype(int) - tiny_gray)) < 0.1


def test_a_vehicle_that_crosses_the_near_plane_looks_as_in_tiny_renderer():
    paint = textures.paintwork(np.random.default_rng(0), truck=False)
    car = meshes.car(VehicleSize(4.25, 1.78, 1.46), 0.03)
    scenery = Scenery([Part(car, 0, (1.2, 0.9, -1.2), 0.3)], [paint])
    sky = np.full((SIZE, SIZE), SKY, np.uint8)
    frame = draw(scenery, LIGHT, VIEW, sky, np.array([14, 11], np.uint8))
    fov = 2 * np.degrees(np.arctan(0.5 * SIZE / VIEW.focal))
    tiny = TinyRenderer(scenery)
    picture = tiny.render(
        LIGHT,
        pybullet.computeViewMatrix((0, 0, 0), (1, 0, 0), (0, 0, 1)),
        pybullet.computeProjectionMatrixFOV(fov, 1.0, VIEW.near, VIEW.far),
        (SIZE, SIZE),
    )
    tiny.close()
    corners = car.vertices @ [[np.cos(0.3)], [-np.sin(0.3)], [0.0]] + 1.2
    assert corners.min() < VIEW.near < corners.max()
    shown = picture.bodies == 0
    assert 0.1 < shown.mean() < 0.9
    assert np.mean((frame.instances == 0) == shown) >= 0.998
    assert np.mean(frame.gray[shown] == luma(picture.rgb)[shown]) >= 0.98


def test_ground_from_behind_the_lens_reaches_to_the_lower_edge():
    frame = drawn(meshes.slab((-50.0, -90.0), (90.0, 90.0), -1.5, (1.0, 1.0)))
    horizon = SIZE // 2
    assert (frame.instances[:horizon] == -1).all()
    assert (frame.instances[horizon + 1 :] == 0).all()


@pytest.mark.parametrize("nearest", [0, 1])
def test_what_is_nearer_hides_what_is_farther(nearest):
    walls = [wall(6.0, -2.0, 2.0), wall(6.0, -2.0, 2.0)]
    walls[nearest] = wall(5.0, -0.5, 0.5)
    frame = drawn(*walls)
    centre = SIZE // 2
    assert frame.instances[centre, centre] == nearest
    assert set(frame.instances[centre].tolist()) == {-1, 0, 1}


def test_of_two_at_the_same_depth_the_later_one_shows():
    frame = drawn(wall(5.0, -1.0, 1.0), wall(5.0, -1.0, 1.0))
    assert set(frame.instances.ravel().tolist()) == {-1, 1}


def test_where_nothing_is_there_is_sky():
    behind = wall(-5.0, -1.0, 1.0)
    beside = meshes.block((5.0, 60.0, -1.0), (6.0, 61.0, 1.0), Swatch.PAINT)
    from_behind = meshes.panel((5.0, -1.0, -1.0), (5.0, 1.0, 1.0))
    too_far = wall(150.0, -9.0, 9.0)
    frame = drawn(behind, beside, from_behind, too_far)
    assert (frame.gray == SKY).all()
    assert (frame.classes == 27).all()
    assert (frame.instances == -1).all()


def test_textures_are_neither_turned_nor_mirrored():
    quarters = np.array([[10, 60], [110, 160]], np.uint8)
    picture = np.repeat(quarters[..., None], 3, axis=2)
    bright = Light((0.0, 0.0, 1.0), ambient=1.0, diffuse=0.0)
    frame = drawn(wall(5.0, -2.0, 2.0, -2.0, 2.0), pictures=[picture], light=bright)
    middle, aside = SIZE // 2, 10
    seen = frame.gray[middle - aside :: 2 * aside, middle - aside :: 2 * aside][:2, :2]
    assert np.array_equal(seen, quarters)


def test_textures_are_repeated_and_seen_in_perspective():
    stripes = np.repeat(np.array([[0, 200]], np.uint8)[..., None], 3, axis=2)
    bright = Light((0.0, 0.0, 1.0), ambient=1.0, diffuse=0.0)
    ground = meshes.slab((0.0, -90.0), (90.0, 90.0), -1.5, (8.0, 1.0))
    frame = drawn(ground, pictures=[stripes], light=bright)
    rows = np.arange(SIZE // 2 + 8, SIZE)
    ahead = 1.5 * VIEW.focal / (rows + 1 - SIZE / 2)
    assert np.array_equal(frame.gray[rows, 20] > 100, ahead % 8.0 >= 4.0)


@pytest.mark.parametrize(("towards", "level"), [((-1.0, 0.0, 0.0), 1.0), ((1.0, 0.0, 0.0), 0.5)])
def test_light_falls_on_what_faces_the_sun(towards, level):
    colour = np.array([[[200, 101, 33]]], np.uint8)
    frame = drawn(wall(5.0, -1.0, 1.0), pictures=[colour], light=Light(towards, 0.5, 0.5))
    expected = luma((level * colour).astype(np.uint8))
    assert frame.gray[SIZE // 2, SIZE // 2] == expected[0, 0]


def test_what_is_too_bright_is_white():
    frame = drawn(wall(5.0, -1.0, 1.0), light=Light((-1.0, 0.0, 0.0), 0.9, 0.9))
    assert frame.gray[SIZE // 2, SIZE // 2] == 255


def test_parts_are_moved_turned_and_dressed():
    pictures = (WHITE, np.zeros((1, 1, 3), np.uint8))
    from_the_right = meshes.panel((-0.5, 0.0, -0.5), (0.5, 0.0, 0.5))
    for yaw, shows in ((-0.5 * np.pi, True), (0.5 * np.pi, False)):

        def prepare(scenery, yaw=yaw):
            scenery.put(0, (5.0, 1.0, 0.0), yaw)
            scenery.wear(0, 1)

        frame = drawn(from_the_right, pictures=pictures, prepare=prepare)
        rows, columns = np.nonzero(frame.instances == 0)
        assert bool(len(rows)) == shows
        if shows:
            assert columns.mean() == pytest.approx(SIZE / 2 - VIEW.focal / 5.0, abs=1.0)
            assert (frame.gray[rows, columns] == 0).all()


triangles = st.lists(
    st.lists(
        st.tuples(st.floats(-3.0, 12.0), st.floats(-6.0, 6.0), st.floats(-6.0, 6.0)),
        min_size=3,
        max_size=3,
    ).filter(
        lambda c: np.linalg.norm(np.cross(np.subtract(c[1], c[0]), np.subtract(c[2], c[0]))) > 0.01
    ),
    min_size=1,
    max_size=6,
)


def nearest_by_rays(corners):
    """Return for every pixel the nearest triangle that its ray meets, and how clear a case it is.

    Source: T. Möller and B. Trumbore, "Fast, minimum storage ray-triangle intersection", 1997.
    """
    rows, columns = np.mgrid[:SIZE, :SIZE]
    right, below = (columns - SIZE / 2) / VIEW.focal, (rows + 1 - SIZE / 2) / VIEW.focal
    rays = np.stack([np.ones_like(right), -right, -below], axis=-1)
    depths = np.full((len(corners), SIZE, SIZE), np.inf)
    clear = np.ones((SIZE, SIZE), bool)
    for depth, (a, b, c) in zip(depths, np.asarray(corners, float), strict=True):
        normal = np.cross(b - a, c - a)
        slope = rays @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (a @ normal) / slope
            points = rays * distance[..., None]
            edges = [np.cross(q - p, points - p) @ normal for p, q in ((a, b), (b, c), (c, a))]
            inside = np.min(edges, axis=0) / (normal @ normal)
            meets = (slope < 0.0) & (distance > VIEW.near)
            depth[meets & (inside > 0.0)] = distance[meets & (inside > 0.0)]
            clear &= ~((np.abs(inside) < 0.02) | (np.abs(distance - VIEW.near) < 0.01))
        clear &= np.abs(slope) > 1e-4 * np.linalg.norm(normal)
    if len(depths) > 1:
        first, second = np.partition(np.minimum(depths, 1e9), 1, axis=0)[:2]
        clear &= (second - first > 1e-3 * first) | (first == 1e9)
    bodies = np.where(np.isfinite(depths.min(axis=0)), depths.argmin(axis=0), -1)
    return bodies, clear


@given(triangles)
def test_every_pixel_shows_the_nearest_triangle_that_its_ray_meets(corners):
    expected, clear = nearest_by_rays(corners)
    frame = drawn(*(meshes.polygon(three, Swatch.PAINT) for three in corners))
    assert np.array_equal(frame.instances[clear], expected[clear])


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(2.0, 30.0))
def test_no_gap_shows_between_triangles_that_share_an_edge(across, up, x):
    y, z = 9.0 * (across - 0.5), 9.0 * (up - 0.5)
    corners = [(x, -20.0, -20.0), (x, 20.0, -20.0), (x, 20.0, 20.0), (x, -20.0, 20.0)]
    fan = [meshes.polygon([(x, y, z), corners[i], corners[i - 1]], Swatch.PAINT) for i in range(4)]
    assert (drawn(meshes.merge(*fan)).instances == 0).all()


def test_a_street_is_drawn_the_same_in_every_process():
    code = (
        "import hashlib\n"
        "from env.street.crossing import OccludedCrossing\n"
        "street = OccludedCrossing(traffic='low', perception='none')\n"
        "street.reset(seed=3)\n"
        "frame = street.frame\n"
        "data = frame.gray.tobytes() + frame.classes.tobytes() + frame.instances.tobytes()\n"
        "print(hashlib.sha256(data).hexdigest())\n"
    )
    root = Path(__file__).parents[3]
    digests = {
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root
        ).stdout.split()[-1]
        for _ in range(2)
    }
    assert len(digests) == 1


def test_a_frame_belongs_to_whoever_took_it(street_of):
    """The next frame is drawn on a canvas of its own."""
    street = street_of("low", "full")
    street.reset(seed=1)
    first = street.camera.capture(5.0)
    kept = first.gray.copy(), first.classes.copy(), first.instances.copy()
    street.camera.capture(30.0)
    for array, copied in zip((first.gray, first.classes, first.instances), kept, strict=True):
        assert np.array_equal(array, copied)


def test_both_cameras_of_one_street_follow_its_people(street_of):
    """Poses are pybullet's only when it draws."""
    street = street_of("low", "full")
    street.reset(seed=1)
    tiny = DashCamera(street.world, street.lens, "tiny")
    count = len(street.people)
    nothing = np.zeros(count)
    for x in (30.0, 34.0):
        positions = np.tile([-25.0, -8.0], (count, 1))
        positions[0] = x, -1.75
        street.world.place_people(positions, nothing, nothing, nothing)
        frames = [camera.capture(20.0) for camera in (street.camera, tiny)]
        people = [frame.classes == SemanticClass.PEDESTRIAN for frame in frames]
        assert np.count_nonzero(people[0]) > 50
        assert np.count_nonzero(people[0] != people[1]) <= 3
