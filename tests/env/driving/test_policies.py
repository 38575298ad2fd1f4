"""Policy files drive by the observation that they were trained on, and only if they are trusted."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from gymnasium import spaces
from stable_baselines3 import PPO

from env.driving import policies
from env.driving.policies import PickledPolicyDriver, file_hash, make_driver
from env.driving.policy_files import PolicyFile
from env.driving.setup import load_setup, training_name
from env.street.crossing import OccludedCrossing
from env.street.observation import observer_of
from env.study.study_results import StudyFolder
from env.world.cells import CELLS
from sfol.errors import SfolError
from tests.env.spaces import PEDAL, Spaces


def test_the_projects_own_policy_is_what_setups_and_results_say():
    file = policies.policy_file(policies.TRAINED)
    setups = Path(__file__).parents[3] / "setups" / "shipped"
    card = PolicyFile(file).card()
    assert card.setup == load_setup(setups / "add.yaml")
    first = load_setup(setups / "add_first.yaml")
    assert (
        card.setup.start == f"runs/train/{training_name(first.name, first.seed)}/policy.safetensors"
    )
    study = StudyFolder(setups.parents[1] / "results" / "study")
    name = training_name(card.setup.name, card.setup.seed)
    assert study.training(name).setup_hash == card.setup.hash
    assert study.training(f"{first.name}-seed0").policy == card.start_hash
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
        patch.setattr(policies, "_PROJECT", folder)
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
    monkeypatch.setattr(policies, "_PROJECT", state_policy.parents[1])
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
