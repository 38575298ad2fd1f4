"""The compiled rays meet what plain numpy, picture by picture, says that they meet."""

import math

import numpy as np
import pytest

from env.perception.ray_casting import UNSEEN, Bodies, Camera, Eye, Ground, Parked, Reading, cast
from env.world.world import StreetGeometry
from vsr.classes import SemanticClass
from vsr.facts import Pinhole
from vsr.grounding import Camera as Lens

SIZE = 224
STREET = StreetGeometry()
PINHOLE = Pinhole.of(Lens(), (SIZE, SIZE))
COLUMNS = np.arange(SIZE) + 1e-6
RAYS = (COLUMNS - PINHOLE.middle) / PINHOLE.focal
CAMERA = Camera(
    SIZE, 0.3, PINHOLE.focal, PINHOLE.height, PINHOLE.horizon, PINHOLE.middle, -1.0 / RAYS[0]
)
GROUND = Ground(
    STREET.ego_lane, STREET.near_kerb, STREET.far_kerb, STREET.kerb_height, *STREET.crosswalk
)
READING = Reading(6, 15, -5.25, 4.05, 1.75)
EYE = Eye(CAMERA, GROUND, READING, COLUMNS, RAYS)
# A car behind a truck, both along the kerb.
PARKED = Parked(
    hulls=np.array([[-4.6, 54.0, 58.8], [-4.6, 46.5, 51.8]]),
    kinds=np.array([SemanticClass.TRUCK, SemanticClass.VEHICLE], np.int64),
    blocks=np.array([[52.8, 57.1, 1.0, 2.7], [57.1, 58.8, 0.95, 1.25], [47.5, 51.8, 0.9, 0.9]]),
    owners=np.array([0, 0, 1], np.int64),
)
ROWS = np.arange(SIZE)[:, None]


def rows(height, depth):
    edges = PINHOLE.horizon + PINHOLE.focal * (PINHOLE.height - height) / depth
    return np.clip(np.ceil(edges) - 1, 0, SIZE)


def crowd(seed):
    rng = np.random.default_rng(seed)
    count = 30
    x, y = rng.uniform(20.0, 90.0, count), rng.uniform(-8.0, 6.0, count)
    headings, swings = rng.uniform(-7.0, 7.0, count), rng.uniform(-0.5, 0.5, count)
    posts = np.stack(
        [rng.uniform(20.0, 90.0, 8), rng.choice([-6.3, 4.0], 8), np.full(8, 0.14)], axis=1
    )
    people = Bodies(np.stack([x, y], axis=1), headings, swings, rng.uniform(1.1, 1.9, count))
    return rng.uniform(15.0, 62.0), posts, people


def hulls_of(lens):
    """Return depths, upper and lower edges, each (V, W), of the parked vehicles."""
    depths = np.full((2, SIZE), np.inf)
    tops, bottoms = np.full((2, SIZE), float(SIZE)), np.zeros((2, SIZE))
    for (start, end, half, height), own in zip(PARKED.blocks, PARKED.owners, strict=True):
        if PARKED.hulls[own, 2] <= lens:
            continue
        centre = STREET.ego_lane - PARKED.hulls[own, 0]
        sides = np.stack([(centre - half) / RAYS, (centre + half) / RAYS])
        enter = np.maximum(sides.min(axis=0), max(start - lens, 0.3))
        leave = np.minimum(sides.max(axis=0), end - lens)
        edge = np.maximum(leave if height < PINHOLE.height else enter, 0.3)
        met = enter < leave
        depths[own] = np.where(met, np.minimum(depths[own], enter), depths[own])
        tops[own] = np.where(met, np.minimum(tops[own], rows(height, edge)), tops[own])
    for own in range(2):
        met = np.isfinite(depths[own])
        axle = PARKED.hulls[own, 1] - lens
        bottoms[own, met] = rows(0.0, np.maximum(depths[own, met], axle))
    return depths, tops, bottoms


