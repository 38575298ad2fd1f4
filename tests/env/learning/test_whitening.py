"""Whitening: what it does to observations, and that policies keep it."""

from contextlib import closing

import numpy as np
import pytest
import torch

from env.driving.policy_files import PolicyFile, act
from env.driving.setup import Setup
from env.learning import training
from env.learning.checkpoints import Checkpoints
from env.learning.vector_streets import make_streets
from env.learning.whitening import Whitening
from sfol import KnowledgeBase

SIZE = 6
DEVIATIONS = np.array([100.0, 30.0, 20.0, 1.0, 1.0, 0.1])


@pytest.fixture(scope="module")
def observations():
    """Observations that vary in each direction by another amount, around some mean."""
    rng = np.random.default_rng(3)
    rotation, _ = np.linalg.qr(rng.normal(size=(SIZE, SIZE)))
    return (5.0 + (rng.normal(size=(5000, SIZE)) * DEVIATIONS) @ rotation.T).astype(np.float32)


@pytest.fixture
def whitening():
    return Whitening(SIZE)


def test_unmeasured_it_changes_nothing(whitening, observations):
    seen = torch.from_numpy(observations)
    assert torch.equal(whitening(seen), seen)


def test_what_varies_most_is_shrunk_and_nothing_is_amplified(whitening, observations):
    whitening.measure(torch.from_numpy(observations))
    z = whitening(torch.from_numpy(observations)).double().numpy()
    assert np.allclose(z.mean(axis=0), 0.0, atol=1e-4)
    assert np.sqrt((z**2).mean()) == pytest.approx(0.3)
    deviations = np.sqrt(np.linalg.eigvalsh(np.cov(z.T)))[::-1]
    # By variance the floor is a hundredth of the largest; what lies below stays.
    floor = 10.0
    expected = np.minimum(DEVIATIONS, floor)
    assert deviations / deviations[0] == pytest.approx(expected / floor, rel=0.05)


def test_a_linear_layer_takes_it_in(whitening, observations):
    whitening.measure(torch.from_numpy(observations))
    layer = torch.nn.Linear(SIZE, 4)
    seen = torch.from_numpy(observations[:20])
    weight, bias = whitening.folded(layer.weight, layer.bias)
    torch.testing.assert_close(seen @ weight.T + bias, layer(whitening(seen)), atol=1e-4, rtol=1e-4)


@pytest.fixture
def small_setup():
    learning = {"rollout_steps": 16, "batch_size": 16, "layers": [8], "whitening_steps": 128}
    return Setup(
        version=1,
        name="white",
        observation="state",
        perception="truth",
        stages=[{"steps": 32, "traffic": ["low"], "occlusion": ["partial"]}],
        streets=1,
        checkpoint_steps=16,
        evaluation_episodes=1,
        learning=learning,
    )


def test_a_training_measures_once_and_its_policy_keeps_it(tmp_path, small_setup):
    told = []

    def train():
        told.clear()
        training.train(small_setup, tmp_path, progress=lambda _, what: told.append(what))
        checkpoints = Checkpoints(tmp_path, KnowledgeBase.load("crossing"))
        with closing(make_streets(small_setup, small_setup.stages[0].cells, seed=0)) as streets:
            return [checkpoints.read(path, small_setup, streets) for path in checkpoints.files()]

    first, _ = train()
    assert "looking around, 127 of 128 steps" in told
    assert first.policy.mlp_extractor.whitening.gains.min() < 0.5
    (tmp_path / "checkpoint-000000032.safetensors").unlink()
    (tmp_path / "evaluations.jsonl").unlink()
    _, last = train()  # goes on from the first checkpoint
    assert not any("looking around" in what for what in told)
    measured = dict(first.policy.mlp_extractor.whitening.named_buffers())
    for name, buffer in last.policy.mlp_extractor.whitening.named_buffers():
        assert torch.equal(buffer, measured[name])

    network = PolicyFile(tmp_path / "policy.safetensors").network()
    for seen in np.random.default_rng(0).uniform(-1.0, 1.0, (5, 45)).astype(np.float32):
        expected, _ = last.predict(seen, deterministic=True)
        assert act(network, seen) == pytest.approx(expected.item(), abs=1e-5)


def test_an_empty_street_leaves_observations_as_they_are(whitening):
    whitening.measure(torch.zeros(200, SIZE))
    assert torch.equal(whitening(torch.ones(2, SIZE)), torch.ones(2, SIZE))
