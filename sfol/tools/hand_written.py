"""Bundled rewards as one would write them without rules: plain array code for one task.

They are what the benchmark holds rules against, and nothing else uses them. Each is one function of
numpy's and torch's arrays alike, whose common functions it gets as `xp`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

Array = Any  # numpy's or torch's, float64 or bool
Observation = Any  # an array, or arrays by name

PEOPLE, VEHICLES = 10, 3


class HandWritten(NamedTuple):
    """A reward by hand, and steps that it is about.

    Attributes:
        steps: from a random generator and B, makes the observations before and after B steps,
            float64 and bool, with an axis B before all others.
        reward: from numpy or torch and these observations, returns rewards (B,).
    """

    steps: Callable[[np.random.Generator, int], tuple[Observation, Observation]]
    reward: Callable[[Any, Observation, Observation], Array]


# -- cartpole ---------------------------------------------------------------------------------


def cartpole(xp: Any, observation: Array, _: Array) -> Array:
    """Return the rewards of cartpole.yaml.

    Args:
        xp: numpy or torch.
        observation: (B, 4): position in m, speed in m/s, angle in rad, spin in rad/s.
    """
    position, speed, angle = observation[:, 0], observation[:, 1], observation[:, 2]
    balanced = (1.0 - abs(angle) / 0.2095).clip(min=0.0)
    at_end = (1.0 - (2.4 - abs(position)).clip(min=0.0) / 2.4).clip(min=0.0)
    leaving = xp.where(position * speed > 0.0, at_end, 0.0)
    return balanced - 0.5 * (1.0 + speed * speed) * leaving


def _cartpole_steps(random: np.random.Generator, size: int) -> tuple[Observation, Observation]:
    widest = np.array([3.0, 3.0, 0.3, 2.0])
    before, after = random.uniform(-widest, widest, (2, size, 4))
    return before, after


# -- aeb_state --------------------------------------------------------------------------------


def aeb_state(
    xp: Any, observation: Mapping[str, Array], next_observation: Mapping[str, Array]
) -> Array:
    """Return the rewards of aeb_state.yaml, for n people, m vehicles and one crosswalk.

    Args:
        xp: numpy or torch.
        observation: ``people`` (B, n, 2), ``vehicles`` (B, m, 2) and ``crosswalks`` (B, 1, 1),
            positions in m; ``people_there`` and so on, bool, without the last axis; ``ego`` (B, 1),
            its speed in m/s.
        next_observation: likewise; of people and ego.
    """
    speed, next_speed = observation["ego"][:, 0], next_observation["ego"][:, 0]
    weight = _safety(xp, observation) / 3.0
    distance = _distance(xp, next_observation)
    collision = xp.where(distance == 0.0, 200.0, 0.0)
    safety = -weight * (0.05 * speed * speed / (distance + 1.0) + collision)
    efficiency = _efficiency(xp, observation) / 3.0 * 0.5 * speed
    change = speed - next_speed
    return safety + efficiency - 0.05 * change * change


def _safety(xp: Any, observation: Mapping[str, Array]) -> Array:
    """Return the sum of how much each rule asks for care."""
    x, y = observation["people"][..., 0], observation["people"][..., 1]
    there = observation["people_there"]
    crosswalk, has_crosswalk = observation["crosswalks"][..., 0], observation["crosswalks_there"]
    on_road = _inside(y, -5.25, 1.75, 0.5)
    near = xp.where(has_crosswalk, (1.0 - 0.3 * abs(x - crosswalk)).clip(min=0.0), 0.0)
    on_crosswalk = on_road * near
    ahead = there & (abs(xp.arctan2(y, x)) <= 0.2) & (on_road >= 0.05)
    crossing = there & (on_crosswalk >= 0.05)
    safe1 = _mean(xp, ahead, 0.975 + _middle(on_road) + 1.0, 3)
    safe2 = _mean(xp, crossing, 0.975 + _middle(on_crosswalk), 2)
    return safe1 + safe2 + _hidden(xp, observation)


def _hidden(xp: Any, observation: Mapping[str, Array]) -> Array:
    """Return how much the crosswalk is hidden, by vehicles on the right, ahead or on the left."""
    x, y = observation["vehicles"][..., 0], observation["vehicles"][..., 1]
    crosswalk, has_crosswalk = observation["crosswalks"][..., 0], observation["crosswalks_there"]
    gap = crosswalk - x
    occludes = (1.0 - 0.09 * (gap - 10.0).clip(min=0.0)).clip(min=0.0)
    hides = observation["vehicles_there"] & has_crosswalk & (gap > 0.0) & (occludes > 0.0)
    angle = xp.arctan2(y, x)
    sides = (
        (angle >= -0.6) & (angle <= -0.2),
        abs(angle) <= 0.2,
        (angle >= 0.2) & (angle <= 0.6),
    )
    lower = upper = 0.0 * x[:, 0]
    for side in sides:
        hiding = hides & side
        least, greatest = (
            _mean(xp, hiding, occludes + (1.0 + known), 3, first=(1.0, known))
            for known in (0.95, 1.0)  # of the crosswalk and of each vehicle, what it is
        )
        lower, upper = xp.maximum(lower, least), xp.maximum(upper, greatest)
    return (lower + upper) / 2.0


def _efficiency(xp: Any, observation: Mapping[str, Array]) -> Array:
    """Return the sum of how much each rule asks to go on."""
    x, y = observation["people"][..., 0], observation["people"][..., 1]
    there = observation["people_there"]
    crosswalk, has_crosswalk = observation["crosswalks"][..., 0], observation["crosswalks_there"]
    in_lane = xp.where(there & (x > 0.0), _inside(y, -1.75, 1.75, 1.0), 0.0)
    empty = 1.0 - xp.amax(in_lane, -1)
    ahead = (has_crosswalk & (crosswalk > 0.0))[:, 0]
    efficiency1 = xp.where(~ahead & (empty > 0.0), (2.0 + empty) / 3.0, 0.0)
    near = (1.0 - 0.3 * abs(x - crosswalk)).clip(min=0.0)
    blocking = xp.where(there & (y >= -5.25) & (y <= 1.75), near, 0.0)
    clear = 1.0 - xp.amax(blocking, -1)
    passable = has_crosswalk[:, 0] & (clear > 0.0)
    approaching, at = (
        _inside(crosswalk[:, 0], *band) for band in ((10.0, 40.0, 10.0), (0.0, 10.0, 2.0))
    )
    efficiency2, efficiency3 = (
        xp.where(passable & (c >= 0.05), (1.975 + _middle(c) + clear) / 4.0, 0.0)
        for c in (approaching, at)
    )
    return efficiency1 + efficiency2 + efficiency3


def _distance(xp: Any, observation: Mapping[str, Array]) -> Array:
    """Return the distance to the nearest pedestrian, in m; infinite if there is none."""
    x, y = observation["people"][..., 0], observation["people"][..., 1]
    distance = (xp.hypot(x, y) - 2.5).clip(min=0.0)
    return xp.amin(xp.where(observation["people_there"], distance, xp.inf), -1)


def _inside(x: Array, low: float, high: float, margin: float) -> Array:
    """Return 1 from low to high, less outside, 0.1 at a margin from there, and 0 far away."""
    outside = ((x - low).clip(max=0.0) + (high - x).clip(max=0.0)) / margin
    return (1.0 + 0.9 * outside).clip(min=0.0)


def _middle(confidence: Array) -> Array:
    """Return the middle of a confidence's bound of 5 % on each side, cut at 1."""
    return (0.95 * confidence + (1.05 * confidence).clip(max=1.0)) / 2.0


