"""Policies that `aeb train` writes: they need no trust, and drive as what was trained."""

import errno
import json
from functools import partial

import numpy as np
import pytest
import torch
from gymnasium import spaces
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors.torch import load_file, save
from stable_baselines3.common.vec_env import DummyVecEnv

import sfol
from env.driving import policy_files
from env.driving.policies import TrainedDriver, file_hash, make_driver
from env.driving.policy_files import CLIP, Interface, PolicyCard, PolicyFile, act
from env.driving.setup import Setup
from env.evaluation.evaluate import Drive
from env.learning.curriculum import StreetsInTurn
from env.learning.new_model import (
    codebook_of,
    load_policy,
    normalised,
    policy_of,
    untrained_model,
)
from env.learning.vector_streets import make_streets
from env.perception.weights_folder import FOLDER_VARIABLE
from env.street.observation import NoObserver, StateObserver
from env.world.cells import Cell
from sfol.errors import SfolError
from tests.env.spaces import Spaces
from vsr.hypervectors.codebook import Codebook
from vsr.tensor_files import sha256

CELL = Cell("low", "partial")


def setup(**settings):
    stages = [{"steps": 1, "traffic": ["low"], "occlusion": ["partial"]}]
    chosen = {"version": 2, "name": "small", "stages": stages, "streets": 1, "seed": 3}
    return Setup.model_validate({**chosen, "learning": {"layers": [8, 4]}, **settings})


STATE = {"observation": "state", "perception": "truth", "frames": 3, "decision_steps": 2}


def write(path, model, chosen):
    interface = Interface.of(chosen)
    card = PolicyCard(
        interface=interface,
        training=chosen.model_dump(mode="json"),
        steps=1,
        knowledge_base="crossing",
        knowledge_base_hash="0",
        evaluation={},
        versions={},
    )
    PolicyFile(path).write(card, policy_of(model, interface), codebook_of(chosen))
    return path


def untrained(size, chosen):
    """Return a model that has seen observations of so many numbers, and nothing else."""
    space = spaces.Box(-np.inf, np.inf, (size,), np.float32)
    streets = normalised(chosen, DummyVecEnv([partial(Spaces, space)]))
    seen = np.random.default_rng(0).normal(3.0, 2.0, (50, size))
    streets.obs_rms.update(seen)  # in vain, where observations are scaled as a whole
    return untrained_model(chosen, streets)


@pytest.fixture(scope="module")
def streets():
    streets = make_streets(setup(**STATE), [CELL], seed=0)
    yield streets
    streets.close()


@pytest.fixture(scope="module")
def model(streets):
    chosen = setup(**STATE)
    seen = normalised(chosen, streets)
    model = untrained_model(chosen, seen)
    seen.reset()
    for pedal in np.linspace(-1.0, 1.0, 20):
        seen.step(np.array([[pedal]], np.float32))
    return model


@pytest.fixture
def policy(tmp_path, model):
    return write(tmp_path / "small.safetensors", model, setup(**STATE))


@pytest.mark.parametrize("norm_obs", [True, False])
def test_what_observations_were_normalised_by_is_part_of_the_policy(tmp_path, norm_obs):
    chosen = setup(observation="state", learning={"layers": [8, 4], "norm_obs": norm_obs})
    model = untrained(5, chosen)
    network = PolicyFile(write(tmp_path / "small.safetensors", model, chosen)).network()
    for factor in (1.0, 100.0):  # more than CLIP deviations are cut
        seen = factor * np.linspace(-4.0, 4.0, 5, dtype=np.float32)
        normal = model.get_vec_normalize_env().normalize_obs(seen)
        assert (np.abs(normal).max() == CLIP) == (factor > 1.0)
        if not norm_obs:
            np.testing.assert_allclose(normal, np.clip(0.1 * seen, -CLIP, CLIP), atol=1e-5)
        expected, _ = model.predict(normal, deterministic=True)
        assert act(network, seen) == pytest.approx(expected.item(), abs=1e-6)


