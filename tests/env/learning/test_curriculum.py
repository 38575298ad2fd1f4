"""Which episodes a training's streets draw."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from env.learning import curriculum
from env.learning.curriculum import StreetsInTurn
from env.street.seeds import TRAINING
from env.world.cells import CELLS
from tests.env.spaces import PEDAL, Spaces


class NoStreet(Spaces):
    """A street that only knows its cell, which episode it was given last, and its step."""

    def __init__(self, *, traffic, occlusion, observation, length=10):
        super().__init__(PEDAL)
        assert observation == "none"
        self.cell = (traffic, occlusion)
        self.length = length

    def reset(self, *, seed=None, options=None):
        self.seed, self.time, self.actions = seed, 0, []
        return super().reset()

    def step(self, action):
        self.time += 1
        self.actions.append(action)
        info = {"reward_safety": -float(self.time), "weight_safety": 2.0 * self.time}
        ended = self.time == self.length
        return None, float(self.time), ended, False, info | {"speed": float(self.time)}


class Clock:
    """An observer of the time, which counts how often it is asked."""

    space = PEDAL

    def __init__(self):
        self.asked = 0

    def __call__(self, street):
        self.asked += 1
        return street.time


@pytest.fixture(scope="module", autouse=True)
def _no_streets():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(curriculum, "OccludedCrossing", NoStreet)
        yield


def drawn(count, seed):
    """Return the cells and seeds of that many episodes."""
    streets, episodes = StreetsInTurn(CELLS, Clock()), []
    for number in range(count):
        _, info = streets.reset(seed=None if number else seed)
        assert (info["traffic"], info["occlusion"]) == streets.street.cell
        episodes.append((streets.street.cell, streets.street.seed))
    return episodes


@given(st.integers(0, 1000))
def test_every_episode_is_new_and_the_same_seed_draws_the_same(seed):
    episodes = drawn(40, seed)
    assert len(set(episodes)) == 40
    assert all(number in TRAINING for _, number in episodes)
    assert episodes == drawn(40, seed)
    assert episodes != drawn(40, seed + 1)


def test_all_streets_are_built_before_they_are_needed(monkeypatch):
    streets = StreetsInTurn(CELLS, Clock())
    streets.build()
    monkeypatch.setattr(curriculum, "OccludedCrossing", None)  # there is nothing left to build
    cells = {tuple(streets.reset()[1].values()) for _ in range(100)}
    assert cells == set(CELLS)


def test_a_decision_is_held_and_its_rewards_are_summed():
    observer = Clock()
    streets = StreetsInTurn(CELLS[:1], observer, decision_steps=4)
    assert streets.reset(seed=0)[0] == 0
    observation, reward, terminated, truncated, info = streets.step(0.5)
    assert (observation, reward, terminated, truncated) == (4, 1 + 2 + 3 + 4, False, False)
    assert (info["reward_safety"], info["weight_safety"], info["speed"]) == (-10.0, 5.0, 4.0)
    assert info["control_steps"] == 4
    streets.step(-0.5)
    *_, terminated, _, info = streets.step(1.0)  # the episode ends after two of its steps
    assert terminated
    assert (info["control_steps"], info["reward_safety"], info["weight_safety"]) == (2, -19.0, 19.0)
    assert streets.street.actions == [0.5] * 4 + [-0.5] * 4 + [1.0] * 2
    assert observer.asked == 4  # once at the start, and once for each decision