def strips_of(lens, posts, people):
    """Return (depth, person, body, reach, top, bottom) of all in view, the nearest first."""

    def columns(right, half_left, half_right, depth):
        edges = np.array([right - half_left, right + half_right]) * (PINHOLE.focal / depth)
        return tuple(np.clip(np.ceil(PINHOLE.middle + edges), 0, SIZE).astype(int).tolist())

    def is_in_view(depth, right):
        return depth > 0.3 and (abs(right) - 0.3) * CAMERA.steepness < depth

    strips = []
    for (x, y), heading, swing, height in zip(*people, strict=True):
        depth, right = x - lens, STREET.ego_lane - y
        if is_in_view(depth, right):
            along, sideways = abs(np.cos(heading)), abs(np.sin(heading))
            body = 0.16 * along + 0.12 * sideways
            toe, heel = 0.88 * abs(swing) + 0.15, 0.88 * abs(swing) + 0.07
            limbs = [max(toe * sideways, 0.3 * along), max(heel * sideways, 0.3 * along)]
            limbs = limbs if np.sin(heading) > 0 else limbs[::-1]
            base = STREET.kerb_height if STREET.on_sidewalk(y) else 0.0
            feet = max(depth - toe * along - 0.07 * sideways, 0.3)
            looks = columns(right, body, body, depth), columns(right, *limbs, depth)
            ends = int(rows(base + height, depth)), int(rows(base, feet))
            strips.append((depth, True, *looks, *ends))
    for x, y, radius in posts:
        depth, right = x - lens, STREET.ego_lane - y
        if is_in_view(depth, right):
            look = columns(right, radius, radius, depth)
            strips.append((depth, False, look, look, int(rows(3.0, depth)), int(rows(0.0, depth))))
    return sorted(strips)


def clusters_of(strips, depths, tops):
    """Return (box, body, reach) of those of whom enough is visible, merged where they touch."""
    clusters, hidden = [], np.zeros(SIZE, bool)
    for depth, person, body, reach, top, bottom in strips:
        columns = np.arange(SIZE)
        of_reach = (columns >= reach[0]) & (columns < reach[1])
        of_body = of_reach & (columns >= body[0]) & (columns < body[1])
        lowest = np.where(depths < depth, np.minimum(tops, bottom), bottom).min(axis=0)
        heights = np.where(of_reach & ~hidden, np.maximum(lowest - top, 0), 0).astype(int)

        def area(some, of_body=of_body):
            return some[of_body].sum() + 0.07 * (some.sum() - some[of_body].sum())

        if person and area(heights) >= READING.minimum_area:
            shown, feet = heights[of_body].any(), heights.max()
            if shown and area(np.where(heights == feet, feet, 0)) < READING.minimum_area:
                feet = heights[of_body].max()
            (seen,) = heights.nonzero()
            box = [top, seen[0], top + feet, seen[-1] + 1]
            for other, its_body, its_reach in clusters:
                beside = body[0] >= its_reach[1] or body[1] <= its_reach[0]
                if not beside and box[0] <= other[2] and other[0] <= box[2]:
                    other[:2] = np.minimum(other[:2], box[:2])
                    other[2:] = np.maximum(other[2:], box[2:])
                    its_body[:] = min(its_body[0], body[0]), max(its_body[1], body[1])
                    its_reach[:] = min(its_reach[0], reach[0]), max(its_reach[1], reach[1])
                    break
            else:
                clusters.append((box, list(body), list(reach)))
        hidden[body[0] : body[1]] = True
    return clusters


def masks_of(strips, depths, tops, bottoms):
    """Return the pixels of each vehicle of which enough shows, with its place: (V, mask)."""
    for own in range(2):
        lowest = bottoms[own].copy()
        for other in range(2):
            lowest = np.where(depths[other] < depths[own], np.minimum(lowest, tops[other]), lowest)
        for depth, _, (first, last), _, top, _ in strips:
            part = slice(first, last)
            nearer = depth < depths[own, part]
            lowest[part] = np.where(nearer, np.minimum(lowest[part], top), lowest[part])
        mask = (tops[own] <= ROWS) & (lowest > ROWS)
        if mask.sum() >= READING.minimum_area:
            yield own, lowest, mask


