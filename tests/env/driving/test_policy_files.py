"""Policies that `aeb train` writes: they need no trust, and drive as what was trained."""

import json
from functools import partial

import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack

import sfol
from env.driving.policies import TrainedDriver, file_hash, make_driver
from env.driving.policy_files import PolicyCard, PolicyFile, act, load_actor
from env.driving.setup import Setup
from env.evaluation.evaluate import Drive
from env.learning.actor_critic import ActorCritic
from env.learning.curriculum import StreetsInTurn
from env.learning.new_model import codebook_of, untrained_model
from env.learning.vector_streets import make_streets
from env.perception.weights_folder import FOLDER_VARIABLE
from env.street.crossing import OccludedCrossing
from env.world.cells import Cell
from sfol.errors import SfolError
from tests.env.spaces import Spaces

CELL = Cell("low", "partial")
STREET = {"traffic": "low", "occlusion": "partial", "perception": "truth", "observation": "state"}


def setup(**settings):
    stages = [{"steps": 1, "traffic": ["low"], "occlusion": ["partial"]}]
    network = {"learning": {"layers": [8, 4]}}
    return Setup.model_validate(
        {"version": 1, "name": "small", "stages": stages, **network, **settings}
    )


def write(path, model, chosen):
    card = PolicyCard(
        setup=chosen,
        steps=1,
        knowledge_base="crossing",
        knowledge_base_hash="0",
        evaluation={},
        versions={},
    )
    PolicyFile(path).write(card, model, codebook_of(chosen))
    return path


def untrained(streets, **options):
    kwargs = {"net_arch": {"pi": [8, 4], "vf": [8]}}
    return PPO(ActorCritic, streets, policy_kwargs=kwargs, seed=3, device="cpu", **options)


@pytest.fixture(scope="module")
def streets():
    streets = VecFrameStack(DummyVecEnv([lambda: OccludedCrossing(**STREET)]), 3)
    yield streets
    streets.close()


@pytest.fixture(scope="module", params=[False, True], ids=["noise by step", "noise by state"])
def model(streets, request):
    return untrained(streets, use_sde=request.param)


@pytest.fixture
def policy(tmp_path, model):
    chosen = setup(observation="state", perception="truth", frames=3)
    return write(tmp_path / "small.safetensors", model, chosen)


def test_what_observations_were_scaled_by_is_part_of_the_policy(tmp_path, model):
    scaled = setup(observation="state", learning={"layers": [8, 4], "observation_scale": 0.25})
    file = write(tmp_path / "scaled.safetensors", model, scaled)
    seen = np.linspace(-4.0, 4.0, model.observation_space.shape[0], dtype=np.float32)
    expected, _ = model.predict(np.float32(0.25) * seen, deterministic=True)
    assert act(PolicyFile(file).network(), seen) == pytest.approx(expected.item(), abs=1e-6)


@pytest.mark.parametrize(("frames", "extra"), [(3, 0), (3, 1), (1, 1)])
def test_what_a_policy_was_not_given_has_no_weight_when_another_starts_from_it(
    tmp_path, frames, extra
):
    """As if ego's speed, or earlier frames, were added to what it drives by."""
    width = 5

    def model(count, inputs):
        space = spaces.Box(-1.0, 1.0, (count * inputs,), np.float32)
        return untrained(DummyVecEnv([partial(Spaces, space)]))

    file = PolicyFile(write(tmp_path / "first.safetensors", model(1, width), setup()))
    later = setup(frames=frames, learning={"layers": [8, 4], "observation_scale": 0.5})
    second = model(frames, width + extra)
    load_actor(second, file, later)
    seen = np.random.default_rng(0).normal(size=(frames, width + extra)).astype(np.float32)
    action, _ = second.predict(np.float32(0.5) * seen.ravel(), deterministic=True)
    expected = act(file.network(), seen[-1, :width])
    assert action.item() == pytest.approx(expected, abs=1e-6)


def test_it_drives_as_the_model_from_its_file_alone(policy, model, streets):
    driver = make_driver(str(policy))  # outside the project's folder, and nobody trusts it
    street = OccludedCrossing(**STREET)
    for seed in (5, 6):  # a second episode knows nothing of the first
        streets.seed(seed)
        seen = streets.reset()
        street.reset(seed=seed)
        driver.reset()
        for _ in range(6):
            expected, _ = model.predict(seen, deterministic=True)
            pedal = driver(street)
            assert pedal == pytest.approx(expected.item(), abs=1e-6)
            seen, *_ = streets.step(expected)
            street.step(np.array([pedal], np.float32))
    street.close()


def test_it_observes_what_it_was_trained_on(tmp_path):
    chosen = setup(
        observation="vsr",
        perception="simulator",
        fusion="ssi",
        speed=True,
        frames=2,
        critic="state",
        streets=1,
    )
    trained_on = make_streets(chosen, [CELL], seed=0)
    model = untrained_model(chosen, trained_on)
    path = write(tmp_path / "vsr.safetensors", model, chosen)
    trained_on.seed(7)  # the model has given it its own
    driver = TrainedDriver(path)
    kb = sfol.KnowledgeBase.load("crossing")
    turn = StreetsInTurn((CELL,), rules=kb, observation="state", perception="simulator")
    try:
        expected = trained_on.reset()
        turn.reset(seed=7)
        for pedal in (1.0, 1.0, -0.5, 0.3):
            seen = model.policy.mlp_extractor.of_actor(torch.from_numpy(expected))
            np.testing.assert_allclose(driver.observe(turn.street), seen[0], atol=1e-5)
            expected, *_ = trained_on.step(np.array([[pedal]], np.float32))
            turn.step(np.array([pedal], np.float32))
        assert np.abs(expected[0]).max() > 0.1
    finally:
        trained_on.close()
        turn.close()


def test_the_policy_beside_the_networks_weights_has_a_name(tmp_path, model, monkeypatch):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    chosen = setup(observation="state", perception="truth", frames=3)
    file = write(tmp_path / "policy.safetensors", model, chosen)
    assert isinstance(make_driver("trained"), TrainedDriver)
    settings = Drive("trained", CELL, sfol.KnowledgeBase.load("crossing")).settings
    assert (settings.driver, settings.policy) == ("trained", file_hash(file))
    with pytest.raises(SfolError) as error:
        make_driver("traned")
    assert "trained" in str(error.value)
    file.unlink()
    with pytest.raises(SfolError, match="no policy file"):
        make_driver("trained")


@pytest.mark.parametrize(
    ("break_it", "message"),
    [
        (lambda path: path.unlink(), "no policy file"),
        (lambda path: path.with_suffix(".json").unlink(), "no card of a policy"),
        (lambda path: path.with_suffix(".json").write_text("{}"), "no card of a policy"),
        (lambda path: path.write_bytes(path.read_bytes()[:99]), "can't be read"),
        (lambda path: _widen(path.with_suffix(".json")), "holds no policy"),
    ],
)
def test_what_is_no_policy_is_an_error(policy, break_it, message):
    break_it(policy)
    with pytest.raises(SfolError, match=message):
        make_driver(str(policy))


def _widen(card):
    content = json.loads(card.read_text())
    content["setup"]["learning"]["layers"] = [64, 64]
    card.write_text(json.dumps(content))


def test_the_codebook_is_part_of_a_policy(tmp_path, model):
    path = write(tmp_path / "vsr.safetensors", model, setup(observation="vsr", fusion="ssi"))
    make_driver(str(path))
    path.with_suffix(".codebook.safetensors").unlink()
    with pytest.raises(SfolError, match="codebook"):
        make_driver(str(path))
