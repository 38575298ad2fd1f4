"""Rays cast through the street: what the dash camera could see, without a picture.

One ray leaves the lens through each column of the picture that the dash camera would take. What
stands on the street fills, in each column that it meets, the rows from its top to the ground; what
is nearer hides what is farther. So nothing is seen here that the camera could not see, and all of
it is said in the camera's own terms, rows and columns in px.

All of it is functions of numbers and arrays, compiled; `env.perception.truth` calls `cast`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from env.world.compiled import kernel, part
from vsr.classes import SemanticClass

Array = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.int64]

# A person in m: length of a leg, of a foot before and behind it, half the breadth across the arms;
# and half of what the body fills from head to foot, seen from the front and from the side.
_LEG, _TOE, _HEEL, _ARMS, _FRONT, _SIDE = 0.88, 0.15, 0.07, 0.30, 0.16, 0.12
_LIMBS = 0.07  # share of the columns beside the body that arms and legs fill
_POST_HEIGHT = 3.0  # m; what is above hides nobody from a lens at 1.5 m

UNSEEN = -1  # in place of a ground
_ROAD, _SIDEWALK = int(SemanticClass.ROAD), int(SemanticClass.SIDEWALK)
_CROSSWALK, _PEDESTRIAN = int(SemanticClass.CROSSWALK), int(SemanticClass.PEDESTRIAN)


class Camera(NamedTuple):
    """The dash camera.

    Attributes:
        size: width and height of the picture, in px.
        near: where the view begins, in m.
        focal: focal length, in px.
        height: of the lens above the road, in m.
        horizon: its row, in px.
        middle: the column straight ahead, in px.
        steepness: how far ahead the leftmost ray is after 1 m to the left, in m.
    """

    size: int
    near: float
    focal: float
    height: float
    horizon: float
    middle: float
    steepness: float


class Ground(NamedTuple):
    """The street's ground, as of `env.world.world.StreetGeometry`, in m.

    Attributes:
        ego_lane: y of the middle of ego's lane, in which the lens is.
        near_kerb: y of the kerb on ego's side.
        far_kerb: y of the other kerb.
        kerb_height: of the sidewalks above the road.
        before: x of the crosswalk's near edge.
        after: x of its far edge.
    """

    ego_lane: float
    near_kerb: float
    far_kerb: float
    kerb_height: float
    before: float
    after: float


class Reading(NamedTuple):
    """How a picture would be read, as of `vsr.grounding.SegmentationGrounding`.

    Attributes:
        minimum_area: how much must show of something for it to be seen, in px.
        window: how far below and beside a person is looked, in px.
        road_left: left edge of the carriageway, in m to the right of ego's centre line.
        road_right: its right edge.
        lane_half_width: half the width of ego's lane, in m.
    """

    minimum_area: int
    window: int
    road_left: float
    road_right: float
    lane_half_width: float


class Eye(NamedTuple):
    """All that stays while a street is driven.

    Attributes:
        camera: the dash camera.
        ground: what stands before it.
        reading: how its picture would be read.
        columns: float (W,), of the rays, in px.
        rays: float (W,), how far right of the lens each ray is after 1 m, in m.
    """

    camera: Camera
    ground: Ground
    reading: Reading
    columns: Array
    rays: Array


class Parked(NamedTuple):
    """The vehicles that are parked.

    Attributes:
        hulls: float (V, 3), y of the middle, x of the rear axle and x of the front, in m.
        kinds: int64 (V,), their classes.
        blocks: float (B, 4), the boxes that they are made of: first and last x, half the width, and
            the height, in m.
        owners: int64 (B,), the vehicle that each box belongs to.
    """

    hulls: Array
    kinds: Integers
    blocks: Array
    owners: Integers


class Bodies(NamedTuple):
    """The people.

    Attributes:
        positions: float (N, 2), x and y in m.
        headings: float (N,), in rad from the x axis.
        swings: float (N,), of their legs, in rad.
        heights: float (N,), in m.
    """

    positions: Array
    headings: Array
    swings: Array
    heights: Array


class _Hulls(NamedTuple):
    """Parked vehicles as the rays meet them, each (V, W).

    Attributes:
        depths: float, where each ray enters, in m; infinite where it misses.
        tops: the upper edge in each column, in px.
        bottoms: the lower edge, in px; 0 where the ray misses.
    """

    depths: Array
    tops: Integers
    bottoms: Integers


class _Strips(NamedTuple):
    """People and posts in view as strips that face the camera, the nearest first.

    Attributes:
        depths: float (K,), from the lens along the street, in m.
        looks: int64 (K, 7): whether it is a person; the first column that it fills from top to
            bottom, and the one after the last; likewise of the columns in which some part of it is;
            the row of its upper edge and the row where it meets the ground.
    """

    depths: Array
    looks: Integers


class _Shown(NamedTuple):
    """What is visible of the vehicles of which enough is.

    Attributes:
        boxes: int64 (V, 6): class, top, left, bottom, right, and the place among all K that are
            parked.
        tops: int64 (K, W), the first visible row in each column, in px.
        bottoms: int64 (K, W), the row after the last one; nothing shows where it isn't greater.
    """

    boxes: Integers
    tops: Integers
    bottoms: Integers


class Sight(NamedTuple):
    """Everything that some ray meets: P persons, the nearest first, V vehicles, the crosswalk.

    Attributes:
        things: int64 (E, 6): class; the box's top, left, bottom and right, in px; of a person the
            ground, `UNSEEN` where none shows, and of a vehicle in how many columns it meets the
            road within ego's lane.
        beside: int64 (P, V), how many px of each vehicle lie in the windows beside a person.
        before: int64 (P + 1, V), how many px of each vehicle that is closer lie before a person,
            and, at last, before the crosswalk.
    """

    things: Integers
    beside: Integers
    before: Integers


def cast(lens: float, eye: Eye, posts: Array, parked: Parked, people: Bodies) -> Sight:
    """Return what the dash camera could see.

    Args:
        lens: its x, in m.
        eye: the rest of it.
        posts: float (M, 3), x, y and radius of what else stands upright, in m.
        parked: the parked vehicles.
        people: who walks there.
    """
    fixed = tuple(eye.camera), tuple(eye.ground), tuple(eye.reading), eye.columns, eye.rays
    return Sight(*_cast(lens, fixed, posts, tuple(parked), tuple(people)))


@kernel
def _cast(
    lens: float,
    fixed: tuple[Any, ...],
    posts: Array,
    vehicles: tuple[Any, ...],
    walkers: tuple[Any, ...],
) -> tuple[Integers, Integers, Integers]:
    """Do what `cast` does, with plain tuples."""
    parked, people = Parked(*vehicles), Bodies(*walkers)
    camera, ground, reading, columns, rays = fixed
    eye = Eye(Camera(*camera), Ground(*ground), Reading(*reading), columns, rays)
    minimum_area = eye.reading.minimum_area
    strips = _strips(lens, eye, posts, people)
    hulls = _hulls(lens, eye, parked)
    persons = _persons(strips, hulls, minimum_area)
    bottoms = _unhidden(hulls, strips)
    boxes = _vehicles(hulls.tops, bottoms, parked.kinds, minimum_area)
    shown = _Shown(boxes, hulls.tops, bottoms)
    crosswalk = _crosswalk(lens, eye)
    area = (crosswalk[3] - crosswalk[1]) * (crosswalk[4] - crosswalk[2])
    crosswalks = 1 if area >= minimum_area else 0

    things = np.zeros((len(persons) + len(boxes) + crosswalks, 6), np.int64)
    for person in range(len(persons)):
        things[person, 0] = _PEDESTRIAN
        _copy(persons[person, :4], things[person, 1:5])
        things[person, 5] = _ground_below(lens, eye, persons[person], shown)
    for vehicle in range(len(boxes)):
        _copy(boxes[vehicle], things[len(persons) + vehicle])
        things[len(persons) + vehicle, 5] = _columns_in_lane(eye, shown, vehicle)
    before = np.zeros((len(persons) + 1, len(boxes)), np.int64)
    _count_before_persons(before, persons, shown)
    if crosswalks:
        _copy(crosswalk, things[-1])
        _count_before_crosswalk(before[-1], eye, crosswalk, shown)
    return things, _beside(eye.reading.window, persons, shown), before


@part
def _copy(numbers: Integers, into: Integers) -> None:
    """Copy numbers; an assignment of slices takes numba seconds to compile."""
    for place in range(len(numbers)):
        into[place] = numbers[place]


# What the rays meet


@part
def _row(camera: Camera, height: float, depth: float) -> int:
    """Return the first row that shows what is below a height at a depth, both in m."""
    edge = camera.horizon + camera.focal * (camera.height - height) / depth
    return int(min(max(math.ceil(edge) - 1.0, 0.0), camera.size))


@part
def _column(camera: Camera, right: float, depth: float) -> int:
    """Return the first column that shows what is so far right of the lens at a depth, in m."""
    edge = math.ceil(camera.middle + right * (camera.focal / depth))
    return int(min(max(edge, 0.0), camera.size))


@part
def _strips(lens: float, eye: Eye, posts: Array, people: Bodies) -> _Strips:
    """Return the people and posts in view; posts are people without arms and legs."""
    persons, camera = len(people.positions), eye.camera
    most = persons + len(posts)
    strips = _Strips(np.empty(most), np.empty((most, 7), np.int64))
    order, count = np.empty(most, np.int64), 0
    for number in range(most):
        place = people.positions[number] if number < persons else posts[number - persons]
        depth, right = place[0] - lens, eye.ground.ego_lane - place[1]
        # Nobody's body is broader than with the arms, and no post is.
        if depth > camera.near and (abs(right) - _ARMS) * camera.steepness < depth:
            strips.depths[count] = depth
            if number < persons:
                _look_of_person(strips.looks[count], lens, eye, people, number)
            else:
                _look_of_post(strips.looks[count], lens, eye, place)
            _sort_in(order, count, strips)
            count += 1
    sorted_strips = _Strips(np.empty(count), np.empty((count, 7), np.int64))
    for place in range(count):
        sorted_strips.depths[place] = strips.depths[order[place]]
        _copy(strips.looks[order[place]], sorted_strips.looks[place])
    return sorted_strips


@part
def _look_of_person(look: Integers, lens: float, eye: Eye, people: Bodies, person: int) -> None:
    """Write how a person looks from the lens, as heading and stride make it; see `_Strips`."""
    camera, ground, y = eye.camera, eye.ground, people.positions[person, 1]
    depth, right = people.positions[person, 0] - lens, ground.ego_lane - y
    across, along = math.sin(people.headings[person]), abs(math.cos(people.headings[person]))
    sideways = abs(across)
    swing = _LEG * abs(people.swings[person])
    fore = max((swing + _TOE) * sideways, _ARMS * along)
    rear = max((swing + _HEEL) * sideways, _ARMS * along)
    left, rest = (fore, rear) if across > 0.0 else (rear, fore)
    body = _FRONT * along + _SIDE * sideways
    look[0] = 1
    look[1], look[2] = _column(camera, right - body, depth), _column(camera, right + body, depth)
    look[3], look[4] = _column(camera, right - left, depth), _column(camera, right + rest, depth)
    base = ground.kerb_height if y < ground.near_kerb or y > ground.far_kerb else 0.0
    feet = (swing + _TOE) * along + _HEEL * sideways
    look[5] = _row(camera, base + people.heights[person], depth)
    look[6] = _row(camera, base, max(depth - feet, camera.near))


@part
def _look_of_post(look: Integers, lens: float, eye: Eye, post: Array) -> None:
    """Write how a post looks from the lens; see `_Strips`."""
    camera, radius = eye.camera, post[2]
    depth, right = post[0] - lens, eye.ground.ego_lane - post[1]
    look[0] = 0
    look[1] = look[3] = _column(camera, right - radius, depth)
    look[2] = look[4] = _column(camera, right + radius, depth)
    look[5], look[6] = _row(camera, _POST_HEIGHT, depth), _row(camera, 0.0, depth)


@part
def _sort_in(order: Integers, count: int, strips: _Strips) -> None:
    """Let one more strip take its place among those before it, sorted by depth, then by look."""
    place = count
    while place > 0 and _is_before(count, order[place - 1], strips):
        order[place] = order[place - 1]
        place -= 1
    order[place] = count


@part
def _is_before(one: int, other: int, strips: _Strips) -> bool:
    if strips.depths[one] != strips.depths[other]:
        return strips.depths[one] < strips.depths[other]
    for field in range(strips.looks.shape[1]):
        if strips.looks[one, field] != strips.looks[other, field]:
            return strips.looks[one, field] < strips.looks[other, field]
    return False


@part
def _hulls(lens: float, eye: Eye, parked: Parked) -> _Hulls:
    """Meet the boxes of the vehicles that end before the lens.

    Source: T. L. Kay and J. T. Kajiya, "Ray Tracing Complex Scenes", SIGGRAPH 1986.
    """
    camera, rays = eye.camera, eye.rays
    shape = len(parked.hulls), len(rays)
    depths, tops = np.full(shape, np.inf), np.full(shape, camera.size, np.int64)
    bottoms = np.zeros(shape, np.int64)
    for block in range(len(parked.blocks)):
        vehicle = parked.owners[block]
        if parked.hulls[vehicle, 2] <= lens:
            continue
        start = max(parked.blocks[block, 0] - lens, camera.near)
        end, half = parked.blocks[block, 1] - lens, parked.blocks[block, 2]
        height = parked.blocks[block, 3]
        centre = eye.ground.ego_lane - parked.hulls[vehicle, 0]
        for ray in range(len(rays)):
            left, right = (centre - half) / rays[ray], (centre + half) / rays[ray]
            enter, leave = max(min(left, right), start), min(max(left, right), end)
            if enter >= leave:
                continue
            edge = leave if height < camera.height else enter
            top = _row(camera, height, max(edge, camera.near))
            depths[vehicle, ray] = min(depths[vehicle, ray], enter)
            tops[vehicle, ray] = min(tops[vehicle, ray], top)
    for vehicle in range(len(parked.hulls)):
        # It meets the ground with its wheels.
        axle = parked.hulls[vehicle, 1] - lens
        for ray in range(len(rays)):
            if depths[vehicle, ray] < np.inf:
                bottoms[vehicle, ray] = _row(camera, 0.0, max(depths[vehicle, ray], axle))
    return _Hulls(depths, tops, bottoms)


# What is visible of it


@part
def _persons(strips: _Strips, hulls: _Hulls, minimum_area: int) -> Integers:
    """Return those of whom enough is visible; nearer people and posts hide whole columns.

    People whose pixels touch are one: the picture does not tell them apart.

    Returns:
        int64 (P, 8): the smallest rectangle around what is visible of them, top, left, bottom and
        right; the first column that their bodies fill, hidden or not, and the one after the last;
        likewise of what their arms and legs reach.
    """
    clusters, count = np.empty((len(strips.depths), 8), np.int64), 0
    hidden = np.zeros(hulls.depths.shape[1], np.bool_)
    for strip in range(len(strips.depths)):
        depth, look = strips.depths[strip], strips.looks[strip]
        # Many are too far away, which shows before their pixels are counted.
        if look[0] and (look[6] - look[5]) * (look[4] - look[3]) >= minimum_area:
            heights = _visible_heights(depth, look, hidden, hulls)
            if _see(clusters[count], look, heights, minimum_area):
                count += 0 if _merge(clusters, count) else 1
        for column in range(look[1], look[2]):
            hidden[column] = True
    return clusters[:count]


@part
def _visible_heights(
    depth: float, look: Integers, hidden: npt.NDArray[np.bool_], hulls: _Hulls
) -> Integers:
    """Return how many rows of a strip show in each column of its reach.

    A vehicle before it hides its feet.
    """
    heights = np.zeros(look[4] - look[3], np.int64)
    for place in range(len(heights)):
        column, bottom = look[3] + place, look[6]
        if not hidden[column]:
            for vehicle in range(len(hulls.depths)):
                if hulls.depths[vehicle, column] < depth:
                    bottom = min(bottom, hulls.tops[vehicle, column])
            heights[place] = max(bottom - look[5], 0)
    return heights


@part
def _see(cluster: Integers, look: Integers, heights: Integers, minimum_area: int) -> bool:
    """Write what is visible of one person, and tell whether it is enough.

    Args:
        cluster: int64 (8,), as of `_persons`; is written.
        look: int64 (7,), as of `_Strips`.
        heights: int64, rows that show in each column of its reach.
        minimum_area: what is enough, in px.
    """
    left, count = look[3], len(heights)
    first, last = max(look[1] - left, 0), min(look[2] - left, count)
    pixels = body = lowest = lowest_body = 0
    for place in range(count):
        pixels += heights[place]
        lowest = max(lowest, heights[place])
        if first <= place < last:
            body += heights[place]
            lowest_body = max(lowest_body, heights[place])
    if _area(pixels, body) < minimum_area:
        return False
    shown = shown_body = 0
    begin, end = count, 0
    for place in range(count):
        if heights[place] > 0:
            begin, end = min(begin, place), place + 1
        if heights[place] == lowest:
            shown += lowest
            shown_body += lowest if first <= place < last else 0
    # An arm or two beside a body whose feet are hidden don't show where it stands.
    if body > 0 and _area(shown, shown_body) < minimum_area:
        lowest = lowest_body
    cluster[0], cluster[1] = look[5], left + begin
    cluster[2], cluster[3] = look[5] + lowest, left + end
    _copy(look[1:5], cluster[4:])
    return True


@part
def _area(pixels: int, body: int) -> float:
    """Return how much of a person shows in all these columns, in px, given the body's share."""
    return body + _LIMBS * (pixels - body)