@pytest.mark.parametrize("norm_obs", [True, False])
@pytest.mark.parametrize(("frames", "extra"), [(3, 0), (3, 1), (1, 1)])
def test_what_a_policy_was_not_given_has_no_weight_when_another_starts_from_it(
    tmp_path, frames, extra, norm_obs
):
    """As if ego's speed, or earlier frames, were added to what it drives by."""
    width, learning = 5, {"layers": [8, 4], "norm_obs": norm_obs}
    first = setup(learning=learning)
    file = PolicyFile(write(tmp_path / "first.safetensors", untrained(width, first), first))
    later = setup(frames=frames, learning=learning)
    second = untrained(frames * (width + extra), later)
    streets = second.get_vec_normalize_env()
    load_policy(second, streets, file, frames)
    seen = np.random.default_rng(0).normal(size=(frames, width + extra)).astype(np.float32)
    action, _ = second.predict(streets.normalize_obs(seen.ravel()), deterministic=True)
    expected = act(file.network(), seen[-1, :width])
    assert action.item() == pytest.approx(expected, abs=1e-6)


def test_it_drives_as_the_model_from_its_file_alone(policy, model, streets):
    driver = make_driver(str(policy))  # outside the project's folder, and nobody trusts it
    turn = StreetsInTurn((CELL,), StateObserver(), perception="truth")
    normalise = model.get_vec_normalize_env().normalize_obs
    for seed in (5, 6):  # a second episode knows nothing of the first
        streets.seed(seed)
        seen = streets.reset()
        turn.reset(seed=seed)
        driver.reset()
        for _ in range(6):
            expected, _ = model.predict(normalise(seen), deterministic=True)
            for _ in range(STATE["decision_steps"]):  # it holds its action itself
                pedal = driver(turn.street)
                assert pedal == pytest.approx(expected.item(), abs=1e-6)
                turn.step(np.array([pedal], np.float32))
            seen, *_ = streets.step(expected)
    turn.close()


def test_it_observes_what_it_was_trained_on(tmp_path):
    chosen = setup(observation="vsr", perception="simulator", fusion="ssi", speed=True, frames=2)
    trained_on = make_streets(chosen, [CELL], seed=0)
    path = write(tmp_path / "vsr.safetensors", untrained(2 * 2049, chosen), chosen)
    driver = TrainedDriver(path)
    kb = sfol.KnowledgeBase.load("crossing")
    turn = StreetsInTurn((CELL,), NoObserver(), decision_steps=4, rules=kb, perception="simulator")
    try:
        trained_on.seed(7)
        expected = trained_on.reset()
        turn.reset(seed=7)
        for pedal in (1.0, 1.0, -0.5, 0.3):
            np.testing.assert_allclose(driver.observe(turn.street), expected[0], atol=1e-5)
            expected, *_ = trained_on.step(np.array([[pedal]], np.float32))
            turn.step(np.array([pedal], np.float32))
        assert np.abs(expected[0]).max() > 0.1
    finally:
        trained_on.close()
        turn.close()


def test_the_policy_beside_the_networks_weights_has_a_name(tmp_path, model, monkeypatch):
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path))
    file = write(tmp_path / "policy.safetensors", model, setup(**STATE))
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
        (lambda path: path.with_suffix(".json").unlink(), "card of a policy"),
        (lambda path: path.with_suffix(".json").write_text("{}"), "card of a policy"),
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
    content["interface"]["layers"] = [64, 64]
    card.write_text(json.dumps(content))


@pytest.fixture
def vsr_policy(tmp_path):
    chosen = setup(observation="vsr", fusion="ssi")
    return write(tmp_path / "vsr.safetensors", untrained(2048, chosen), chosen)


def test_the_codebook_is_part_of_a_policy(vsr_policy):
    make_driver(str(vsr_policy))
    codebook = vsr_policy.with_suffix(".codebook.safetensors")
    Codebook(seed=1).save(codebook)
    with pytest.raises(SfolError, match="is not the file that"):
        make_driver(str(vsr_policy))
    codebook.unlink()
    with pytest.raises(SfolError, match="codebook"):
        make_driver(str(vsr_policy))


# -- a file is not believed -----------------------------------------------------------------------


def rewrite(path, **tensors):
    """Change tensors of a policy, and let its card say that this is its file."""
    path.write_bytes(save(load_file(path) | tensors))
    change_card(path, sha256=sha256(path.read_bytes()))


