"""Setups and training: what is refused, and that a training which was stopped goes on."""

import contextlib
import json
import logging
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from env.cli import app
from env.driving.policies import file_hash
from env.driving.policy_files import PolicyFile, act
from env.driving.setup import Setup, changed, load_setup, setup_names
from env.learning import training
from env.learning.journal import History
from env.learning.new_model import (
    actor_of,
    load_policy,
    new_model,
    normalised,
    untrained_model,
)
from env.learning.training import train
from env.learning.vector_streets import make_streets
from sfol import KnowledgeBase
from sfol.errors import SfolError, UsageError
from sfol.locking import locked_folder

SMALL = """
version: 2
name: small
observation: state
perception: truth
decision_steps: 1
stages: [{steps: 64, traffic: [low], occlusion: [partial]}]
streets: 1
checkpoint_steps: 16
evaluation_steps: 1000
evaluation_episodes: 1
learning: {rollout_steps: 16, batch_size: 16, n_epochs: 1, layers: [8]}
"""


EPISODE = {"return": 0.0, "is_success": False, "collision": False, "timeout": True}


@pytest.fixture
def setup_file(tmp_path):
    path = tmp_path / "small.yaml"
    path.write_text(SMALL)
    return path


def steps_of(path):
    return int(path.stem.split("-")[1])


def test_the_papers_eight_setups_and_two_of_our_own_are_there():
    assert set(setup_names()) == {
        *("add", "multiply", "ssi", "sf", "ce_ps", "pe_cs", "pe_ps", "risk_factors"),
        *("state", "beyond"),
    }


@pytest.mark.parametrize("name", setup_names())
def test_bundled_setups_are_valid_and_on_this_street(name):
    setup = load_setup(name)
    assert setup.name == name
    assert setup.description
    grounding = KnowledgeBase.load(*setup.rules).grounding.model_dump()["segmentation"]
    assert grounding["approaching"] == [15.0, 45.0]


def test_stages_follow_one_another():
    stages = [{"steps": 10, "traffic": ["low"]}, {"steps": 20, "traffic": ["medium", "high"]}]
    setup = Setup.model_validate({"version": 2, "name": "s", "stages": stages})
    assert setup.steps == 30
    assert [setup.stage_at(step).traffic[0] for step in (0, 9, 10, 29, 99)] == [
        *("low", "low", "medium", "medium", "medium")
    ]
    assert setup.stages[1].cells == (
        *(("medium", "partial"), ("medium", "full")),
        *(("high", "partial"), ("high", "full")),
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("observation", "observaton", "observaton.*did you mean 'observation'"),
        ("state", "stat", "observation: Input should be"),
        ("[low]", "[slow]", "traffic"),
        ("streets: 1", "speed: true", "has ego's speed anyway"),
        ("steps: 64", "steps: 0", "greater than 0"),
        ("streets: 1", "streets: 3", "16 steps for an update.*3 streets: choose a multiple"),
        ("layers: [8]", "log_std_init: .nan", "finite|\\.nan"),
        ("layers: [8]", "learning_rate: .inf", "finite|\\.inf"),
        ("decision_steps: 1", "decision_steps: 0", "greater than 0"),
        ("version: 2", "version: 1", "version: Input should be 2"),
        ("version: 2", "version: [", "small.yaml:"),
    ],
)
def test_mistakes_in_a_setup_are_named(setup_file, old, new, message):
    setup_file.write_text(SMALL.replace(old, new, 1))
    done = CliRunner().invoke(app, ["train", "--setup", str(setup_file)])
    with pytest.raises(UsageError, match=message) as error:
        load_setup(setup_file)
    assert isinstance(done.exception, UsageError)
    assert str(error.value) == str(done.exception)


def test_an_unknown_setup_has_a_suggestion():
    with pytest.raises(UsageError, match="did you mean 'multiply'"):
        load_setup("multipy")


def test_the_number_of_streets_is_an_option(setup_file, tmp_path):
    command = ["train", "--setup", str(setup_file), "--output", str(tmp_path / "[/] run")]
    done = CliRunner().invoke(app, [*command, "--streets", "3"])
    assert isinstance(done.exception, UsageError)
    assert "3 streets: choose a multiple" in str(done.exception)
    done = CliRunner().invoke(app, [*command, "--streets", "4"])
    assert done.exit_code == 0
    card = PolicyFile(tmp_path / "[/] run" / "policy.safetensors").card()
    used = Setup.model_validate(card.training)
    assert used == load_setup(setup_file).model_copy(update={"streets": 4})
    assert card.steps == 64


