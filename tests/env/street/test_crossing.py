"""The environment: Gymnasium's contract, endings, infos, and the same episode for the same seed."""

import math

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from env.driving.drivers import FullThrottle
from env.street.crossing import OccludedCrossing
from sfol.errors import SfolError
from tests.env import rollout

STEP_KEYS = {"speed", "position", "distance", "ttc"}
END_KEYS = {"is_success", "collision", "timeout", "stopping_distance", "contact_at_rest"}


def drive(street, driver, seed):
    street.reset(seed=seed)
    driver.reset()
    infos, rewards = [], []
    while True:
        action = np.array([driver(street)], np.float32)
        _, reward, terminated, truncated, info = street.step(action)
        infos.append(info)
        rewards.append(reward)
        if terminated or truncated:
            return infos, rewards, terminated


@pytest.fixture(scope="module")
def reckless(street_of):
    """Episodes of the driver that sees nothing."""
    return [drive(street_of("low", "full"), FullThrottle(), seed) for seed in range(6)]


def test_the_id_builds_the_environment():
    with gymnasium.make("env:OccludedCrossing-v0", traffic="low", occlusion="partial") as street:
        assert isinstance(street.unwrapped, OccludedCrossing)
        assert street.unwrapped.traffic == "low"


@pytest.mark.filterwarnings("ignore:.*alternative render modes:UserWarning")
@pytest.mark.filterwarnings("error:.*:UserWarning:gymnasium")
def test_gymnasium_finds_no_fault(street_of):
    check_env(street_of("low", "partial"), skip_close_check=True)


def test_a_seed_decides_everything(street_of):
    street = street_of("medium", "full")
    first = rollout.digest(street, seed=3)
    assert rollout.digest(street, seed=4) != first
    drive(street, FullThrottle(), seed=0)
    assert rollout.digest(street, seed=3) == first


def test_terms_sum_to_the_reward(reckless):
    for infos, rewards, _ in reckless:
        for info, reward in zip(infos, rewards, strict=True):
            terms = [value for key, value in info.items() if key.startswith("reward_")]
            assert reward == pytest.approx(sum(terms), abs=1e-12)


def test_every_step_says_what_it_was_made_of(reckless, street_of):
    kb = street_of("low", "full").pipeline.kb
    expected = (
        STEP_KEYS
        | {f"reward_{term}" for term in kb.terms}
        | {f"weight_{name}" for name in kb.weights}
        | {f"confidence_{head}" for head in kb.heads}
    )
    for infos, _, _ in reckless:
        assert all(set(info) == expected for info in infos[:-1])
        assert set(infos[-1]) == expected | END_KEYS


def test_full_throttle_hits_somebody_and_sometimes_nobody(reckless):
    endings = {info["collision"] for (*_, info), _, _ in reckless}
    assert endings == {True, False}


def test_a_collision_ends_with_distance_zero_while_driving(reckless):
    for (*_, info), _, terminated in reckless:
        assert terminated
        assert info["is_success"] != info["collision"]
        if info["collision"]:
            assert info["distance"] == 0.0
            assert info["ttc"] == 0.0
            assert info["speed"] > 5.0
        else:
            assert info["position"] >= 90.0
        assert math.isnan(info["stopping_distance"])


def test_only_contact_has_distance_zero(reckless):
    for infos, _, _ in reckless:
        assert all(info["distance"] > 0.0 for info in infos if not info.get("collision"))


def test_time_runs_out():
    with OccludedCrossing(traffic="low", max_seconds=1.0) as street:
        street.reset(seed=0)
        ends = [street.step(np.zeros(1, np.float32))[2:4] for _ in range(10)]
        assert ends == [(False, False)] * 9 + [(False, True)]
        with pytest.raises(ResetNeeded):
            street.step(np.zeros(1, np.float32))


def test_stepping_needs_a_reset():
    with OccludedCrossing(traffic="low") as street, pytest.raises(ResetNeeded):
        street.step(np.zeros(1, np.float32))


@pytest.mark.parametrize("action", [[math.nan], [0.1, 0.2], []])
def test_an_action_is_one_finite_number(street_of, action):
    street = street_of("low", "full")
    street.reset(seed=0)
    with pytest.raises(SfolError, match="one finite number"):
        street.step(np.array(action, np.float32))


@pytest.mark.parametrize(
    ("name", "value", "hint"),
    [
        ("traffic", "hihg", "did you mean 'high'"),
        ("occlusion", "none", "partial, full"),
        ("behaviour", "sudden", "briefly_visible, hidden"),
        ("render_mode", "humna", "did you mean 'human'"),
        ("render_view", "top", "third_person, dash"),
        ("perception", "trhth", "did you mean 'truth'"),
        ("observation", "images", "did you mean 'image'"),
        ("control_hz", 7, "divisor of 100"),
        ("max_seconds", -1.0, "above 0"),
    ],
)
def test_a_wrong_argument_is_named_with_what_is_allowed(name, value, hint):
    with pytest.raises(SfolError, match=f"{name} can't be") as caught:
        OccludedCrossing(**{name: value})
    assert hint in str(caught.value)


@pytest.mark.parametrize("behaviour", ["briefly_visible", "hidden"])
def test_behaviour_can_be_fixed(behaviour):
    with OccludedCrossing(traffic="low", behaviour=behaviour) as street:
        assert {street.reset(seed=seed)[1]["behaviour"] for seed in range(4)} == {behaviour}


def test_close_twice():
    street = OccludedCrossing(traffic="low")
    street.close()
    street.close()


def test_render_shows_the_street_from_outside(street_of):
    street = street_of("low", "full")
    street.reset(seed=0)
    before = street.frame.gray
    picture = street.render()
    assert picture.shape == (360, 480, 3)
    assert picture.dtype == np.uint8
    assert np.array_equal(street.camera.capture(street.ego.position).gray, before)
