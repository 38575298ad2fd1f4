"""What the camera sees: the right classes in the right places."""

import numpy as np
import pytest

from env.world.camera import DashCamera, luma
from env.world.world import StreetGeometry
from vsr.classes import SemanticClass


def frame_at(street, front, people=()):
    """Take a frame with these people, (x, y) each, and everybody else out of the way."""
    count = len(street.people)
    positions = np.tile([-25.0, -8.0], (count, 1))
    positions[: len(people)] = np.reshape(people, (-1, 2))
    nothing = np.zeros(count)
    street.world.place_people(positions, nothing, nothing, nothing)
    return street.camera.capture(front)


def share(frame, kind):
    return np.mean(frame.classes == kind)


@pytest.fixture(scope="module", params=["partial", "full"])
def street(request, street_of):
    street = street_of("low", request.param)
    street.reset(seed=1)
    return street


def test_the_frame_has_the_street_s_classes(street):
    frame = frame_at(street, 47.0, [(62.0, -1.75)])
    parked = SemanticClass.TRUCK if street.occlusion == "full" else SemanticClass.VEHICLE
    absent = SemanticClass.VEHICLE if street.occlusion == "full" else SemanticClass.TRUCK
    assert frame.gray.shape == frame.classes.shape == frame.instances.shape == (224, 224)
    assert (frame.gray.dtype, frame.classes.dtype) == (np.uint8, np.uint8)
    assert frame.instances.dtype == np.int32
    assert share(frame, SemanticClass.ROAD) > 0.2
    assert share(frame, SemanticClass.SKY) > 0.1
    assert share(frame, SemanticClass.BUILDING) > 0.1
    assert share(frame, SemanticClass.CROSSWALK) > 0.005
    assert share(frame, parked) > 0.01
    assert share(frame, SemanticClass.PEDESTRIAN) > 0.001
    assert share(frame, absent) == 0.0


def test_sky_belongs_to_no_body(street):
    frame = frame_at(street, 10.0)
    assert np.array_equal(frame.instances == -1, frame.classes == SemanticClass.SKY)


def test_each_person_is_one_instance(street):
    frame = frame_at(street, 40.0, [(52.0, -2.5), (55.0, 0.5)])
    people = frame.instances[frame.classes == SemanticClass.PEDESTRIAN]
    assert len(np.unique(people)) == 2


def test_feet_are_where_the_pinhole_says(street):
    lens = street.lens
    for ahead, right in ((8.0, 0.0), (15.0, 2.0), (25.0, -3.0)):
        x, y = 30.0 - lens.setback + ahead, street.corridor.centre - right
        frame = frame_at(street, 30.0, [(x, y)])
        rows, columns = np.nonzero(frame.classes == SemanticClass.PEDESTRIAN)
        scale = lens.pinhole.focal / ahead
        assert rows.max() + 1 == pytest.approx(112 + scale * lens.height, abs=1.5)
        assert columns.mean() == pytest.approx(112 + scale * right, abs=2.0)


def test_the_crosswalk_is_where_the_pinhole_says(street):
    lens = street.lens
    frame = frame_at(street, 45.0)
    rows, _ = np.nonzero(frame.classes == SemanticClass.CROSSWALK)
    before, after = (edge - 45.0 + lens.setback for edge in street.world.geometry.crosswalk)
    drop = lens.pinhole.focal * lens.height
    assert rows.max() + 1 == pytest.approx(112 + drop / before, abs=1.0)
    assert rows.min() == pytest.approx(112 + drop / after, abs=1.0)


def test_stripes_are_white_on_dark(street):
    frame = frame_at(street, 45.0)
    zebra = frame.gray[frame.classes == SemanticClass.CROSSWALK].astype(float)
    assert np.percentile(zebra, 90) - np.percentile(zebra, 10) > 100


def test_a_box_truck_hides_more_than_a_car(street_of):
    seen = {}
    for occlusion in ("partial", "full"):
        street = street_of("low", occlusion)
        street.reset(seed=1)
        waiting = (62.0, street.world.geometry.near_kerb - 0.4)
        frame = frame_at(street, 20.0, [waiting])
        seen[occlusion] = np.count_nonzero(frame.classes == SemanticClass.PEDESTRIAN)
    assert seen["full"] == 0 < seen["partial"]


def test_looks_vary_with_the_seed(street):
    frames = []
    for seed in (1, 2):
        street.reset(seed=seed)
        frames.append(frame_at(street, 20.0).gray.astype(float))
    assert np.abs(frames[0] - frames[1]).mean() > 5.0


def test_legs_move(street):
    count = len(street.people)
    still = np.zeros(count)
    frames = []
    for phase in (0.0, 0.5 * np.pi):
        positions = np.tile([30.0, -1.75], (count, 1))
        street.world.place_people(positions, still + np.pi / 2, still + phase, still + 1.4)
        frames.append(street.camera.capture(22.0).classes)
    assert not np.array_equal(*frames)


def test_luma_has_the_weights_of_bt_601():
    primaries = np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]]], np.uint8)
    assert luma(primaries).tolist() == [[76, 150, 29, 255]]


def test_contact_is_pybullet_s(street):
    lane = street.corridor.centre
    radius, half_width = 0.3, street.corridor.width / 2

    def touches(x, y):
        return street.world.touches(50.0, [0], np.array([[x, lane + y]]))

    assert touches(50.0 + radius - 0.02, 0.0)
    assert not touches(50.0 + radius + 0.02, 0.0)
    assert touches(48.0, half_width + radius - 0.02)
    assert not touches(48.0, half_width + radius + 0.02)


def test_asking_for_contact_leaves_no_trace_in_the_picture(street):
    before = frame_at(street, 50.0)
    street.world.touches(50.0, [0], np.array([[50.2, street.corridor.centre]]))
    after = frame_at(street, 50.0)
    assert np.array_equal(before.gray, after.gray)
    assert np.array_equal(before.instances, after.instances)


def test_geometry_keeps_to_the_right():
    street = StreetGeometry()
    assert street.near_wall < street.near_kerb < street.ego_lane < 0.0
    assert 0.0 < street.far_kerb < street.far_wall
    assert street.crosswalk[1] < street.goal < street.length < street.end


def test_camera_parameters_come_from_the_grounding(street):
    lens, grounding = street.lens, street.pipeline.grounding.camera
    assert isinstance(street.camera, DashCamera)
    assert (lens.fov, lens.height) == (grounding.fov, grounding.height)
    assert lens.pinhole.focal == pytest.approx(grounding.focal_length(lens.size))