@pytest.mark.parametrize("speed", [False, True])
def test_streets_in_processes_are_as_one_alone(speed):
    """A worker draws, perceives, describes and rewards as a street does in this process."""
    stages = [{"steps": 4096, "traffic": ["low"], "occlusion": ["full"]}]
    chosen = {"version": 2, "name": "s", "stages": stages, "fusion": "ssi", "speed": speed}
    setups = (Setup.model_validate({**chosen, "streets": count}) for count in (2, 1))
    many, alone = (make_streets(setup, setup.stages[0].cells, seed=7) for setup in setups)
    with contextlib.closing(many), contextlib.closing(alone):
        np.testing.assert_array_equal(many.reset()[:1], alone.reset())
        for pedal in (1.0, 1.0, -0.5):
            observations, rewards, _, infos = many.step(np.array([[pedal], [0.2]], np.float32))
            expected, reward, _, (info,) = alone.step(np.array([[pedal]], np.float32))
            np.testing.assert_array_equal(observations[:1], expected)
            np.testing.assert_allclose(rewards[:1], reward, rtol=1e-6)  # float64 and float32
            assert infos[0] == info
        assert np.abs(observations[0, :2048]).max() > 0.1
        assert not np.array_equal(observations[0], observations[1])
        top_speed = 40 / 3.6
        assert observations.shape == (2, 2048 + speed)
        assert not speed or observations[0, -1] == pytest.approx(20 * info["speed"] / top_speed)


def streets_with(**learning):
    setup = Setup.model_validate({**yaml.safe_load(SMALL), "learning": learning})
    return setup, make_streets(setup, setup.stages[0].cells, seed=3)


@pytest.mark.parametrize(("norm_obs", "norm_reward"), [(True, False), (False, True)])
def test_what_is_normalised_is_what_the_setup_says(norm_obs, norm_reward):
    _, plain = streets_with()
    chosen = {"norm_obs": norm_obs, "norm_reward": norm_reward, "observation_scale": 0.5}
    setup, streets = streets_with(**chosen)
    with contextlib.closing(plain), contextlib.closing(normalised(setup, streets)) as changed:
        plain.reset(), changed.reset()
        for _ in range(600):  # until time is up, at the latest
            one, reward, (done,), (info,) = plain.step(np.full((1, 1), 1.0))
            two, other, _, (second,) = changed.step(np.full((1, 1), 1.0))
            if done:
                break
        assert done
        assert np.array_equal(reward, other) != norm_reward
        assert info["episode"]["r"] == second["episode"]["r"]  # told as the rules give it
        last, scaled = info["terminal_observation"], second["terminal_observation"]
        for before, after in ((one, two), (last, scaled)):
            assert np.allclose(0.5 * before, after, atol=1e-6) != norm_obs


def test_the_discount_is_that_of_as_many_control_steps():
    setup, streets = streets_with(gamma=0.99)
    setup = changed(setup, decision_steps=4)
    with contextlib.closing(normalised(setup, streets)) as seen:
        assert untrained_model(setup, seen).gamma == seen.gamma == pytest.approx(0.99**4)


def test_a_training_that_was_stopped_goes_on(setup_file, tmp_path, caplog, monkeypatch):
    folder = tmp_path / "run"

    class StoppedError(Exception):
        pass

    def stop(steps, stage):
        if steps == 40:
            raise StoppedError

    with pytest.raises(StoppedError):
        train(load_setup(setup_file), folder, progress=stop)
    checkpoints = sorted(folder.glob("checkpoint-*.safetensors"))
    assert [steps_of(path) for path in checkpoints] == [16, 32]
    checkpoints[-1].write_bytes(b"half a checkpoint")

    seen = []
    with caplog.at_level(logging.WARNING):
        trained = train(
            load_setup(setup_file), folder, progress=lambda steps, stage: seen.append(steps)
        )
    assert checkpoints[-1].name in caplog.text
    assert "skipped" in caplog.text
    assert seen == [16, *range(17, 65)]  # the first is told while streets are built
    assert trained.steps == 64
    assert not list(folder.glob("*.part*"))

    # Stopped in the evaluation at the end, it has only that left to do.
    (folder / "evaluations.jsonl").unlink()
    seen.clear()
    again = train(load_setup(setup_file), folder, progress=lambda steps, stage: seen.append(steps))
    assert seen == []
    assert [row["steps"] for row in again.evaluations] == [64]
    assert again.episodes == trained.episodes

    monkeypatch.setattr(training, "make_streets", None)  # there is nothing left to do
    assert train(load_setup(setup_file), folder) == again