@part
def _merge(clusters: Integers, count: int) -> bool:
    """Merge a cluster, that at `count`, into the first nearer one that it touches, if there is."""
    new = clusters[count]
    for place in range(count):
        old = clusters[place]
        beside = new[4] >= old[7] or new[5] <= old[6]
        if not beside and new[0] <= old[2] and old[0] <= new[2]:
            for low in (0, 1, 4, 6):
                old[low] = min(old[low], new[low])
            for high in (2, 3, 5, 7):
                old[high] = max(old[high], new[high])
            return True
    return False


@part
def _unhidden(hulls: _Hulls, strips: _Strips) -> Integers:
    """Return the lower edge of what shows of each vehicle, (V, W); others may stand before it."""
    bottoms = hulls.bottoms.copy()
    for vehicle in range(len(bottoms)):
        for other in range(len(bottoms)):
            for ray in range(bottoms.shape[1]):
                if hulls.depths[other, ray] < hulls.depths[vehicle, ray]:
                    bottoms[vehicle, ray] = min(bottoms[vehicle, ray], hulls.tops[other, ray])
        for strip in range(len(strips.depths)):
            top = strips.looks[strip, 5]
            for ray in range(strips.looks[strip, 1], strips.looks[strip, 2]):
                if strips.depths[strip] < hulls.depths[vehicle, ray]:
                    bottoms[vehicle, ray] = min(bottoms[vehicle, ray], top)
    return bottoms


