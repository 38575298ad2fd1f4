import json
from hashlib import sha256

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from sfol.errors import UsageError
from vsr.networks.weights import Card, TrainedOn, halved, load_weights, read_card, save_weights

CARD = Card(
    network="segmenter",
    architecture="two layers",
    weights="float16",
    trained_on=TrainedOn(
        renderer="a renderer",
        camera={"size": 224, "fov": 50.0, "height": 1.5},
        train={"seeds": [0, 9]},
        validation={"seeds": [10, 19]},
    ),
    schedule={"seed": 0},
    metrics={"score": 0.5},
    command="python -m vsr.training segmenter",
    versions={"torch": "2"},
)


def network(width: int = 4) -> nn.Module:
    torch.manual_seed(width)
    return nn.Sequential(nn.Conv2d(1, width, 3), nn.BatchNorm2d(width))


def test_weights_and_card_come_back_as_they_were(tmp_path):
    saved = network()
    file = save_weights(tmp_path / "new" / "folder", CARD, saved.state_dict())
    loaded = network()
    for tensor in loaded.state_dict().values():
        tensor.zero_()
    card = load_weights(file, loaded)
    assert card == CARD.model_copy(update={"sha256": sha256(file.read_bytes()).hexdigest()})
    assert file.name == "segmenter.safetensors"
    for name, tensor in saved.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], tensor), name


def test_halved_weights_are_loaded_as_float32_and_differ_by_rounding_alone(tmp_path):
    saved, loaded = network(), network(4)
    file = save_weights(tmp_path, CARD, halved(saved.state_dict()))
    load_weights(file, loaded)
    assert loaded[0].weight.dtype == torch.float32
    assert torch.allclose(loaded[0].weight, saved[0].weight, rtol=1e-3, atol=1e-7)


def test_what_float16_cannot_hold_stays_as_it_is():
    state = {"large": torch.tensor([1e6]), "small": torch.tensor([1.0]), "count": torch.tensor(3)}
    kinds = {name: tensor.dtype for name, tensor in halved(state).items()}
    assert kinds == {"large": torch.float32, "small": torch.float16, "count": torch.int64}


def test_a_damaged_file_is_an_error_that_names_it(tmp_path):
    file = save_weights(tmp_path, CARD, network().state_dict())
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(UsageError, match=r"segmenter\.safetensors' can't be read"):
        load_weights(file, network())


def test_weights_of_another_network_are_an_error_that_says_what_they_are(tmp_path):
    file = save_weights(tmp_path, CARD, network(4).state_dict())
    with pytest.raises(UsageError, match=r"another network.*two layers"):
        load_weights(file, network(8))


def test_weights_without_a_card_are_an_error(tmp_path):
    file = save_weights(tmp_path, CARD, network().state_dict())
    file.with_suffix(".json").unlink()
    with pytest.raises(UsageError, match="card of weights can't be read"):
        load_weights(file, network())


def test_an_incomplete_card_is_an_error_that_names_what_is_missing(tmp_path):
    file = save_weights(tmp_path, CARD, network().state_dict())
    content = json.loads(file.with_suffix(".json").read_text())
    del content["trained_on"]["renderer"]
    file.with_suffix(".json").write_text(json.dumps(content))
    with pytest.raises(UsageError, match=r"trained_on\.renderer"):
        read_card(file)


def test_older_weights_under_a_newer_card_are_refused(tmp_path):
    old = save_weights(tmp_path, CARD, network().state_dict()).read_bytes()
    file = save_weights(tmp_path, CARD, halved(network().state_dict()))
    file.write_bytes(old)
    with pytest.raises(UsageError, match=r"is not the file that .* train again"):
        load_weights(file, network())


@given(
    name=st.sampled_from(sorted(network().state_dict())),
    change=st.sampled_from(
        [
            lambda tensor: tensor.to(torch.int8),
            lambda tensor: tensor.to(torch.complex64),
            lambda tensor: tensor.to(torch.float64),
            lambda tensor: tensor[None],
            lambda tensor: tensor.reshape(-1)[:0],
            lambda tensor: torch.full_like(tensor.float(), torch.nan),
            lambda tensor: torch.full_like(tensor.float(), torch.inf),
        ]
    ),
)
@settings(deadline=None)
def test_a_tensor_that_is_not_what_the_network_has_is_refused(tmp_path_factory, name, change):
    """As a file whose card names it; so nothing but the tensors themselves can tell."""
    state = network().state_dict()
    file = save_weights(tmp_path_factory.mktemp("file"), CARD, state | {name: change(state[name])})
    loaded = network()
    with pytest.raises(UsageError, match=r"another network|aren't finite"):
        load_weights(file, loaded)
    for key, tensor in loaded.state_dict().items():
        assert torch.equal(tensor, state[key]), key


@pytest.mark.parametrize("names", [{"more": torch.ones(1)}, {}])
def test_more_or_fewer_tensors_are_another_network_s(tmp_path, names):
    state = dict(list(network().state_dict().items())[: None if names else -1]) | names
    file = save_weights(tmp_path, CARD, state)
    with pytest.raises(UsageError, match=r"it has (a|no) tensor"):
        load_weights(file, network())


def test_a_card_names_one_of_the_two_networks():
    with pytest.raises(ValueError, match="segmenter"):
        Card.model_validate(CARD.model_dump() | {"network": "../../segmenter"})