def test_what_happens_is_written_down_once_however_often_a_training_starts(tmp_path):
    text = SMALL.replace("steps: 64", "steps: 128").replace(
        "rollout_steps: 16", "rollout_steps: 64"
    )
    setup = Setup.model_validate(yaml.safe_load(text) | {"evaluation_steps": 64})
    folder = tmp_path / "run"

    def stop(steps, stage):
        if steps == 100:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(setup, folder, progress=stop)
    # As if this had been written after the last checkpoint:
    History(folder / "episodes.jsonl", ()).append({"steps": 90, "seconds": 1.0} | EPISODE)
    trained = train(setup, folder)
    assert [row["steps"] for row in trained.evaluations] == [64, 128]
    assert all(row["success_low"] == row["success"] for row in trained.evaluations)
    assert 90 not in {row["steps"] for row in trained.episodes}
    assert trained.seconds >= trained.evaluations[0]["seconds"] > 0.0


def test_a_training_that_is_stopped_often_is_evaluated_as_often_as_one_that_is_not(
    setup_file, tmp_path, monkeypatch
):
    result = {"success": 0.0, "return": 0.0}
    monkeypatch.setattr(training, "evaluate_policy", lambda model, setup: result)
    changes = {"evaluation_steps": 40, "checkpoint_steps": 32}
    stages = [{"steps": 160, "traffic": ["low"], "occlusion": ["partial"]}]
    setup = changed(load_setup(setup_file), stages=stages, **changes)
    expected = [row["steps"] for row in train(setup, tmp_path / "whole").evaluations]
    assert expected == [48, 96, 144, 160]

    class StoppedError(Exception):
        pass

    def stop(start):
        def progress(steps, stage):
            if stage != "building streets" and steps >= start + 50:
                raise StoppedError

        return progress

    folder, starts = tmp_path / "stopped", []
    while True:
        kept = [steps_of(path) for path in folder.glob("checkpoint-*")]
        starts.append(max(kept, default=0))
        with contextlib.suppress(StoppedError):
            trained = train(setup, folder, progress=stop(starts[-1]))
            break
    assert [row["steps"] for row in trained.evaluations] == expected
    assert starts == sorted(set(starts))
    assert len(starts) > 2


def pedals(file):
    """Return what a written policy does on the first steps of a street."""
    network, (_, streets) = file.network(), streets_with()
    with contextlib.closing(streets):
        observations, actions = streets.reset(), []
        for _ in range(30):
            actions.append(act(network, observations[0]))
            observations, *_ = streets.step(np.array([actions[-1:]], np.float32))
    return actions


def test_a_training_starts_from_a_policy(setup_file, tmp_path):
    setup = load_setup(setup_file)
    first = PolicyFile(train(setup, tmp_path / "first").policy)
    still = {"learning_rate": 1e-9, "last_learning_rate": 1e-9}
    learning = setup.learning.model_copy(update={**still, "value_steps": 32})
    changes = {"start": str(first.path), "learning": learning, "seed": 5}
    told = []
    second = PolicyFile(
        train(
            setup.model_copy(update=changes),
            tmp_path / "second",
            progress=lambda steps, text: told.append((steps, text)),
        ).policy
    )
    # It has learnt nothing, and begins with what the first had seen: it drives as that does.
    np.testing.assert_allclose(pedals(first), pedals(second), atol=1e-5)
    assert second.card().start_hash == file_hash(first.path)
    assert first.card().start_hash is None
    assert told[0] == (0, "building streets")
    assert told[32] == (0, "learning its value, 32 of 32 steps")
    assert told[33][0] == 1


