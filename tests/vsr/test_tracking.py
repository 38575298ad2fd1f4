"""Names are stable over time: laws of one step and of many."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfol.errors import UsageError
from tests.vsr.painting import street
from vsr.classes import SemanticClass
from vsr.entities import Box
from vsr.grounding import Tracking
from vsr.tracking import Tracker, Tracks, overlap, track

PERSON, CAR, TRUCK = SemanticClass.PEDESTRIAN, SemanticClass.VEHICLE, SemanticClass.TRUCK
TRACKING = Tracking(lost_after=1.0, slack=2.0)


@dataclass(frozen=True)
class Thing:
    kind: SemanticClass
    box: Box


def boxes(first, last):
    """Boxes whose columns lie between the two."""
    return st.builds(
        lambda top, left, height, width: Box(top, left, top + height, min(left + width, last)),
        st.integers(0, 40),
        st.integers(first, last - 1),
        st.integers(1, 15),
        st.integers(1, 15),
    )


def things(first=0, last=40, *, unique=True):
    thing = st.builds(Thing, st.sampled_from([PERSON, CAR, TRUCK]), boxes(first, last))
    return st.lists(thing, max_size=7, unique=unique)


def walk(pictures, step=0.1, tracking=TRACKING):
    """Yield the names of each picture, and what is remembered then."""
    tracks = Tracks()
    for number, seen in enumerate(pictures):
        tracks, names = track(tracks, seen, number * step, tracking)
        yield names, tracks


@given(st.lists(things(), max_size=5), things(), st.randoms())
def test_a_permutation_of_boxes_permutes_names(before, now, random):
    *_, tracks = [Tracks(), *(tracks for _, tracks in walk(before))]
    order = random.sample(range(len(now)), len(now))
    one, names = track(tracks, now, 10.0, TRACKING)
    other, permuted = track(tracks, [now[i] for i in order], 10.0, TRACKING)
    assert permuted == tuple(names[i] for i in order)
    assert one == other


@given(st.lists(things(unique=False), max_size=6), st.sampled_from([0.1, 0.7, 3.0]))
def test_nobody_shares_a_name_and_no_name_changes_its_class(pictures, step):
    kinds = {}
    for (names, tracks), seen in zip(walk(pictures, step), pictures, strict=True):
        assert len(set(names)) == len(seen)
        kept = [one.name for one in tracks.kept]
        assert len(set(kept)) == len(kept)
        assert set(names) <= set(kept)
        for name, thing in zip(names, seen, strict=True):
            assert kinds.setdefault(name, thing.kind) == thing.kind


@given(things(), st.lists(st.integers(0, 9), min_size=1, max_size=6))
def test_what_stands_still_keeps_its_name(standing, seeds):
    pictures = [standing, *(sorted(standing, key=lambda t: hash((t, s))) for s in seeds)]
    found = [
        dict(zip(seen, names, strict=True))
        for seen, (names, _) in zip(pictures, walk(pictures), strict=True)
    ]
    assert all(names == found[0] for names in found)


# Wider apart than the slack on both sides.
@given(boxes(0, 20), st.lists(things(25, 60), min_size=2, max_size=6))
def test_whoever_moves_elsewhere_takes_no_name_from_it(box, others):
    pictures = [[Thing(PERSON, box), *seen] for seen in others]
    assert len({names[0] for names, _ in walk(pictures)}) == 1


@given(things().filter(bool), st.integers(1, 25), st.sampled_from([0.0, 0.35, 1.0]))
def test_hidden_for_a_while_it_comes_back_with_its_name(standing, steps, lost_after):
    first, *others = standing
    pictures = [standing, *[others] * steps, standing]
    tracking = Tracking(lost_after=lost_after)
    (before, _), *_, (after, _) = walk(pictures, 0.125, tracking)
    assert after[1:] == before[1:]
    if (steps + 1) * 0.125 <= lost_after:
        assert after[0] == before[0]
    else:
        assert after[0] not in before
        assert after[0].startswith(first.kind.name.lower())


def test_names_follow_what_moves():
    right = [Thing(PERSON, Box(50, 10 + 2 * step, 60, 14 + 2 * step)) for step in range(10)]
    left = [Thing(PERSON, Box(52, 60 - 2 * step, 63, 64 - 2 * step)) for step in range(10)]
    (first, _), *others = walk(zip(left, right, strict=True))
    assert first == ("pedestrian1", "pedestrian2")  # the lowest in the picture is the nearest
    assert all(names == first for names, _ in others)


def test_whoever_was_seen_just_now_comes_before_whoever_is_hidden():
    hides, walks = Thing(PERSON, Box(50, 20, 60, 24)), Thing(PERSON, Box(50, 12, 60, 16))
    there = Thing(PERSON, Box(50, 19, 60, 23))  # nearer to where the other one was
    (before, _), _, (after, _) = walk([[hides, walks], [walks], [there]])
    assert after == (before[1],)


def test_slack_is_how_far_apart_boxes_may_be():
    pictures = [[Thing(PERSON, Box(50, left, 60, left + 1))] for left in (10, 14)]
    for slack, same in ((1.0, False), (1.5, False), (1.75, True)):
        (before, _), (after, _) = walk(pictures, tracking=Tracking(slack=slack))
        assert (before == after) is same


def test_what_is_remembered_is_a_value():
    before, _ = track(Tracks(), [Thing(PERSON, Box(0, 0, 4, 4))], 0.0, TRACKING)
    now = [Thing(PERSON, Box(30, 30, 40, 40))]
    assert track(before, now, 1.0, TRACKING) == track(before, now, 1.0, TRACKING)


@pytest.mark.parametrize("time", [1.0, 0.5, math.nan, math.inf, -math.inf])
def test_time_goes_on(time):
    tracks, _ = track(Tracks(), [], 1.0, TRACKING)
    with pytest.raises(UsageError, match=r"cannot follow one at 1\.0 s") as caught:
        track(tracks, [], time, TRACKING)
    assert caught.value.name == "time"


def test_a_tracker_renames_entities_and_nothing_else():
    near, far = ((150, 170), (20, 30)), ((112, 130), (90, 96))
    both = street().rectangle(PERSON, *near).rectangle(PERSON, *far).entities()
    alone = street().rectangle(PERSON, *far).entities()
    tracker = Tracker(TRACKING, 0.1)
    assert [one.name for one in tracker(both)] == ["pedestrian1", "pedestrian2"]
    (left,) = tracker(alone)
    assert (alone[0].name, left.name) == ("pedestrian1", "pedestrian2")
    assert (left.kind, left.box, left.confidence) == (PERSON, alone[0].box, 1.0)
    assert left.mask is alone[0].mask


def test_overlap_is_intersection_over_union():
    one = np.array([[0.0, 0.0, 4.0, 4.0], [9.0, 9.0, 9.0, 9.0]])
    other = np.array([[0.0, 2.0, 4.0, 6.0], [8.0, 8.0, 10.0, 10.0], [9.0, 9.0, 9.0, 9.0]])
    assert overlap(one, other).tolist() == [[8 / 24, 0.0, 0.0], [0.0, 0.0, 0.0]]
    assert overlap(one[:1], one[:1]).tolist() == [[1.0]]