@part
def _vehicles(tops: Integers, bottoms: Integers, kinds: Integers, minimum_area: int) -> Integers:
    """Return the vehicles of which enough is visible.

    Returns:
        int64 (V', 6): class, top, left, bottom, right, and the place among all that are parked.
    """
    boxes, count = np.empty((len(tops), 6), np.int64), 0
    for vehicle in range(len(tops)):
        box, pixels = boxes[count], 0
        box[0], box[5] = kinds[vehicle], vehicle
        box[1], box[2], box[3], box[4] = tops.shape[1], tops.shape[1], 0, 0
        for ray in range(tops.shape[1]):
            top, bottom = tops[vehicle, ray], bottoms[vehicle, ray]
            if bottom > top:
                pixels += bottom - top
                box[1], box[2] = min(box[1], top), min(box[2], ray)
                box[3], box[4] = max(box[3], bottom), ray + 1
        count += 1 if pixels >= minimum_area else 0
    return boxes[:count]


@part
def _crosswalk(lens: float, eye: Eye) -> Integers:
    """Return the crosswalk as of `Sight.things`, of no area behind the lens.

    Somewhere across the road each row shows it.
    """
    camera, ground, found = eye.camera, eye.ground, np.zeros(6, np.int64)
    if ground.after - lens > camera.near:
        found[0] = _CROSSWALK
        found[1] = _row(camera, 0.0, ground.after - lens)
        found[3] = _row(camera, 0.0, max(ground.before - lens, camera.near))
        scale = (found[3] - camera.horizon) / camera.height
        left = camera.middle + (ground.ego_lane - ground.far_kerb) * scale
        right = camera.middle + (ground.ego_lane - ground.near_kerb) * scale
        found[2], found[4] = max(int(left), 0), min(int(right), camera.size)
    return found