def test_nothing_worse_comes_of_a_training_than_it_starts_from(setup_file, tmp_path):
    setup = load_setup(setup_file)
    first = PolicyFile(train(setup, tmp_path / "first").policy)
    # At this rate nothing is left of what it could do.
    spoilt = {"learning_rate": 10.0, "last_learning_rate": 10.0, "value_steps": 16}
    learning = setup.learning.model_copy(update=spoilt)
    trained = train(
        setup.model_copy(update={"start": str(first.path), "learning": learning}),
        tmp_path / "second",
    )
    before, after = trained.evaluations
    assert (before["steps"], after["steps"]) == (0, 64)
    assert (after["success"], after["return"]) < (before["success"], before["return"])
    policy = PolicyFile(trained.policy)
    assert policy.card().steps == 0
    assert policy.card().evaluation == {
        key: value for key, value in before.items() if key not in {"steps", "seconds"}
    }
    np.testing.assert_allclose(pedals(first), pedals(policy), atol=1e-5)


def test_the_value_of_a_policy_is_learnt_before_it_changes(setup_file, tmp_path):
    first = train(load_setup(setup_file), tmp_path / "first").policy
    learning = {"layers": [8], "rollout_steps": 512, "value_steps": 1024}
    content = yaml.safe_load(SMALL) | {"start": str(first), "learning": learning}
    setup = Setup.model_validate(content)
    streets = normalised(setup, make_streets(setup, setup.stages[0].cells, seed=3))
    with contextlib.closing(streets):
        untrained, model = untrained_model(setup, streets), new_model(setup, streets)
        load_policy(untrained, streets, PolicyFile(first), setup.frames)
        for one, other in zip(
            actor_of(untrained).parameters(), actor_of(model).parameters(), strict=True
        ):
            assert np.array_equal(one.detach(), other.detach())
            assert other.requires_grad
        assert model.num_timesteps == 0
        assert not model.policy.optimizer.state
        # How much better it is after so few steps is chance; that it has learnt is not.
        for one, other in zip(value_of(untrained), value_of(model), strict=True):
            assert not np.array_equal(one.detach(), other.detach())


def value_of(model):
    """Return the parameters of a model's value function."""
    return (
        *model.policy.mlp_extractor.value_net.parameters(),
        *model.policy.value_net.parameters(),
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"start": "nowhere.safetensors"}, "there is no policy file 'nowhere.safetensors'"),
        ({"start": "ttc_brake"}, r"can't start from 'ttc_brake' \(.*'trained', or a policy"),
        ({"start": "policy.zip"}, "can't start from 'policy.zip'"),
        ({"frames": 1}, r"with frames 2, and the setup has 1"),
        ({"observation": "vsr"}, "with observation state, and the setup has vsr"),
        ({"learning": {"layers": [9]}}, r"with layers \(8,\), and the setup has \(9,\)"),
    ],
)
def test_a_policy_that_does_not_fit_is_refused_before_anything_is_written(
    setup_file, tmp_path, change, message
):
    small = yaml.safe_load(SMALL) | {"frames": 2}
    first = train(Setup.model_validate(small), tmp_path / "first").policy
    content = small | {"start": str(first)} | change
    with pytest.raises(UsageError, match=message):
        train(Setup.model_validate(content), tmp_path / "second")
    assert not (tmp_path / "second").exists()


def test_the_progress_tells_how_the_last_episodes_ended(tmp_path):
    text = SMALL.replace("steps: 64", "steps: 640").replace(
        "rollout_steps: 16", "rollout_steps: 64"
    )
    told = {}
    setup = Setup.model_validate(yaml.safe_load(text) | {"evaluation_steps": 1000})
    trained = train(setup, tmp_path, progress=lambda steps, text: told.update({steps: text}))
    first = trained.episodes[0]
    assert told[first["steps"] - 1] == "low"
    assert told[first["steps"]] == f"low, {first['is_success']:.0%} of 1 succeed"


def test_the_policy_is_the_best_of_the_evaluations(setup_file, tmp_path, monkeypatch):
    found = iter([(0.5, 1.0), (0.9, 2.0), (0.9, 1.0), (0.1, 9.0)])

    def evaluate(model, setup):
        success, total = next(found)
        return {"success": success, "return": total}

    monkeypatch.setattr(training, "evaluate_policy", evaluate)
    setup = load_setup(setup_file).model_copy(update={"evaluation_steps": 16})
    trained = train(setup, tmp_path / "run")
    assert len(trained.evaluations) == 4
    card = PolicyFile(trained.policy).card()
    assert card.steps == trained.evaluations[1]["steps"] == 32
    assert Setup.model_validate(card.training) == setup
    assert card.knowledge_base == "crossing"


