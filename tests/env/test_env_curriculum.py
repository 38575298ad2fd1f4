"""Which episodes a training's streets draw: new ones, and again those in which ego failed."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from env import curriculum
from env.cells import CELLS
from env.curriculum import EPISODE_SEEDS, StreetsInTurn
from tests.env.spaces import PEDAL, Spaces

ENDINGS = st.lists(st.booleans(), max_size=60)


class OneStep(Spaces):
    """A street whose episodes end at once, well or badly as the action says."""

    def __init__(self, **options):
        super().__init__(PEDAL)

    def reset(self, *, seed=None, options=None):
        self.seed = seed
        return super().reset()

    def step(self, action):
        success = bool(action > 0)
        return self.observation_space.sample(), 0.0, success, not success, {"is_success": success}


@pytest.fixture(scope="module", autouse=True)
def _streets_of_one_step():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(curriculum, "OccludedCrossing", OneStep)
        yield


def driven(successes, retries, seed=0):
    """Drive an episode for each ending; return what was driven, and whether it was a success."""
    streets = StreetsInTurn(CELLS, retries=retries)
    episodes = []
    for success in successes:
        _, info = streets.reset(seed=None if episodes else seed)
        *_, ended = streets.step(1.0 if success else -1.0)
        cell = (info["traffic"], info["occlusion"])
        assert cell == (ended["traffic"], ended["occlusion"])
        episodes.append(((*cell, streets.street.seed), success))
    return episodes


@given(ENDINGS)
def test_without_retries_every_episode_is_new(successes):
    episodes = [episode for episode, _ in driven(successes, retries=0.0)]
    assert len(set(episodes)) == len(episodes)
    assert all(EPISODE_SEEDS[0] <= seed < EPISODE_SEEDS[1] for *_, seed in episodes)


@given(ENDINGS, st.floats(0.0, 0.99), st.integers(0, 1000))
def test_only_failures_are_driven_again_until_they_succeed(successes, retries, seed):
    last = {}
    for episode, success in driven(successes, retries, seed):
        assert not last.get(episode, False)
        last[episode] = success


def test_retries_are_the_share_that_the_setup_says():
    episodes = Counter(episode for episode, _ in driven([False] * 2000, retries=0.5))
    again = 2000 - len(episodes)
    # Five deviations of 2000 draws; the first episode has nothing to be tried again.
    assert abs(again - 1000) < 5 * (2000 * 0.25) ** 0.5


def test_streets_without_failures_are_new_whatever_the_share():
    episodes = [episode for episode, _ in driven([True] * 50, retries=0.99)]
    assert len(set(episodes)) == 50


def test_the_same_seed_draws_the_same_episodes():
    endings = [True, False, False, True, False] * 10
    assert driven(endings, 0.5, seed=3) == driven(endings, 0.5, seed=3)
    assert driven(endings, 0.5, seed=3) != driven(endings, 0.5, seed=4)
