"""Streets are dear to build, so that tests of one cell share one."""

import pytest

from env.street.crossing import OccludedCrossing


@pytest.fixture(scope="session")
def street_of():
    streets = {}

    def build(traffic, occlusion):
        if (traffic, occlusion) not in streets:
            streets[traffic, occlusion] = OccludedCrossing(
                traffic=traffic, occlusion=occlusion, render_mode="rgb_array"
            )
        return streets[traffic, occlusion]

    yield build
    for street in streets.values():
        street.close()