def test_every_street_drives_its_part_of_an_evaluation():
    class Streets:
        """Three streets; episodes of the first have one step, those of the others four."""

        num_envs, step_number = 3, 0

        def reset(self):
            return np.zeros((3, 1))

        def step(self, actions):
            self.step_number += 1
            dones = np.array([self.step_number % length == 0 for length in (1, 4, 4)])
            return np.zeros((3, 1)), None, dones, [{"street": n} for n in range(3)]

    infos = list(training._endings(Streets(), lambda observations: np.zeros((3, 1)), 7))
    assert sorted(info["street"] for info in infos) == [0, 0, 0, 1, 1, 2, 2]


def test_a_folder_belongs_to_one_setup(setup_file, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    other = json.loads(load_setup(setup_file).model_dump_json()) | {"seed": 7}
    (folder / "setup.json").write_text(json.dumps(other))
    with pytest.raises(UsageError, match="another setup"):
        train(load_setup(setup_file), folder)


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    """The folder of a training that has ended; tests copy it."""
    folder = tmp_path_factory.mktemp("ended")
    train(Setup.model_validate(yaml.safe_load(SMALL)), folder)
    return folder


@pytest.fixture
def run(ended, tmp_path):
    return Path(shutil.copytree(ended, tmp_path / "run"))


def content_of(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize(
    ("name", "damage", "message"),
    [
        ("setup.json", b"{", r"setup\.json' can't be read as a setup: Invalid JSON.*remove it"),
        ("setup.json", b"\xff", r"setup\.json' can't be read as a setup"),
        ("setup.json", b'{"version": 2}', r"setup\.json' can't be read as a setup: name: Field"),
        ("evaluations.jsonl", b"7\n", r"evaluations\.jsonl:1: this is no row.*remove the line"),
        ("episodes.jsonl", b"{}\n", r"episodes\.jsonl:1: this is no row.*remove the line"),
        ("policy.json", b"{}", r"policy\.json' is no card of a policy: interface: Field required"),
        (
            "policy.json",
            None,
            r"policy\.json: the card of a policy can't be read: No such file.*put it back",
        ),
        ("policy.safetensors", b"", r"policy\.safetensors' can't be read"),
        ("policy.safetensors", None, r"no policy file '.*', though '.*' has its evaluation"),
    ],
)
def test_a_damaged_file_is_named_and_nothing_is_lost(setup_file, run, name, damage, message):
    if damage is None:
        (run / name).unlink()
    else:
        (run / name).write_bytes(damage)
    before = content_of(run)
    command = ["train", "--setup", str(setup_file), "--output", str(run)]
    done = CliRunner().invoke(app, command)
    assert isinstance(done.exception, UsageError), done.exception
    assert re.search(message, str(done.exception)), done.exception
    assert content_of(run) == before


def test_a_policy_that_is_missing_is_written_anew_as_the_error_says(setup_file, run):
    for name in ("policy.safetensors", "evaluations.jsonl"):
        (run / name).unlink()
    trained = train(load_setup(setup_file), run)
    assert [row["steps"] for row in trained.evaluations] == [64]
    assert PolicyFile(trained.policy).network()


@pytest.mark.parametrize("has_ended", [True, False])
def test_a_training_does_not_go_on_when_its_rules_have_changed(
    setup_file, run, has_ended, monkeypatch
):
    if not has_ended:
        (run / "evaluations.jsonl").unlink()
    before = content_of(run)
    monkeypatch.setattr(KnowledgeBase, "hash", "other")
    with pytest.raises(SfolError, match=r"under other rules: 'crossing' has changed since"):
        train(load_setup(setup_file), run)
    assert content_of(run) == before


def test_two_trainings_do_not_share_a_folder(setup_file, run):
    before = content_of(run)
    with locked_folder(run), pytest.raises(SfolError, match="in use by process"):
        train(load_setup(setup_file), run)
    assert content_of(run) == before


def test_a_record_that_can_t_be_read_forgets_nothing(setup_file, run):
    """Without a checkpoint that can be read a training would begin anew, and its record with it."""
    for path in run.glob("checkpoint-*"):
        path.write_bytes(b"half a checkpoint")
    (run / "evaluations.jsonl").unlink()
    before = content_of(run)
    with pytest.raises(UsageError, match=r"no checkpoint in .* can be read \(put one back"):
        train(load_setup(setup_file), run)
    assert content_of(run) == before
