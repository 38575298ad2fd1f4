import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest
import torch

import sfol.tools.bench
from sfol.errors import UsageError
from vsr.classes import CLASS_COUNT
from vsr.entities import class_map
from vsr.networks import inference
from vsr.networks.inference import arithmetic, to_gray, to_input
from vsr.networks.network_speed import measure
from vsr.networks.unet import UNetSegmenter, build_unet
from vsr.segmentation import Frame, Segmenter, SimulatorSegmenter


def frame(classes: np.ndarray) -> Frame:
    return Frame(
        gray=np.zeros(classes.shape, np.uint8),
        classes=classes,
        instances=np.full(classes.shape, -1, np.int32),
    )


def test_the_simulators_map_is_its_own():
    rng = np.random.default_rng(0)
    maps = rng.integers(0, CLASS_COUNT, (3, 8, 16), dtype=np.uint8)
    segmenter: Segmenter = SimulatorSegmenter()
    segmented = segmenter([frame(classes) for classes in maps])
    assert segmented.dtype == np.uint8
    assert np.array_equal(segmented, maps)
    assert not np.shares_memory(segmented, maps)  # a renderer may draw over its own


def test_no_frames_are_an_error():
    with pytest.raises(UsageError, match="at least one frame"):
        SimulatorSegmenter()([])


@pytest.mark.parametrize("module", ["vsr", "vsr.grounding", "vsr.classes", "vsr.segmentation"])
def test_light_modules_load_neither_torch_nor_scipy(module):
    code = f"import sys, {module}; assert not {{'torch', 'scipy'}} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.fixture(scope="module")
def unet() -> UNetSegmenter:
    torch.manual_seed(0)
    return UNetSegmenter(build_unet(), "float32")


def pictures(count: int, shape: tuple[int, int] = (64, 96)) -> list[Frame]:
    rng = np.random.default_rng(1)
    blank = np.zeros(shape, np.uint8)
    return [
        Frame(rng.integers(0, 256, shape, dtype=np.uint8), blank, blank.astype(np.int32))
        for _ in range(count)
    ]


def test_the_unet_gives_probabilities_of_all_classes(unet):
    segmenter: Segmenter = unet
    probabilities = segmenter(pictures(2))
    assert probabilities.shape == (2, CLASS_COUNT, 64, 96)
    assert probabilities.dtype == np.float32
    assert probabilities.min() >= 0.0
    assert np.allclose(probabilities.sum(axis=1), 1.0, atol=1e-5)
    assert class_map(probabilities[0]).shape == (64, 96)


def test_the_unet_segments_a_frame_alike_alone_and_in_a_batch(unet):
    frames = pictures(3)
    together = unet(frames)
    assert np.allclose(together[1], unet(frames[1:2])[0], atol=1e-5)
    assert not np.allclose(together[0], together[1], atol=1e-3)


def test_the_unet_segments_alike_in_both_arithmetics(unet):
    torch.manual_seed(0)
    reduced = UNetSegmenter(build_unet(), "bfloat16")
    frames = pictures(2)
    assert np.abs(reduced(frames) - unet(frames)).mean() < 0.01


def test_the_unet_says_which_frames_it_takes(unet):
    with pytest.raises(UsageError, match="at least one frame"):
        unet([])
    with pytest.raises(UsageError, match="100×64 px do not fit"):
        unet(pictures(1, (64, 100)))


def test_half_precision_is_used_only_where_the_hardware_computes_in_it(monkeypatch):
    cpu = torch.device("cpu")
    monkeypatch.setattr(inference, "_computes_in_bfloat16", lambda device: True)
    assert arithmetic("auto", cpu) is torch.bfloat16
    assert arithmetic("float32", cpu) is torch.float32
    monkeypatch.setattr(inference, "_computes_in_bfloat16", lambda device: False)
    assert arithmetic("auto", cpu) is torch.float32
    assert arithmetic("bfloat16", cpu) is torch.bfloat16


def test_grey_values_survive_the_way_into_a_network_and_back():
    gray = torch.arange(256, dtype=torch.uint8).reshape(1, 16, 16)
    assert torch.equal(to_gray(to_input(gray)), gray)


def test_every_network_is_timed_in_every_arithmetic(monkeypatch):
    monkeypatch.setattr(sfol.tools.bench, "_SECONDS", 0.0)
    times = measure(pictures(1, (32, 32)))
    assert set(times) == {
        f"{network}_{precision}_batch{size}_ms"
        for network in ("unet", "encoder")
        for precision in ("float32", "bfloat16", *(["openvino"] if find_spec("openvino") else []))
        for size in (1, 8)
    }
    assert all(value > 0 for value in times.values())
