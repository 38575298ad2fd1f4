import math

import pytest
from pydantic import ValidationError

from vsr.grounding import Camera, SegmentationGrounding, Tracking


def test_defaults_are_the_papers():
    grounding = SegmentationGrounding()
    assert grounding.window == 15
    assert grounding.approaching == (50.0, 200.0)
    assert grounding.minimum_area == grounding.minimum_pixels == 1
    assert not grounding.clear_requires_unoccluded
    assert grounding.bounds == {}


def test_reads_what_yaml_gives():
    grounding = SegmentationGrounding.model_validate(
        {
            "window": 9,
            "approaching": [5, 30],
            "camera": {"fov": 90},
            "bounds": {"OnRoad": [0.9, 1]},
        }
    )
    assert grounding.approaching == (5.0, 30.0)
    assert grounding.camera == Camera(fov=90, height=1.5)
    assert grounding.bounds == {"OnRoad": (0.9, 1.0)}


def test_the_focal_length_of_a_right_angle_is_half_the_width():
    assert math.isclose(Camera(fov=90.0).focal_length(224), 112.0)


def test_every_field_is_described():
    for model in (Camera, Tracking, SegmentationGrounding):
        assert all(field.description for field in model.model_fields.values())


@pytest.mark.parametrize(
    "section",
    [
        {"windows": 15},
        {"window": 0},
        {"window": 1.5},
        {"window": "15"},
        {"window": True},
        {"approaching": [200, 50]},
        {"approaching": [50, 50]},
        {"approaching": [-1, 50]},
        {"approaching": [50]},
        {"approaching": [50, float("inf")]},
        {"road": [2, -2]},
        {"camera": {"fov": 180}},
        {"camera": {"height": 0}},
        {"camera": {"pitch": 1}},
        {"lane_half_width": float("nan")},
        {"clear_requires_unoccluded": 1},
        {"bounds": {"OnRoof": [1, 1]}},
        {"bounds": {"Pedestrian": [1, 1]}},
        {"bounds": {"OnRoad": [0.9, 1.1]}},
        {"bounds": {"OnRoad": [1.0, 0.9]}},
    ],
)
def test_wrong_sections_are_refused(section):
    with pytest.raises(ValidationError):
        SegmentationGrounding.model_validate(section)


def test_the_section_cannot_be_changed():
    with pytest.raises(ValidationError):
        SegmentationGrounding().window = 3


def test_names_are_tracked_if_the_section_says_so():
    assert SegmentationGrounding().tracking is None
    section = {"tracking": {"lost_after": 0.5}}
    assert SegmentationGrounding.model_validate(section).tracking == Tracking(lost_after=0.5)
    assert SegmentationGrounding.model_validate({"tracking": {}}).tracking == Tracking()
    with pytest.raises(ValidationError):
        Tracking(lost_after=-1.0)
