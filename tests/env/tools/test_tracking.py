"""`aeb tracking` counts how often names and bodies part."""

import numpy as np
import pytest
from typer.testing import CliRunner

from env.cli import app
from env.tools.tracking import Sighting, counted_names, drives, sighting, switches, tracked_names
from tests.vsr.painting import street
from vsr.classes import SemanticClass
from vsr.entities import Box
from vsr.segmentation import Frame

PERSON = SemanticClass.PEDESTRIAN


def seen(name, body, left=0, pixels=9):
    return Sighting(name, PERSON, Box(0, left, 3, left + 3), body, pixels)


def counts(*pictures):
    found = switches(pictures, counted_names(pictures))
    return found["seen"], found["renamed"], found["reused"]


def test_an_entity_shows_whoever_has_most_of_its_pixels():
    painting = street().rectangle(PERSON, (150, 160), (20, 30))
    (entity,) = painting.entities()
    bodies = np.full((224, 224), 4, np.int32)
    bodies[150:154, 20:30] = 7
    frame = Frame(painting.classes, painting.classes, bodies)
    assert sighting(entity, frame) == Sighting("pedestrian1", PERSON, entity.box, 4, 60)


def test_nothing_changes_while_names_and_bodies_stay():
    assert counts([seen("a", 1), seen("b", 2)], [], [seen("b", 2), seen("a", 1)]) == (4, 0, 0)


def test_an_exchange_renames_two_and_uses_two_names_for_others():
    assert counts([seen("a", 1), seen("b", 2)], [seen("a", 2), seen("b", 1)]) == (4, 2, 2)


def test_a_new_name_is_no_name_of_somebody_else():
    assert counts([seen("a", 1)], [], [seen("b", 1)]) == (2, 1, 0)


def test_somebody_new_may_take_a_name_without_being_renamed():
    assert counts([seen("a", 1)], [seen("a", 2)]) == (2, 0, 1)


@pytest.mark.parametrize("order", [1, -1])
def test_whoever_is_in_parts_is_seen_in_the_largest(order):
    parts = [seen("a", 1, pixels=5), seen("b", 1, pixels=6)][::order]
    assert counts([seen("b", 1)], parts) == (2, 0, 0)


def test_tracked_names_part_less_often_from_their_bodies():
    for _, step, episode in drives(2, first_seed=40):
        counted = switches(episode, counted_names(episode))
        tracked = switches(episode, tracked_names(episode, step))
        assert counted["seen"] == tracked["seen"] > 0
        assert tracked["renamed"] < counted["renamed"]
        assert tracked["reused"] < counted["reused"]


def test_the_command_prints_a_row_for_each_kind_of_traffic_that_was_driven():
    done = CliRunner().invoke(app, ["tracking", "--episodes", "1"])
    assert done.exit_code == 0, done.output
    assert "low: pedestrians" in done.output
    assert "low: others" in done.output
    assert "high" not in done.output
