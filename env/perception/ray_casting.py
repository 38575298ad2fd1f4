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


@kernel
def cast(
    lens: float,
    camera: Camera,
    ground: Ground,
    reading: Reading,
    columns: Array,
    rays: Array,
    posts: Array,
    parked: Parked,
    people: Bodies,
) -> Sight:
    """Return what the dash camera could see.

    Args:
        lens: its x, in m.
        camera: the rest of it.
        ground: what it stands on.
        reading: how a picture would be read.
        columns: float (W,), of the rays, in px.
        rays: float (W,), how far right of the lens each ray is after 1 m, in m.
        posts: float (M, 3), x, y and radius of what else stands upright, in m.
        parked: the parked vehicles.
        people: who walks there.
    """
    strips = _strips(lens, camera, ground, posts, people)
    hulls = _hulls(lens, camera, ground, rays, parked)
    persons = _persons(strips, hulls, camera.size, reading.minimum_area)
    shown = _unhidden(hulls, strips)
    vehicles = _vehicles(hulls.tops, shown, parked.kinds, reading.minimum_area)
    crosswalk = _crosswalk(lens, camera, ground)
    area = (crosswalk[3] - crosswalk[1]) * (crosswalk[4] - crosswalk[2])
    zebras = 1 if area >= reading.minimum_area else 0

    things = np.zeros((len(persons) + len(vehicles) + zebras, 6), np.int64)
    beside = np.zeros((len(persons), len(vehicles)), np.int64)
    before = np.zeros((len(persons) + 1, len(vehicles)), np.int64)
    for person in range(len(persons)):
        top, left, bottom, right = persons[person, :4]
        things[person, 0] = _PEDESTRIAN
        things[person, 1:5] = persons[person, :4]
        things[person, 5] = _ground_below(
            lens, camera, ground, rays, reading.window, persons[person], hulls.tops, shown, vehicles
        )
    for vehicle in range(len(vehicles)):
        own, box = vehicles[vehicle, 5], vehicles[vehicle]
        tops, bottoms = hulls.tops[own], shown[own]
        place = len(persons) + vehicle
        things[place, :5] = box[:5]
        things[place, 5] = _columns_in_lane(camera, reading, columns, box, tops, bottoms)
        for person in range(len(persons)):
            top, left, bottom, right, _, _, first, last = persons[person]
            beside[person, vehicle] = _pixels(
                tops, bottoms, max(left - reading.window, 0), left, top, bottom
            ) + _pixels(tops, bottoms, right, right + reading.window, top, bottom)
            if box[3] > bottom:
                before[person, vehicle] = _pixels(tops, bottoms, first, last, top, bottom + 1)
        if zebras and 2 * box[3] > crosswalk[1] + crosswalk[3]:
            before[-1, vehicle] = _before_crosswalk(
                camera, reading, columns, crosswalk, box, tops, bottoms
            )
    if zebras:
        things[-1] = crosswalk
    return Sight(things, beside, before)


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
def _strips(
    lens: float, camera: Camera, ground: Ground, posts: Array, people: Bodies
) -> _Strips:
    """Return the people and posts in view; posts are people without arms and legs."""
    most = len(people.positions) + len(posts)
    depths, looks, order = np.empty(most), np.empty((most, 7), np.int64), np.empty(most, np.int64)
    count = 0
    for number in range(most):
        person = number < len(people.positions)
        own = number if person else number - len(people.positions)
        x, y = people.positions[own] if person else posts[own, :2]
        depth, right = x - lens, ground.ego_lane - y
        # Nobody's body is broader than with the arms, and no post is.
        if not (depth > camera.near and (abs(right) - _ARMS) * camera.steepness < depth):
            continue
        depths[count] = depth
        if person:
            _look_of_person(looks[count], depth, right, y, own, camera, ground, people)
        else:
            _look_of_post(looks[count], depth, right, posts[own, 2], camera)
        _sort_in(order, count, depths, looks)
        count += 1
    return _Strips(depths[order[:count]], looks[order[:count]])