def change_card(path, **changes):
    card = path.with_suffix(".json")
    card.write_text(json.dumps(json.loads(card.read_text()) | changes))


WIDE = torch.ones(8, 3 * 45 + 1)


@pytest.mark.parametrize(
    "tensors",
    [
        {"0.weight": WIDE},
        {"0.weight": torch.ones(8, 3 * 45, dtype=torch.int8)},
        {"0.weight": torch.ones(8, 3 * 45, dtype=torch.complex64)},
        {"0.weight": torch.full((8, 3 * 45), torch.nan)},
        {"2.bias": torch.tensor([0.0, 1.0, torch.inf, 0.0])},
        {"4.weight": torch.ones(2, 4)},
        {"6.weight": torch.ones(1, 1)},
        {"0.weight": torch.ones(8 * 3 * 45)},
    ],
    ids=str,
)
def test_tensors_that_are_not_what_the_card_says_are_refused_before_anybody_drives(policy, tensors):
    rewrite(policy, **tensors)
    with pytest.raises(SfolError, match=r"holds no policy|aren't finite"):
        make_driver(str(policy))


@pytest.mark.parametrize("frames", [1, 2, 4])
def test_a_first_layer_of_another_width_is_refused(policy, frames):
    content = json.loads(policy.with_suffix(".json").read_text())
    change_card(policy, interface=content["interface"] | {"frames": frames})
    with pytest.raises(SfolError, match=r"is F32 of shape \(135,\), not"):
        make_driver(str(policy))


@pytest.mark.parametrize("layers", [[4096, 4096], [4096] * 8, [10**9], [10**30], [8] * 9, []])
def test_a_card_that_claims_large_layers_costs_no_memory(policy, layers, monkeypatch):
    def real_memory(*sizes):
        pytest.fail("a network was built")

    content = json.loads(policy.with_suffix(".json").read_text())
    change_card(policy, interface=content["interface"] | {"layers": layers})
    monkeypatch.setattr(policy_files.tensor_files, "load_finite", real_memory)
    with pytest.raises(SfolError, match=r"holds no policy|no card of a policy"):
        make_driver(str(policy))


def test_weights_of_another_training_under_a_card_are_refused(policy, model):
    old = policy.read_bytes()
    with torch.no_grad():
        model.policy.action_net.bias += 1.0
    write(policy, model, setup(**STATE))
    policy.write_bytes(old)
    with pytest.raises(SfolError, match=r"is not the file that .* train again"):
        make_driver(str(policy))


def test_a_card_that_names_no_file_is_refused(policy):
    change_card(policy, sha256=None)
    with pytest.raises(SfolError, match="does not say which file"):
        make_driver(str(policy))


def test_a_full_disk_leaves_the_policy_that_was_there(vsr_policy, model, monkeypatch):
    before = {path.name: path.read_bytes() for path in vsr_policy.parent.iterdir()}

    def full(path, content):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(type(vsr_policy), "write_bytes", full)
    with pytest.raises(SfolError, match="No space left"):
        write(vsr_policy, model, setup(observation="vsr", fusion="ssi"))
    assert {path.name: path.read_bytes() for path in vsr_policy.parent.iterdir()} == before


JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.sampled_from(["", "state", "vsr", "../../x", "0" * 64]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
)


def leaves(value, place=()):
    yield place
    if isinstance(value, dict | list):
        entries = value.items() if isinstance(value, dict) else enumerate(value)
        for key, entry in entries:
            yield from leaves(entry, (*place, key))


@given(data=st.data(), new=JSON)
@settings(
    deadline=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_whatever_a_card_says_it_drives_or_is_refused(policy, data, new):
    card = policy.with_suffix(".json")
    before = card.read_text()
    content = {"card": json.loads(before)}
    *path, last = data.draw(st.sampled_from([p for p in leaves(content) if p]))
    spot = content
    for key in path:
        spot = spot[key]
    spot[last] = new
    card.write_text(json.dumps(content["card"]))
    try:
        driver = make_driver(str(policy))
    except SfolError as error:
        assert str(policy.with_suffix("")) in str(error)  # noqa: PT017
    else:
        assert isinstance(driver, TrainedDriver)
    finally:
        card.write_text(before)
