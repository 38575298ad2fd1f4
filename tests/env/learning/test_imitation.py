"""Imitation: a learner is shown what to do, and what it learns is a policy like any other."""

import json

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from env.cli import app
from env.driving.policies import make_driver
from env.driving.policy_files import PolicyFile, act
from env.driving.setup import Setup
from env.learning.imitation import Lessons, imitate
from env.learning.training import train
from sfol.errors import SfolError, UsageError

SMALL = {
    "version": 2,
    "name": "small",
    "observation": "state",
    "perception": "truth",
    "stages": [{"steps": 32, "traffic": ["low"], "occlusion": ["partial"]}],
    "streets": 1,
    "evaluation_episodes": 1,
    "learning": {"rollout_steps": 16, "batch_size": 16, "layers": [16]},
}
FEW = Lessons(rounds=2, decisions=200, most_passes=60, patience=60, batch_size=16)


def setup(**changes):
    return Setup.model_validate(SMALL | changes)


@pytest.fixture(scope="module")
def imitated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("imitated")
    told = []
    done = imitate(setup(), folder, FEW, progress=lambda seen, what: told.append((seen, what)))
    return done, told


def test_rounds_are_told_and_written_down(imitated):
    done, told = imitated
    assert [row["steps"] for row in done.rounds] == [200, 400]
    assert all(row["success"] + row["collision"] + row["timeout"] == 1.0 for row in done.rounds)
    rows = (done.policy.parent / "rounds.jsonl").read_text().splitlines()
    assert [json.loads(row) for row in rows] == list(done.rounds)
    assert (200, "the teacher drives") in told
    assert (400, "the learner drives") in told
    assert (200, "learning, round 1, pass 1") in told


def test_more_is_learnt_than_to_do_always_the_same(imitated):
    """The teacher's pedals vary by far more than the learner is wrong."""
    done, _ = imitated
    assert done.rounds[0]["error"] < 0.1  # of full throttle that turns to 0, then to brake
    assert done.rounds[-1]["held_back_error"] < 0.5


def test_its_policy_drives_and_says_how_it_came_to_be(imitated):
    done, _ = imitated
    card = PolicyFile(done.policy).card()
    assert card.interface.decision_steps == 4
    assert card.interface.standardised
    assert card.steps == 400
    assert card.training["imitation"]["teacher"] == "cautious"
    assert Setup.model_validate(card.training["setup"]) == setup()
    assert make_driver(str(done.policy))


def test_a_training_starts_from_it(imitated, tmp_path):
    done, _ = imitated
    later = setup(start=str(done.policy), learning=SMALL["learning"] | {"value_steps": 16})
    first = PolicyFile(train(later, tmp_path / "trained").policy)
    assert first.card().start_hash is not None
    if first.card().steps == 0:  # nothing better came of so short a training
        seen = np.random.default_rng(0).uniform(-1.0, 1.0, 45).astype(np.float32)
        expected = act(PolicyFile(done.policy).network(), seen)
        assert act(first.network(), seen) == pytest.approx(expected, abs=1e-5)


def test_the_same_seed_teaches_the_same(imitated, tmp_path):
    again = imitate(setup(), tmp_path, FEW)
    one, other = (PolicyFile(d.policy).network().state_dict() for d in (imitated[0], again))
    assert all(torch.equal(one[name], other[name]) for name in one)


def test_a_policy_that_is_there_is_not_written_over(imitated):
    done, _ = imitated
    before = done.policy.read_bytes()
    with pytest.raises(UsageError, match="has a policy already"):
        imitate(setup(), done.policy.parent, FEW)
    assert done.policy.read_bytes() == before


def test_an_unknown_teacher_is_named(tmp_path):
    with pytest.raises(SfolError, match="did you mean 'cautious'"):
        imitate(setup(), tmp_path, Lessons(teacher="cautius"))


def test_the_command_changes_what_is_seen(tmp_path):
    file = tmp_path / "small.yaml"
    file.write_text(json.dumps(SMALL))
    command = ["imitate", "--setup", str(file), "--rounds", "1", "--decisions", "64"]
    output = tmp_path / "linear"
    done = CliRunner().invoke(
        app, [*command, "--frames", "2", "--linear", "--seed", "3", "--output", str(output)]
    )
    assert done.exit_code == 0, done.output
    assert "After each round" in done.output
    card = PolicyFile(output / "policy.safetensors").card()
    assert (card.interface.frames, card.interface.layers) == (2, ())
    assert card.training["setup"]["seed"] == 3
    assert set(PolicyFile(output / "policy.safetensors").network().state_dict()) == {
        *("standardised.mean", "standardised.deviation", "0.weight", "0.bias")
    }