@part
def _look_of_person(
    look: Integers,
    depth: float,
    right: float,
    y: float,
    person: int,
    camera: Camera,
    ground: Ground,
    people: Bodies,
) -> None:
    """Write how a person looks from the lens, as heading and stride make it; see `_Strips`."""
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
def _look_of_post(
    look: Integers, depth: float, right: float, radius: float, camera: Camera
) -> None:
    """Write how a post looks from the lens; see `_Strips`."""
    look[0] = 0
    look[1] = look[3] = _column(camera, right - radius, depth)
    look[2] = look[4] = _column(camera, right + radius, depth)
    look[5], look[6] = _row(camera, _POST_HEIGHT, depth), _row(camera, 0.0, depth)


@part
def _sort_in(order: Integers, count: int, depths: Array, looks: Integers) -> None:
    """Let one more strip take its place among those before it, sorted by depth, then by look."""
    place = count
    while place > 0 and _is_before(count, order[place - 1], depths, looks):
        order[place] = order[place - 1]
        place -= 1
    order[place] = count


@part
def _is_before(one: int, other: int, depths: Array, looks: Integers) -> bool:
    if depths[one] != depths[other]:
        return depths[one] < depths[other]
    for field in range(looks.shape[1]):
        if looks[one, field] != looks[other, field]:
            return looks[one, field] < looks[other, field]
    return False


@part
def _hulls(lens: float, camera: Camera, ground: Ground, rays: Array, parked: Parked) -> _Hulls:
    """Meet the boxes of the vehicles that end before the lens.

    Source: T. L. Kay and J. T. Kajiya, "Ray Tracing Complex Scenes", SIGGRAPH 1986.
    """
    shape = len(parked.hulls), len(rays)
    depths, tops = np.full(shape, np.inf), np.full(shape, camera.size, np.int64)
    bottoms = np.zeros(shape, np.int64)
    for block in range(len(parked.blocks)):
        vehicle = parked.owners[block]
        if parked.hulls[vehicle, 2] <= lens:
            continue
        start, end, half, height = parked.blocks[block]
        centre = ground.ego_lane - parked.hulls[vehicle, 0]
        start, end = max(start - lens, camera.near), end - lens
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
def _persons(strips: _Strips, hulls: _Hulls, size: int, minimum_area: int) -> Integers:
    """Return those of whom enough is visible; nearer people and posts hide whole columns.

    People whose pixels touch are one: the picture does not tell them apart.

    Returns:
        int64 (P, 8): the smallest rectangle around what is visible of them, top, left, bottom and
        right; the first column that their bodies fill, hidden or not, and the one after the last;
        likewise of what their arms and legs reach.
    """
    clusters = np.empty((len(strips.depths), 8), np.int64)
    hidden, heights = np.zeros(size, np.bool_), np.zeros(size, np.int64)
    count = 0
    for strip in range(len(strips.depths)):
        look = strips.looks[strip]
        if look[0] and _see(
            clusters[count], heights, strips.depths[strip], look, hidden, hulls, minimum_area
        ):
            count += 0 if _merge(clusters, count) else 1
        hidden[look[1] : look[2]] = True
    return clusters[:count]


@part
def _see(
    cluster: Integers,
    heights: Integers,
    depth: float,
    look: Integers,
    hidden: npt.NDArray[np.bool_],
    hulls: _Hulls,
    minimum_area: int,
) -> bool:
    """Write what is visible of one person, and tell whether it is enough.

    `heights` (W,) gets the number of its rows that show in each column of its reach.
    """
    _, first, last, left, rest, top, bottom = look
    # Many are too far away, which shows before their pixels are counted.
    if (bottom - top) * (rest - left) < minimum_area:
        return False
    pixels = body = lowest = lowest_body = 0
    for column in range(left, rest):
        heights[column] = _visible_height(column, depth, top, bottom, hidden, hulls)
        pixels += heights[column]
        lowest = max(lowest, heights[column])
        if first <= column < last:
            body += heights[column]
            lowest_body = max(lowest_body, heights[column])
    if _area(pixels, body) < minimum_area:
        return False
    shown = shown_body = 0
    begin, end = rest, left
    for column in range(left, rest):
        if heights[column] > 0:
            begin, end = min(begin, column), column + 1
        if heights[column] == lowest:
            shown += lowest
            shown_body += lowest if first <= column < last else 0
    # An arm or two beside a body whose feet are hidden don't show where it stands.
    if body > 0 and _area(shown, shown_body) < minimum_area:
        lowest = lowest_body
    cluster[0], cluster[1], cluster[2], cluster[3] = top, begin, top + lowest, end
    cluster[4], cluster[5], cluster[6], cluster[7] = first, last, left, rest
    return True


