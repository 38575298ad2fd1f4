"""Policy files drive by the observation that they were trained on, and only if they are trusted."""

import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import A2C, PPO, SAC, TD3
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from env.driving import pickled_policies, policies
from env.driving.pickled_policies import PickledPolicyDriver
from env.driving.policies import file_hash, make_driver
from env.driving.policy_files import PolicyFile
from env.driving.setup import training_name
from env.street.crossing import OccludedCrossing
from env.street.observation import observer_of
from env.study.study_results import StudyFolder
from env.world.cells import CELLS
from sfol.errors import SfolError
from tests.env.spaces import PEDAL, Spaces


def test_the_projects_own_policy_is_what_results_say():
    file = policies.policy_file(policies.TRAINED)
    card = PolicyFile(file).card()
    study = StudyFolder(Path(__file__).parents[3] / "results" / "study")
    name = training_name(card.training["name"], card.training["seed"])
    drives = [drive.settings for drive in study.drive_results() if drive.settings.driver == name]
    assert {(drive.traffic, drive.occlusion) for drive in drives} == set(CELLS)
    driven = {drive.policy for drive in drives} | {study.trajectory(name).policy}
    assert driven == {study.training(name).policy} == {file_hash(file)}


def save_policy(path, observations, actions=PEDAL):
    network = {"net_arch": [2]}
    PPO("MlpPolicy", Spaces(observations, actions), policy_kwargs=network, seed=1).save(path)
    return path


@pytest.fixture(scope="module")
def street():
    street = OccludedCrossing(traffic="low", perception="truth", observation="state")
    street.reset(seed=0)
    yield street
    street.close()


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A folder that stands for the project's own."""
    folder = tmp_path_factory.mktemp("project")
    (folder / "pyproject.toml").touch()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pickled_policies, "_PROJECT", folder)
        yield folder


@pytest.fixture(scope="module")
def state_policy(project, street):
    return save_policy(project / "state.zip", street.observation_space)


@pytest.mark.parametrize("kind", ["image", "state"])
def test_a_policy_gets_the_observation_that_it_was_trained_on(project, street, kind):
    observer = observer_of(kind, side=224)
    path = save_policy(project / f"{kind}.zip", observer.space)
    expected, _ = PPO.load(path).predict(observer(street), deterministic=True)
    driver = make_driver(str(path))
    driver.reset()
    assert driver(street) == pytest.approx(expected.item())
    assert -1.0 <= driver(street) <= 1.0


def algorithms():
    """Return every algorithm whose policies are read, with small networks and what it needs."""
    small = {"net_arch": [4]}
    yield pytest.param(PPO, "MlpPolicy", small, {}, id="PPO")
    yield pytest.param(A2C, "MlpPolicy", small, {}, id="A2C")
    yield pytest.param(SAC, "MlpPolicy", small, {"buffer_size": 1}, id="SAC")
    yield pytest.param(TD3, "MlpPolicy", small, {"buffer_size": 1}, id="TD3")
    contrib = pytest.importorskip("sb3_contrib")
    yield pytest.param(contrib.TQC, "MlpPolicy", small, {"buffer_size": 1}, id="TQC")
    recurrent = small | {"lstm_hidden_size": 3}
    yield pytest.param(contrib.RecurrentPPO, "MlpLstmPolicy", recurrent, {}, id="RecurrentPPO")


@pytest.mark.parametrize(("algorithm", "policy", "network", "options"), algorithms())
def test_any_algorithm_s_policy_drives_and_remembers_what_it_should(
    project, street, algorithm, policy, network, options
):
    path = project / f"{algorithm.__name__}.zip"
    streets = Spaces(street.observation_space, PEDAL)
    model = algorithm(policy, streets, policy_kwargs=dict(network), seed=1, **options)
    model.save(path)
    driver, observer = make_driver(str(path)), observer_of("state", side=224)
    for _ in range(2):  # the second episode knows nothing of the first
        driver.reset()
        memory = None
        for step in range(3):
            action, memory = model.predict(
                observer(street), memory, np.array([step == 0]), deterministic=True
            )
            assert driver(street) == pytest.approx(action.item(), abs=1e-6)


def normalised(street, path, **options):
    """Save a policy of which a step was learnt on normalised observations; return both."""
    streets = VecNormalize(DummyVecEnv([lambda: Spaces(street.observation_space, PEDAL)]))
    model = PPO("MlpPolicy", streets, n_steps=2, batch_size=2, n_epochs=1, seed=1)
    model.learn(2)
    with torch.no_grad():
        model.policy.action_net.weight *= 50.0  # in the beginning all pedals are around 0
    streets.obs_rms.update(np.random.default_rng(0).normal(0.5, 0.2, (100, 45)))
    model.save(path)
    return model, streets