# What that says


@part
def _ground_below(lens: float, eye: Eye, person: Integers, shown: _Shown) -> int:
    """Return the ground that shows first below the middle of a person's visible part.

    `vsr.facts.ground_of` lets each row count twice as much as the next, so the first decides.
    """
    camera, ground = eye.camera, eye.ground
    # Where the picture ends at the feet, the ground below is what it shows last.
    first = min(person[2], camera.size - 1)
    column = (person[1] + person[3]) // 2
    for row in range(first, min(first + eye.reading.window, camera.size)):
        below = row + 1 - camera.horizon
        if below <= 0.0 or _is_covered(row, column, shown):
            continue
        depth = camera.focal * camera.height / below
        y = ground.ego_lane - eye.rays[column] * depth
        if not ground.near_kerb <= y <= ground.far_kerb:
            return _SIDEWALK
        return _CROSSWALK if ground.before <= lens + depth < ground.after else _ROAD
    return UNSEEN


@part
def _is_covered(row: int, column: int, shown: _Shown) -> bool:
    """Tell whether a pixel is some vehicle's."""
    for vehicle in range(len(shown.boxes)):
        own = shown.boxes[vehicle, 5]
        if shown.tops[own, column] <= row < shown.bottoms[own, column]:
            return True
    return False


@part
def _beside(window: int, persons: Integers, shown: _Shown) -> Integers:
    """Return how many pixels of each vehicle lie in the windows beside each person, (P, V)."""
    pixels = np.zeros((len(persons), len(shown.boxes)), np.int64)
    for person in range(len(persons)):
        rows = persons[person, 0], persons[person, 2]
        left, right = persons[person, 1], persons[person, 3]
        for vehicle in range(len(shown.boxes)):
            before = _pixels(shown, vehicle, (max(left - window, 0), left), rows)
            after = _pixels(shown, vehicle, (right, right + window), rows)
            pixels[person, vehicle] = before + after
    return pixels