def ground_below(lens, box, vehicles):
    column, first = (box[1] + box[3]) // 2, min(box[2], SIZE - 1)
    for row in range(first, min(first + READING.window, SIZE)):
        depth = PINHOLE.distance(row + 1)
        if math.isinf(depth) or any(mask[row, column] for *_, mask in vehicles):
            continue
        if STREET.on_sidewalk(STREET.ego_lane - RAYS[column] * depth):
            return SemanticClass.SIDEWALK
        across = STREET.crosswalk[0] <= lens + depth < STREET.crosswalk[1]
        return SemanticClass.CROSSWALK if across else SemanticClass.ROAD
    return UNSEEN


def crosswalk_of(lens):
    before, after = (edge - lens for edge in STREET.crosswalk)
    if after <= 0.3:
        return None
    top, bottom = int(rows(0.0, after)), int(rows(0.0, max(before, 0.3)))
    scale = (bottom - PINHOLE.horizon) / PINHOLE.height
    sides = STREET.ego_lane - STREET.far_kerb, STREET.ego_lane - STREET.near_kerb
    left, right = (int(PINHOLE.middle + side * scale) for side in sides)
    box = [top, max(left, 0), bottom, min(right, SIZE)]
    area = (box[2] - box[0]) * (box[3] - box[1])
    return box if area >= READING.minimum_area else None


@pytest.mark.parametrize("seed", range(40))
def test_rays_meet_what_a_picture_of_the_same_shapes_shows(seed):
    lens, posts, people = crowd(seed)
    depths, tops, bottoms = hulls_of(lens)
    strips = strips_of(lens, posts, people)
    persons = clusters_of(strips, depths, tops)
    vehicles = list(masks_of(strips, depths, tops, bottoms))
    crosswalk = crosswalk_of(lens)

    things, beside, before = [], [], []
    for box, _, reach in persons:
        top, left, bottom, right = box
        things.append([SemanticClass.PEDESTRIAN, *box, ground_below(lens, box, vehicles)])
        masks = [mask for *_, mask in vehicles]
        window = [slice(max(left - 15, 0), left), slice(right, right + 15)]
        beside.append([sum(mask[top:bottom, w].sum() for w in window) for mask in masks])
        nearer = [np.flatnonzero(mask.any(axis=1))[-1] + 1 > bottom for mask in masks]
        touched = [mask[top : bottom + 1, slice(*reach)].sum() for mask in masks]
        before.append(np.multiply(nearer, touched).tolist())
    last = [0] * len(vehicles)
    for place, (own, lowest, mask) in enumerate(vehicles):
        (down,), (across,) = mask.any(axis=1).nonzero(), mask.any(axis=0).nonzero()
        box = [down[0], across[0], down[-1] + 1, across[-1] + 1]
        meets = np.abs(PINHOLE.laterals(COLUMNS, lowest)) < READING.lane_half_width
        things.append([PARKED.kinds[own], *box, (meets & mask.any(axis=0)).sum()])
        if crosswalk and box[2] > (crosswalk[0] + crosswalk[2]) / 2:
            left, right = (PINHOLE.columns(side, ROWS + 0.5) for side in READING[2:4])
            road = (left < COLUMNS) & (right > COLUMNS)
            last[place] = (road & mask)[crosswalk[0] : crosswalk[2]].sum()
    if crosswalk:
        things.append([SemanticClass.CROSSWALK, *crosswalk, 0])

    sight = cast(lens, EYE, posts, PARKED, people)
    assert sight.things.tolist() == [list(map(int, thing)) for thing in things]
    assert sight.beside.tolist() == beside
    assert sight.before.tolist() == [*before, last]


def test_the_scenes_of_this_test_have_all_that_rays_can_meet():
    sights = [
        cast(lens, EYE, posts, PARKED, people) for lens, posts, people in map(crowd, range(40))
    ]
    kinds = np.concatenate([sight.things[:, 0] for sight in sights])
    assert set(kinds.tolist()) == {12, 14, 15, 27}
    grounds = {int(t[5]) for s in sights for t in s.things if t[0] == SemanticClass.PEDESTRIAN}
    assert grounds == {UNSEEN, *map(int, (SemanticClass.ROAD, SemanticClass.SIDEWALK, 27))}
    assert any(sight.beside.any() for sight in sights)
    assert any(sight.before[:-1].any() for sight in sights)
    assert any(sight.before[-1].any() for sight in sights)
