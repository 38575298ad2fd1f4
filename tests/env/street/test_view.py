"""Another simulator's street docks at the declared face: it drives, is measured and observed."""

import numpy as np
import pytest

from env.driving.drivers import Cautious, FullThrottle, NeverMoves, Oracle
from env.evaluation.evaluate import drive_episode
from env.perception.pipeline import ScenePipeline
from env.street.observation import StateObserver
from env.world.actors import Corridor, Ego, EgoParameters, Walkers
from env.world.camera import DashCameraParameters
from env.world.world import StreetGeometry
from vsr.segmentation import Frame


class PaperStreet:
    """A street on paper: no physics, no pictures, one person who stands on the crosswalk."""

    control_dt = 0.1
    behaviour = "stands"

    def __init__(self, person=True):
        self.geometry, self.lens = StreetGeometry(), DashCameraParameters()
        self.corridor = Corridor(self.geometry.ego_lane, EgoParameters().width)
        self.pipeline = ScenePipeline("crossing")
        y = self.corridor.centre if person else 50.0
        self.people = Walkers(np.array([[62.0, y]]), np.zeros((1, 2)))

    @property
    def frame(self):
        side = self.lens.size
        return Frame(*(np.zeros((side, side), kind) for kind in (np.uint8, np.uint8, np.int32)))

    @property
    def gap(self):
        fronts = np.array([self.ego.position])
        still = self.people.velocities
        return float(self.corridor.distances(fronts, self.people.positions[None], still).min())

    def reset(self, *, seed=None):
        self.ego, self.steps = Ego(EgoParameters()), 0
        self.scene = self.pipeline.scene((), self.pipeline.reward.facts())
        return None, {}

    def step(self, action):
        before, self.ego = self.ego, self.ego.after(float(action[0]), self.control_dt)
        self.steps += 1
        hit = self.gap == np.inf and before.position < 62.0 <= self.ego.position
        hit &= self.people.positions[0, 1] == self.corridor.centre
        self.outcome = self.pipeline.reward.evaluate(
            self.scene.conclusions,
            v=before.speed,
            v_next=self.ego.speed,
            d=0.0 if hit else self.gap,
        )
        success, timeout = self.ego.position >= self.geometry.goal, self.steps >= 600
        info = {
            "speed": self.ego.speed, "position": self.ego.position, "distance": self.gap, "ttc": np.inf,
            "is_success": success and not hit, "collision": hit, "timeout": timeout,
            "stopping_distance": np.nan, "contact_at_rest": 0,
        }  # fmt: skip
        return None, self.outcome.reward, hit or success, timeout, info


@pytest.mark.parametrize(
    ("driver", "person", "ending"),
    [
        (FullThrottle(), False, "success"),
        (FullThrottle(), True, "collision"),
        (NeverMoves(), True, "timeout"),
        (Oracle(), True, "timeout"),  # it knows who stands there, and waits
        (Cautious(), False, "success"),
    ],
    ids=lambda value: type(value).__name__ if callable(value) else str(value),
)
def test_a_street_of_another_simulator_is_driven_and_measured(driver, person, ending):
    result = drive_episode(PaperStreet(person), driver, seed=0).result
    assert result.ending == ending
    assert (result.measured["impact_speed"] is not None) == (ending == "collision")
    assert (result.measured["time_to_goal"] is not None) == (ending == "success")
    assert result.measured["rms_speed"] > 0 or isinstance(driver, NeverMoves)
    assert set(result.rules) == set(PaperStreet().pipeline.kb.rules)


def test_a_street_of_another_simulator_is_observed():
    street, observer = PaperStreet(), StateObserver()
    street.reset()
    street.ego = Ego(EgoParameters(), position=30.0)
    assert observer(street) in observer.space
    assert observer(street)[5:7] == pytest.approx([32.0 / 60.0, 0.0])  # who stands there