def _mean(
    xp: Any, chosen: Array, values: Array, literals: int, *, first: tuple[float, ...] = (1.0,)
) -> Array:
    """Return the mean of what is said of everybody chosen, and first; or 0 if nobody is.

    Args:
        xp: numpy or torch.
        chosen: (B, n), bool.
        values: (B, n), the sums of what is said of each.
        literals: how much is said of each.
        first: what is said once.
    """
    count = chosen.sum(-1)
    total = sum(first) + xp.where(chosen, values, 0.0).sum(-1)
    return xp.where(count > 0, total / (len(first) + literals * count), 0.0)


def _aeb_state_steps(random: np.random.Generator, size: int) -> tuple[Observation, Observation]:
    before: dict[str, Array] = {
        "people": random.uniform([-5.0, -7.0], [45.0, 7.0], (size, PEOPLE, 2)),
        "people_there": random.random((size, PEOPLE)) < random.random((size, 1)),
        "vehicles": random.uniform([0.0, -7.0], [45.0, 7.0], (size, VEHICLES, 2)),
        "vehicles_there": random.random((size, VEHICLES)) < 0.7,
        "crosswalks": random.uniform(-5.0, 50.0, (size, 1, 1)),
        "crosswalks_there": random.random((size, 1)) < 0.7,
        "ego": random.uniform(0.0, 10.0, (size, 1)),
    }
    after = {
        "people": before["people"] - [0.5, 0.0],
        "people_there": before["people_there"],
        "ego": before["ego"] + random.uniform(-0.5, 0.5, (size, 1)),
    }
    return before, after


# By the name of the knowledge base.
HAND_WRITTEN: Mapping[str, HandWritten] = {
    "aeb_state": HandWritten(_aeb_state_steps, aeb_state),
    "cartpole": HandWritten(_cartpole_steps, cartpole),
}
