"""A network is run by name; what is rounded to eight bits says nearly what it said before."""

import os
import sys
import threading

import numpy as np
import pytest
import torch
from torch import nn

from sfol.errors import MissingExtraError, UsageError
from vsr.networks.autoencoder import Autoencoder, FeatureEncoder
from vsr.networks.inference import Runner, to_input
from vsr.networks.quantisation import RoundedConvolution, quantised
from vsr.networks.runtime import Runtime, runtime_of
from vsr.networks.unet import UNetSegmenter, build_unet
from vsr.segmentation import Frame

CPU = torch.device("cpu")


def picture(seed: int, shape: tuple[int, int] = (64, 96)) -> Frame:
    gray = np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)
    return Frame(gray, np.zeros(shape, np.uint8), np.zeros(shape, np.int32))


def lived(network: nn.Module) -> nn.Module:
    """Give a network's normalisations the statistics of what goes through it."""
    gray = np.random.default_rng(0).integers(0, 256, (16, 64, 96), dtype=np.uint8)
    with torch.no_grad():
        for _ in range(40):
            network.train()(to_input(torch.from_numpy(gray)))
    return network.eval()


@pytest.fixture(scope="module", params=["encoder", "unet"])
def network(request) -> nn.Module:
    torch.manual_seed(0)
    return lived(Autoencoder().encoder if request.param == "encoder" else build_unet())


def test_a_network_of_eight_bits_is_close_to_its_own(network):
    inputs = to_input(torch.from_numpy(picture(1).gray[None]))
    with torch.inference_mode():
        own, rounded = network(inputs), quantised(network)(inputs)
    assert not torch.equal(own, rounded)
    assert torch.cosine_similarity(own.flatten(), rounded.flatten(), dim=0) > 0.99


def test_every_convolution_takes_and_has_numbers_of_eight_bits(network):
    rounded = quantised(network)
    seen = []

    def look(module, inputs, output):
        weight = module.convolution.weight / module.steps.reshape(-1, 1, 1, 1)
        seen.append((len(torch.unique(inputs[0])), weight.abs().max().item()))

    convolutions = [m for m in rounded.modules() if isinstance(m, RoundedConvolution)]
    for convolution in convolutions:
        convolution.register_forward_hook(look)
    rounded(to_input(torch.from_numpy(picture(2).gray[None])))
    # What is joined for the decoder comes of two roundings.
    assert all(levels <= 2 * 256 and largest <= 127.01 for levels, largest in seen)
    assert (
        len(seen) == len(convolutions) == sum(isinstance(m, nn.Conv2d) for m in network.modules())
    )


def test_the_network_itself_is_not_changed(network):
    before = {name: value.clone() for name, value in network.state_dict().items()}
    quantised(network)
    after = network.state_dict()
    assert before.keys() == after.keys()
    assert all(torch.equal(value, after[name]) for name, value in before.items())


def test_without_a_normalisation_nothing_is_known_of_an_activation():
    with pytest.raises(UsageError, match="nothing is known"):
        quantised(nn.Sequential(nn.Conv2d(1, 2, 3), nn.ReLU()))


def test_torch_runs_as_ever():
    torch.manual_seed(0)
    encoder = Autoencoder().encoder
    run: Runtime = runtime_of(encoder, precision="float32", device=CPU)
    assert torch.equal(run([picture(3)]), Runner(encoder, "float32", CPU)([picture(3)]))


def test_a_runtime_that_is_none_is_an_error():
    with pytest.raises(UsageError, match=r"no runtime 'openvin'.*openvino"):
        runtime_of(nn.ReLU(), "openvin")


@pytest.mark.parametrize(
    "chosen", [{"precision": "float32"}, {"device": torch.device("cuda")}], ids=str
)
def test_openvino_has_one_arithmetic_and_one_place(chosen):
    with pytest.raises(UsageError, match="eight bits"):
        FeatureEncoder(Autoencoder(), runtime="openvino", **chosen)


def test_without_openvino_the_error_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "openvino", None)
    monkeypatch.delitem(sys.modules, "vsr.networks.openvino_runtime", raising=False)
    with pytest.raises(MissingExtraError, match=r"'\.\[openvino\]' in the checkout"):
        runtime_of(Autoencoder().encoder, "openvino")


def test_openvino_computes_what_the_rounded_network_computes(network):
    pytest.importorskip("openvino")
    run, rounded = runtime_of(network, "openvino"), quantised(network)
    for shape in ((64, 96), (96, 32)):
        frames = [picture(seed, shape) for seed in range(3)]
        found = run(frames)
        with torch.inference_mode():
            sought = rounded(to_input(torch.from_numpy(np.stack([f.gray for f in frames]))))
        # Sums that end close to the middle between two steps may be rounded either way.
        assert torch.cosine_similarity(found.flatten(1), sought.flatten(1)).min() > 0.98
        assert torch.equal(found[1], run(frames[1:2])[0])


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="Linux tells it")
def test_openvino_binds_no_thread_to_a_processor():
    """Bound while they compute, threads of two processes took turns on one and left another idle."""
    pytest.importorskip("openvino")
    threads, computing = torch.get_num_threads(), threading.get_native_id()
    torch.set_num_threads(1)
    try:
        run = runtime_of(lived(Autoencoder().encoder), "openvino")
        run([picture(6, (224, 224))])
        seen, done = [os.sched_getaffinity(computing)], threading.Event()

        def look() -> None:
            while not done.is_set():
                seen.append(os.sched_getaffinity(computing))

        looker = threading.Thread(target=look, daemon=True)
        looker.start()
        for _ in range(20):
            run([picture(6, (224, 224))])
        done.set()
        looker.join()
    finally:
        torch.set_num_threads(threads)
    assert len(seen) > 20
    assert all(processors == seen[0] for processors in seen)


def test_openvino_segments_and_refuses_what_is_no_batch():
    pytest.importorskip("openvino")
    segmenter = UNetSegmenter(lived(build_unet()), runtime="openvino")
    probabilities = segmenter([picture(4)])
    assert probabilities.shape == (1, 28, 64, 96)
    assert np.allclose(probabilities.sum(axis=1), 1.0, atol=1e-5)
    with pytest.raises(UsageError, match="at least one frame"):
        segmenter([])
    with pytest.raises(UsageError, match="multiples of 32"):
        segmenter([picture(5, (60, 96))])