@pytest.mark.parametrize(
    "name", ["normal.pkl", "normal_vecnormalize.pkl", "vecnormalize.pkl"], ids=str
)
def test_a_policy_drives_by_observations_normalised_as_in_its_training(
    project, street, tmp_path, name
):
    path = tmp_path / "normal.zip"
    model, streets = normalised(street, path)
    with pytest.raises(SfolError, match=r"VecNormalize had normalised.*is missing") as caught:
        make_driver(str(path), trust=True)
    assert name in caught.value.suggestion
    streets.save(tmp_path / name)
    observation = observer_of("state", side=224)(street)
    expected, _ = model.predict(streets.normalize_obs(observation), deterministic=True)
    driver = make_driver(str(path), trust=True)
    assert driver(street) == pytest.approx(np.clip(expected.item(), -1.0, 1.0), abs=1e-6)
    plain, _ = model.predict(observation, deterministic=True)
    assert abs(plain.item() - expected.item()) > 1e-3


def test_what_observations_were_normalised_by_is_trusted_no_more_than_the_policy(
    project, street, tmp_path
):
    path = project / "linked.zip"
    _, streets = normalised(street, path)
    streets.save(tmp_path / "elsewhere.pkl")
    (project / "linked.pkl").symlink_to(tmp_path / "elsewhere.pkl")
    with pytest.raises(SfolError, match=r"linked\.pkl' is not in the project's folder"):
        make_driver(str(path))


@pytest.mark.parametrize("content", [b"no pickle", pickle.dumps([1])])
def test_what_is_no_normalisation_is_an_error(project, street, content):
    path = project / "spoilt.zip"
    normalised(street, path)
    path.with_suffix(".pkl").write_bytes(content)
    with pytest.raises(SfolError, match=r"spoilt\.pkl' holds nothing that VecNormalize"):
        make_driver(str(path))


def test_a_policy_from_elsewhere_is_not_loaded_unless_trusted(project, state_policy, tmp_path):
    elsewhere = tmp_path / "policy.zip"
    elsewhere.write_bytes(state_policy.read_bytes())
    with pytest.raises(SfolError, match="pickle") as caught:
        make_driver(str(elsewhere))
    assert "--trust" in str(caught.value)
    assert isinstance(make_driver(str(elsewhere), trust=True), PickledPolicyDriver)


def test_a_link_out_of_the_project_is_not_trusted(project, state_policy, tmp_path):
    elsewhere = tmp_path / "policy.zip"
    elsewhere.write_bytes(state_policy.read_bytes())
    link = project / "link.zip"
    link.symlink_to(elsewhere)
    with pytest.raises(SfolError, match="not in the project's folder"):
        make_driver(str(link))


def test_without_a_checkout_nothing_is_trusted(state_policy, monkeypatch):
    monkeypatch.setattr(pickled_policies, "_PROJECT", state_policy.parents[1])
    with pytest.raises(SfolError, match="not in the project's folder"):
        make_driver(str(state_policy))


@pytest.mark.parametrize("content", ["text", "empty archive"])
def test_what_is_no_policy_is_an_error(project, content):
    path = project / "broken.zip"
    if content == "text":
        path.write_text("no archive")
    else:
        zipfile.ZipFile(path, "w").close()
    with pytest.raises(SfolError, match="no policy of stable-baselines3"):
        make_driver(str(path))


@pytest.mark.parametrize(
    ("observations", "actions", "message"),
    [
        (spaces.Box(-1.0, 1.0, (3,), np.float32), PEDAL, "trained on observations"),
        (spaces.Discrete(4), PEDAL, "trained on observations"),
        (None, spaces.Box(-1.0, 1.0, (2,), np.float32), "one number in"),
        (None, spaces.Discrete(3), "one number in"),
    ],
)
def test_other_spaces_than_the_street_s_are_an_error(
    project, street, observations, actions, message
):
    path = save_policy(project / "other.zip", observations or street.observation_space, actions)
    with pytest.raises(SfolError, match=message):
        make_driver(str(path))


def test_a_missing_file_and_an_unknown_name_are_errors():
    with pytest.raises(SfolError, match="no policy file"):
        make_driver("runs/nothing.zip")
    with pytest.raises(SfolError, match="did you mean 'cautious'"):
        make_driver("cautios")
