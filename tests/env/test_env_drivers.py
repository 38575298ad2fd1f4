"""The cautious driver gets through by what it sees."""

import numpy as np
import pytest

from env.drivers import DRIVERS, Cautious


def drive(street, driver, seed):
    street.reset(seed=seed)
    driver.reset()
    while True:
        *_, terminated, truncated, info = street.step(np.array([driver(street)], np.float32))
        if terminated or truncated:
            return info


@pytest.mark.parametrize("cell", [("high", "full"), ("low", "partial")])
def test_the_cautious_driver_reaches_the_goal(street_of, cell):
    for seed in (11, 12):
        assert drive(street_of(*cell), Cautious(), seed)["is_success"]


def test_drivers_go_by_name():
    assert set(DRIVERS) >= {"full_throttle", "cautious"}
    for make in DRIVERS.values():
        make().reset()


def test_the_cautious_driver_stops_before_somebody_on_the_road(street_of):
    street = street_of("low", "partial")
    street.reset(seed=0)
    people = street.people
    people.positions = np.tile([-20.0, -8.0], (len(people), 1))
    people.positions[1] = 30.0, street.corridor.centre
    people.decide = lambda ego, dt: None
    driver = Cautious()
    for _ in range(120):
        street.step(np.array([driver(street)], np.float32))
    assert street.ego.speed < 0.1
    assert 26.0 < street.ego.position < 29.5