@part
def _visible_height(
    column: int, depth: float, top: int, bottom: int, hidden: npt.NDArray[np.bool_], hulls: _Hulls
) -> int:
    """Return how many rows of a strip show in a column: a vehicle before it hides its feet."""
    if hidden[column]:
        return 0
    for vehicle in range(len(hulls.depths)):
        if hulls.depths[vehicle, column] < depth:
            bottom = min(bottom, hulls.tops[vehicle, column])
    return max(bottom - top, 0)


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
def _crosswalk(lens: float, camera: Camera, ground: Ground) -> Integers:
    """Return the crosswalk as of `Sight.things`, of no area behind the lens.

    Somewhere across the road each row shows it.
    """
    found = np.zeros(6, np.int64)
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
def _ground_below(
    lens: float,
    camera: Camera,
    ground: Ground,
    rays: Array,
    window: int,
    person: Integers,
    tops: Integers,
    bottoms: Integers,
    vehicles: Integers,
) -> int:
    """Return the ground that shows first below the middle of a person's visible part.

    `vsr.facts.ground_of` lets each row count twice as much as the next, so the first decides.
    """
    # Where the picture ends at the feet, the ground below is what it shows last.
    first = min(person[2], camera.size - 1)
    column = (person[1] + person[3]) // 2
    for row in range(first, min(first + window, camera.size)):
        below = row + 1 - camera.horizon
        if below <= 0.0 or _is_covered(row, column, tops, bottoms, vehicles):
            continue
        depth = camera.focal * camera.height / below
        y = ground.ego_lane - rays[column] * depth
        if not ground.near_kerb <= y <= ground.far_kerb:
            return _SIDEWALK
        return _CROSSWALK if ground.before <= lens + depth < ground.after else _ROAD
    return UNSEEN


@part
def _is_covered(
    row: int, column: int, tops: Integers, bottoms: Integers, vehicles: Integers
) -> bool:
    """Tell whether a pixel is some vehicle's."""
    for vehicle in range(len(vehicles)):
        own = vehicles[vehicle, 5]
        if tops[own, column] <= row < bottoms[own, column]:
            return True
    return False


@part
def _pixels(
    tops: Integers, bottoms: Integers, left: int, right: int, top: int, bottom: int
) -> int:
    """Return how many pixels of a vehicle lie in a rectangle, which may reach beyond the right."""
    pixels = 0
    for ray in range(left, min(right, len(tops))):
        pixels += max(min(bottoms[ray], bottom) - max(tops[ray], top), 0)
    return pixels


@part
def _columns_in_lane(
    camera: Camera, reading: Reading, columns: Array, box: Integers, tops: Integers, bottoms: Integers
) -> int:
    """Return in how many columns a vehicle meets the road within ego's lane."""
    count = 0
    for ray in range(box[2], box[4]):
        scale = (bottoms[ray] - camera.horizon) / camera.height
        if bottoms[ray] > tops[ray] and scale > 0.0:
            lateral = (columns[ray] - camera.middle) / scale
            count += 1 if abs(lateral) < reading.lane_half_width else 0
    return count


@part
def _before_crosswalk(
    camera: Camera,
    reading: Reading,
    columns: Array,
    crosswalk: Integers,
    box: Integers,
    tops: Integers,
    bottoms: Integers,
) -> int:
    """Return how many pixels of a vehicle lie before the crosswalk, taken from kerb to kerb."""
    pixels = 0
    for top in range(crosswalk[1], crosswalk[3]):
        row = top + 0.5
        scale = max(row - camera.horizon, 0.0) / camera.height
        left = camera.middle + reading.road_left * scale
        right = camera.middle + reading.road_right * scale
        for ray in range(box[2], box[4]):
            if left < columns[ray] < right and tops[ray] < row < bottoms[ray]:
                pixels += 1
    return pixels
