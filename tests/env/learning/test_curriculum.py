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
    """A street that only knows its cell and which episode it was given last."""

    def __init__(self, *, traffic, occlusion):
        super().__init__(PEDAL)
        self.cell = (traffic, occlusion)

    def reset(self, *, seed=None, options=None):
        self.seed = seed
        return super().reset()


@pytest.fixture(scope="module", autouse=True)
def _no_streets():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(curriculum, "OccludedCrossing", NoStreet)
        yield


def drawn(count, seed):
    """Return the cells and seeds of that many episodes."""
    streets, episodes = StreetsInTurn(CELLS), []
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
    streets = StreetsInTurn(CELLS)
    streets.build()
    monkeypatch.setattr(curriculum, "OccludedCrossing", None)  # there is nothing left to build
    cells = {tuple(streets.reset()[1].values()) for _ in range(100)}
    assert cells == set(CELLS)
