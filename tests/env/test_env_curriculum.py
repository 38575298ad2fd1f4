"""Which episodes a training's streets draw: new ones, and again those in which ego collided."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from env import curriculum
from env.cells import CELLS
from env.curriculum import EPISODE_SEEDS, StreetsInTurn
from tests.env.spaces import PEDAL, Spaces

COLLISION, TIMEOUT, SUCCESS = -1.0, 0.0, 1.0  # actions of `OneStep`
ENDINGS = st.lists(st.sampled_from([COLLISION, TIMEOUT, SUCCESS]), max_size=60)


class OneStep(Spaces):
    """A street whose episodes end at once, and as the action says."""

    def __init__(self, **options):
        super().__init__(PEDAL)

    def reset(self, *, seed=None, options=None):
        self.seed = seed
        return super().reset()

    def step(self, ending):
        timeout = ending == TIMEOUT
        info = {"collision": ending == COLLISION, "timeout": timeout}
        return self.observation_space.sample(), 0.0, not timeout, timeout, info


@pytest.fixture(scope="module", autouse=True)
def _streets_of_one_step():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(curriculum, "OccludedCrossing", OneStep)
        yield


def driven(endings, retries, seed=0):
    """Drive an episode to each ending; return what was driven."""
    streets = StreetsInTurn(CELLS, retries=retries)
    episodes = []
    for ending in endings:
        _, info = streets.reset(seed=None if episodes else seed)
        *_, ended = streets.step(ending)
        cell = (info["traffic"], info["occlusion"])
        assert cell == (ended["traffic"], ended["occlusion"])
        episodes.append((*cell, streets.street.seed))
    return episodes


@given(ENDINGS)
def test_without_retries_every_episode_is_new(endings):
    episodes = driven(endings, retries=0.0)
    assert len(set(episodes)) == len(episodes)
    assert all(EPISODE_SEEDS[0] <= seed < EPISODE_SEEDS[1] for *_, seed in episodes)


@given(ENDINGS, st.floats(0.0, 0.99), st.integers(0, 1000))
def test_only_collisions_are_driven_again_until_they_end_otherwise(endings, retries, seed):
    last = {}
    for episode, ending in zip(driven(endings, retries, seed), endings, strict=True):
        assert last.get(episode, COLLISION) == COLLISION
        last[episode] = ending


def test_retries_are_the_share_that_the_setup_says():
    again = 2000 - len(set(driven([COLLISION] * 2000, retries=0.5)))
    # Five deviations of 2000 draws; before the first episode there is nothing to try again.
    assert abs(again - 1000) < 5 * (2000 * 0.25) ** 0.5


def test_every_collision_comes_again():
    episodes = driven([COLLISION] * 10 + [TIMEOUT] * 200, retries=0.9)
    counts = Counter(episodes)
    assert all(counts[episode] > 1 for episode in episodes[:10])


def test_the_same_seed_draws_the_same_episodes():
    endings = [SUCCESS, COLLISION, COLLISION, TIMEOUT, COLLISION] * 10
    assert driven(endings, 0.5, seed=3) == driven(endings, 0.5, seed=3)
    assert driven(endings, 0.5, seed=3) != driven(endings, 0.5, seed=4)
