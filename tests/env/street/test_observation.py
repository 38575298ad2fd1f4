"""The state that a policy is given says of the nearest people what plain numpy says."""

from types import SimpleNamespace

import numpy as np
import pytest

from env.street.observation import STATE_FIELDS, StateObserver
from env.world.actors import RUNNING_PACE, Corridor, Ego, EgoParameters, Walkers
from env.world.world import StreetGeometry

STREET = StreetGeometry()


def reference(street):
    ego, state = street.ego, np.zeros(len(STATE_FIELDS), np.float32)
    state[0] = ego.speed / ego.parameters.top_speed
    state[1] = ego.force / ego.parameters.brake
    state[2] = (STREET.goal - ego.position) / STREET.length
    state[3] = (STREET.crosswalk[0] - ego.position) / 60.0
    state[4] = street.gap / 60.0
    shown = state[5:].reshape(10, 4)
    shown[:, 0] = 1.0
    places = street.people.positions - (ego.position, street.corridor.centre)
    ahead = np.flatnonzero(places[:, 0] >= -ego.parameters.length)
    nearest = ahead[np.argsort(np.hypot(*places[ahead].T), kind="stable")][:10]
    shown[: len(nearest), :2] = places[nearest] / (60.0, 12.0)
    shown[: len(nearest), 2:] = street.people.velocities[nearest] / RUNNING_PACE
    return np.clip(state, -1.0, 1.0)


@pytest.mark.parametrize("count", [0, 1, 9, 10, 11, 50])
def test_the_state_is_that_of_the_ten_nearest(count):
    rng = np.random.default_rng(count)
    for gap in (np.inf, 12.3, 0.01):
        places = rng.uniform([-20.0, -9.0], [120.0, 7.0], (count, 2))
        places[: count // 2] = places[
            count - count // 2 :
        ]  # of two at one place, the first is first
        street = SimpleNamespace(
            ego=Ego(EgoParameters(), rng.uniform(0.0, 90.0), rng.uniform(0.0, 11.0), -3.0),
            people=Walkers(places, rng.uniform(-2.0, 2.0, (count, 2))),
            geometry=STREET,
            corridor=Corridor(STREET.ego_lane, 1.8),
            gap=gap,
        )
        state = StateObserver()(street)
        assert state.dtype == np.float32
        assert np.array_equal(state, reference(street))
