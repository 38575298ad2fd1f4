import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
import torch

from env.perception.networks import load_autoencoder, load_segmenter
from env.perception.weights_folder import FOLDER_VARIABLE, weights_folder
from env.street.seeds import FRAMES
from env.tools.frames import frames_of_street
from sfol.errors import UsageError
from vsr.entities import class_map, find_entities
from vsr.grounding import Camera
from vsr.hypervectors.codebook import Codebook
from vsr.hypervectors.descriptor import SceneDescriptor
from vsr.networks.autoencoder import Autoencoder
from vsr.networks.inference import stack_gray, to_input
from vsr.networks.quantisation import quantised
from vsr.networks.weights import load_weights, read_card
from vsr.training.segmentation_quality import count, iou_table, total

NETWORKS = {"segmenter": load_segmenter, "autoencoder": load_autoencoder}


@pytest.fixture(scope="module")
def held_out(street_of):
    """Frames of a busy street that no network was trained on."""
    street = street_of("high", "full")
    return [frame for _, frame in frames_of_street(street, FRAMES["test"].start + 900_000, 8)]


def test_the_shipped_segmenter_knows_the_street(street_of, held_out):
    grounding = street_of("high", "full").pipeline.grounding
    segmenter = load_segmenter(camera=grounding.camera)
    iou = iou_table(total(count(segmenter, held_out, grounding)))
    seen = [row["0-45 m"] for row in iou.values() if not np.isnan(row["0-45 m"])]
    assert np.mean(seen) >= 0.8
    assert iou["road"]["all"] >= 0.95


def test_the_shipped_encoder_tells_frames_apart(street_of, held_out):
    features = load_autoencoder(camera=street_of("high", "full").pipeline.grounding.camera)
    maps = features.encode([held_out[0], held_out[-1]])
    assert maps.shape == (2, 512, 7, 7)
    assert (maps[0] - maps[1]).abs().mean() > 0.1 * maps.abs().mean()


def spatial_features(encoder, frames, grounding):
    descriptor = SceneDescriptor(Codebook(), grounding, fusion="sf")
    found = [find_entities(frame.classes, grounding.minimum_area) for frame in frames]
    layouts = [
        descriptor.layout(entities, frame.classes)
        for entities, frame in zip(found, frames, strict=True)
    ]
    return descriptor.entities(layouts, encoder.encode(frames))


class _Rounded:
    """The shipped encoder as OpenVINO computes it, by torch."""

    def __init__(self):
        autoencoder = Autoencoder()
        load_weights(weights_folder() / "autoencoder.safetensors", autoencoder)
        self._encoder = quantised(autoencoder.encoder)

    def encode(self, frames):
        with torch.inference_mode():
            return self._encoder(to_input(stack_gray(frames)))


def _by_openvino():
    pytest.importorskip("openvino")
    return load_autoencoder(runtime="openvino")


@pytest.mark.parametrize("encoder", [_Rounded, _by_openvino])
def test_eight_bits_keep_what_an_entity_looks_like(street_of, held_out, encoder):
    grounding = street_of("high", "full").pipeline.grounding
    own = spatial_features(load_autoencoder(precision="float32"), held_out, grounding)
    rounded = spatial_features(encoder(), held_out, grounding)
    assert len(own) >= 20
    assert torch.cosine_similarity(own, rounded).min() >= 0.999


def test_eight_bits_keep_the_classes(street_of, held_out):
    pytest.importorskip("openvino")
    own, rounded = (
        [class_map(probabilities) for probabilities in segmenter(held_out)]
        for segmenter in (load_segmenter(precision="float32"), load_segmenter(runtime="openvino"))
    )
    assert np.mean(np.equal(own, rounded)) >= 0.998


@pytest.mark.parametrize("network", NETWORKS)
def test_the_shipped_card_says_what_the_weights_are(network):
    card = read_card(weights_folder() / f"{network}.safetensors")
    assert card.network == network
    assert card.trained_on.train["seeds"][0] >= FRAMES["train"].start
    assert card.trained_on.train["seeds"][1] < FRAMES["validation"].start
    assert card.trained_on.validation["seeds"][1] < FRAMES["test"].start


def test_the_shipped_weights_are_small():
    sizes = {file.stem: file.stat().st_size for file in weights_folder().glob("*.safetensors")}
    policies = ("policy", "beyond")
    assert sizes.keys() == {*NETWORKS, *policies, *(f"{policy}.codebook" for policy in policies)}
    assert sum(sizes.values()) <= 60e6


@pytest.fixture
def copied(tmp_path):
    """A folder with the shipped weights, whose cards may be changed."""
    for file in weights_folder().iterdir():
        shutil.copy(file, tmp_path)
    return tmp_path


def change_card(card_file, **changes):
    card = json.loads(card_file.read_text())
    card["trained_on"].update(changes)
    card_file.write_text(json.dumps(card))


@pytest.mark.parametrize("network", NETWORKS)
def test_weights_are_found_where_the_environment_or_an_argument_says(network, copied, monkeypatch):
    load = NETWORKS[network]
    load(copied)
    monkeypatch.setenv(FOLDER_VARIABLE, str(copied))
    load()
    monkeypatch.setenv(FOLDER_VARIABLE, str(copied / "nothing"))
    with pytest.raises(UsageError, match=rf"no weights .*aeb networks {network}"):
        load()


@pytest.mark.parametrize("network", NETWORKS)
def test_weights_for_frames_of_another_renderer_are_refused(network, copied):
    change_card(copied / f"{network}.json", renderer="another one")
    with pytest.raises(UsageError, match="knows frames of another one, not of street rasteriser"):
        NETWORKS[network](copied)


@pytest.mark.parametrize("network", NETWORKS)
def test_weights_for_another_lens_are_refused(network):
    with pytest.raises(UsageError, match="a camera with fov 50, not 90"):
        NETWORKS[network](camera=Camera(fov=90.0))


@pytest.mark.parametrize("network", NETWORKS)
def test_a_card_without_a_lens_is_refused(network, copied):
    change_card(copied / f"{network}.json", camera={"size": 224.0})
    with pytest.raises(UsageError, match="a camera with fov of its own, not 50"):
        NETWORKS[network](copied, camera=Camera(fov=50.0))


@pytest.mark.parametrize("network", NETWORKS)
def test_the_shipped_cards_are_those_of_their_weights(network, copied):
    other = next(name for name in NETWORKS if name != network)
    shutil.copy(copied / f"{other}.safetensors", copied / f"{network}.safetensors")
    with pytest.raises(UsageError, match="is not the file that"):
        NETWORKS[network](copied)


def test_without_the_extra_one_line_says_what_to_install():
    code = (
        "import sys; sys.modules['segmentation_models_pytorch'] = None\n"
        "from sfol.errors import MissingExtraError\n"
        "try: import env.perception.networks\n"
        "except MissingExtraError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "segmentation_models_pytorch" in done.stdout
    assert "pip install --editable '.[aeb]' in the checkout" in done.stdout