@part
def _count_before_persons(pixels: Integers, persons: Integers, shown: _Shown) -> None:
    """Write how many pixels of each vehicle that is closer lie before or touch each person."""
    for person in range(len(persons)):
        columns, bottom = (persons[person, 6], persons[person, 7]), persons[person, 2]
        for vehicle in range(len(shown.boxes)):
            if shown.boxes[vehicle, 3] > bottom:
                rows = persons[person, 0], bottom + 1
                pixels[person, vehicle] = _pixels(shown, vehicle, columns, rows)


@part
def _pixels(shown: _Shown, vehicle: int, columns: tuple[int, int], rows: tuple[int, int]) -> int:
    """Return how many pixels of a vehicle lie in a rectangle, which may reach beyond the right."""
    own, pixels = shown.boxes[vehicle, 5], 0
    for column in range(columns[0], min(columns[1], shown.tops.shape[1])):
        first, last = (
            max(shown.tops[own, column], rows[0]),
            min(shown.bottoms[own, column], rows[1]),
        )
        pixels += max(last - first, 0)
    return pixels


@part
def _columns_in_lane(eye: Eye, shown: _Shown, vehicle: int) -> int:
    """Return in how many columns a vehicle meets the road within ego's lane."""
    camera, own, count = eye.camera, shown.boxes[vehicle, 5], 0
    for column in range(shown.boxes[vehicle, 2], shown.boxes[vehicle, 4]):
        bottom = shown.bottoms[own, column]
        scale = (bottom - camera.horizon) / camera.height
        if bottom > shown.tops[own, column] and scale > 0.0:
            lateral = (eye.columns[column] - camera.middle) / scale
            count += 1 if abs(lateral) < eye.reading.lane_half_width else 0
    return count


@part
def _count_before_crosswalk(pixels: Integers, eye: Eye, crosswalk: Integers, shown: _Shown) -> None:
    """Write how many pixels of each vehicle that is closer lie before the crosswalk.

    It is taken to reach from kerb to kerb.
    """
    camera = eye.camera
    for vehicle in range(len(shown.boxes)):
        box = shown.boxes[vehicle]
        if 2 * box[3] <= crosswalk[1] + crosswalk[3]:
            continue
        for top in range(crosswalk[1], crosswalk[3]):
            row = top + 0.5
            scale = max(row - camera.horizon, 0.0) / camera.height
            left = camera.middle + eye.reading.road_left * scale
            right = camera.middle + eye.reading.road_right * scale
            for column in range(box[2], box[4]):
                inside = left < eye.columns[column] < right
                if inside and shown.tops[box[5], column] < row < shown.bottoms[box[5], column]:
                    pixels[vehicle] += 1
