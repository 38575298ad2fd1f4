"""Checkpoints: all of a training is in them, and nothing that runs."""

import base64
import json
import logging
import pickle
import zipfile
from contextlib import closing
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from stable_baselines3 import PPO
from stable_baselines3.common.logger import configure

from env.driving.setup import Setup, changed
from env.learning import training
from env.learning.checkpoints import Checkpoints
from env.learning.new_model import normalised, untrained_model
from env.learning.vector_streets import make_streets
from sfol import KnowledgeBase
from sfol.errors import FileError, SfolError

RULES = KnowledgeBase.load("crossing")
SETUP = Setup.model_validate(
    {
        "version": 2,
        "name": "small",
        "observation": "state",
        "perception": "truth",
        "stages": [{"steps": 32, "traffic": ["low"], "occlusion": ["partial"]}],
        "streets": 1,
        "checkpoint_steps": 16,
        "evaluation_episodes": 1,
        "learning": {"rollout_steps": 16, "batch_size": 16, "layers": [8]},
    }
)


@pytest.fixture(scope="module")
def streets():
    with closing(normalised(SETUP, make_streets(SETUP, SETUP.stages[0].cells, seed=3))) as made:
        yield made


@pytest.fixture(scope="module")
def trained(streets):
    model = untrained_model(SETUP, streets)
    model.set_logger(configure(None, []))
    return model.learn(32)


@pytest.fixture
def checkpoints(tmp_path, trained):
    made = Checkpoints(tmp_path, RULES)
    made.write(trained)
    return made


def learnt_on(model, streets):
    """Return a model's parameters after a rollout and an update more."""
    streets.seed(7)
    model.set_logger(configure(None, []))
    model.learn(16, reset_num_timesteps=False)
    return model.policy.state_dict(), model.policy.optimizer.state_dict()


def test_a_training_goes_on_as_it_does_from_stable_baselines3_s_own(
    checkpoints, trained, streets, tmp_path
):
    trained.save(tmp_path / "model.zip")
    theirs = PPO.load(tmp_path / "model.zip", env=streets, device="cpu")
    (policy, optimiser), steps = learnt_on(theirs, streets), theirs.num_timesteps
    seen = (streets.obs_rms.mean.copy(), streets.obs_rms.count, streets.ret_rms.var)
    ours = checkpoints.last_model(SETUP, streets)  # the streets have seen what they had then
    assert streets.obs_rms.count == seen[1] - 16 - 1  # a rollout, and what reset returned
    assert ours.num_timesteps == trained.num_timesteps == 32
    assert ours._n_updates == trained._n_updates
    assert [info["l"] for info in ours.ep_info_buffer] == [i["l"] for i in trained.ep_info_buffer]
    assert list(ours.ep_success_buffer) == list(trained.ep_success_buffer)
    mine, moments = learnt_on(ours, streets)
    assert (streets.obs_rms.mean == seen[0]).all()
    assert (streets.obs_rms.count, streets.ret_rms.var) == seen[1:]
    assert ours.num_timesteps == steps == 48
    assert mine.keys() == policy.keys()
    assert all(torch.equal(mine[name], policy[name]) for name in policy)
    assert moments["param_groups"] == optimiser["param_groups"]
    for number, expected in optimiser["state"].items():
        assert all(torch.equal(moments["state"][number][name], expected[name]) for name in expected)


def test_the_last_three_are_kept(tmp_path, trained, monkeypatch):
    checkpoints = Checkpoints(tmp_path, RULES)
    for steps in (16, 32, 48, 64):
        monkeypatch.setattr(trained, "num_timesteps", steps)
        checkpoints.write(trained)
    assert [int(path.stem[-2:]) for path in checkpoints.files()] == [32, 48, 64]


class Trap:
    """Makes a file when it is unpickled."""

    def __init__(self, file):
        self.file = file

    def __reduce__(self):
        return Path.touch, (self.file,)


def plant(trap, path):
    """Write a checkpoint as stable-baselines3 does, with a trap in it."""
    code = base64.b64encode(pickle.dumps(trap)).decode()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", json.dumps({"policy_class": {":serialized:": code}}))


def test_no_code_runs_from_a_folder_of_a_stranger(tmp_path):
    sprung, folder = tmp_path / "sprung", tmp_path / "run"
    folder.mkdir()
    (folder / "setup.json").write_text(SETUP.model_dump_json())
    plant(Trap(sprung), folder / "checkpoint-000000016.zip")
    with pytest.raises(Exception, match=r".*"):
        PPO.load(folder / "checkpoint-000000016.zip")
    assert sprung.exists()  # it is a trap
    sprung.unlink()

    with pytest.raises(FileError, match=r"\.zip' is a checkpoint of an earlier version: a pickle"):
        training.train(SETUP, folder)
    for content in (pickle.dumps(Trap(sprung)), (folder / "checkpoint-000000016.zip").read_bytes()):
        (folder / "checkpoint-000000016.safetensors").write_bytes(content)
        with pytest.raises(FileError, match=r"no checkpoint in .* can be read"):
            training.train(SETUP, folder)
    assert not sprung.exists()


def test_a_pickle_beside_checkpoints_is_not_looked_at(checkpoints, streets, tmp_path):
    plant(Trap(tmp_path / "sprung"), tmp_path / "checkpoint-000000048.zip")
    assert checkpoints.last_model(SETUP, streets).num_timesteps == 32
    assert not (tmp_path / "sprung").exists()


def damaged(path, change):
    """Rewrite a checkpoint with other tensors."""
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    tensors = load_file(path)
    change(tensors, metadata)
    save_file(tensors, path, metadata)


def set_header(text):
    def change(tensors, metadata):
        metadata["training"] = text

    return change


CHANGES = {
    "no header": lambda tensors, metadata: metadata.clear(),
    "no JSON": set_header("{"),
    "deep JSON": set_header("[" * 100_000),
    "negative steps": set_header(
        '{"knowledge_base_hash": "", "steps": -1, "updates": 0, "episodes": [], "successes": []}'
    ),
    "a weight less": lambda tensors, metadata: tensors.pop("policy.log_std"),
    "a weight more": lambda tensors, metadata: tensors.update({"policy.more": torch.ones(1)}),
    "another shape": lambda tensors, metadata: tensors.update({"policy.log_std": torch.ones(99)}),
    "no number": lambda tensors, metadata: tensors["policy.log_std"].fill_(torch.nan),
    "a moment less": lambda tensors, metadata: tensors.pop("optimiser.0.exp_avg"),
    "a moment more": lambda tensors, metadata: tensors.update(
        {"optimiser.9999.step": torch.ones(())}
    ),
    "another moment": lambda tensors, metadata: tensors.update({"optimiser.0.step": torch.ones(3)}),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_damaged_checkpoint_is_named_and_the_one_before_is_taken(
    checkpoints, trained, streets, monkeypatch, caplog, change
):
    monkeypatch.setattr(trained, "num_timesteps", 48)
    checkpoints.write(trained)
    first, last = checkpoints.files()
    damaged(last, change)
    with caplog.at_level(logging.WARNING):
        assert checkpoints.last_model(SETUP, streets).num_timesteps == 32
    assert f"{last} is skipped" in caplog.text
    first.unlink()
    with pytest.raises(FileError, match=r"no checkpoint in .* can be read"):
        checkpoints.last_model(SETUP, streets)
    assert last.exists()


def test_a_training_does_not_go_on_under_other_rules(checkpoints, streets, tmp_path):
    other = Checkpoints(tmp_path, KnowledgeBase.load("aeb"))
    with pytest.raises(SfolError, match="under other rules: 'aeb' has changed"):
        other.last_model(SETUP, streets)


def overflow(model):
    """Let a policy's mean be infinite, though each of its weights is finite."""
    model.policy.mlp_extractor.policy_net[0].bias.data.fill_(100.0)  # tanh is 1
    model.policy.action_net.weight.data.fill_(3e38)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda model: model.policy.log_std.data.fill_(torch.nan),
        lambda model: model.policy.value_net.weight.data.fill_(torch.inf),
        overflow,
    ],
)
def test_weights_that_are_no_numbers_end_a_training_and_are_not_kept(tmp_path, monkeypatch, spoil):
    update = PPO.train

    def diverging(model):
        update(model)
        if model.num_timesteps == 32:
            spoil(model)

    monkeypatch.setattr(PPO, "train", diverging)
    with pytest.raises(SfolError, match="the training has diverged"):
        training.train(SETUP, tmp_path)
    (kept,) = Checkpoints(tmp_path, RULES).files()
    assert kept.name == "checkpoint-000000016.safetensors"
    assert all(tensor.isfinite().all() for tensor in load_file(kept).values())


def test_a_training_that_diverges_ends_with_an_error(tmp_path):
    learning = SETUP.learning.model_dump() | {"learning_rate": 1e30, "last_learning_rate": 1e30}
    setup = changed(SETUP, learning=learning)
    with pytest.raises(SfolError, match="the training has diverged"):
        training.train(setup, tmp_path)
