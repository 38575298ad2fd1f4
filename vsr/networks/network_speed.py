"""How long the networks take for a frame, by runtime and arithmetic, for two sizes of batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from typing import Protocol

import torch

from sfol.tools.bench import median
from vsr.networks.autoencoder import Autoencoder, FeatureEncoder
from vsr.networks.inference import Precision
from vsr.networks.runtime import RuntimeName
from vsr.networks.unet import UNetSegmenter, build_unet
from vsr.segmentation import Frame

_WAYS: Mapping[str, tuple[RuntimeName, Precision]] = {
    "float32": ("torch", "float32"),
    "bfloat16": ("torch", "bfloat16"),
    "openvino": ("openvino", "auto"),
}
_BATCHES = (1, 8)


class _Network(Protocol):
    def __call__(self, frames: Sequence[Frame]) -> object: ...


def measure(frames: Sequence[Frame]) -> dict[str, float]:
    """Return the median time of the UNet and of the encoder, in ms a frame.

    Weights don't matter for speed, so they are random: nothing has to be trained first. The keys
    are such as ``unet_bfloat16_batch8_ms``. bfloat16 is measured everywhere; ``auto`` uses it only
    where the hardware computes in it. ``openvino`` is measured where it is installed.

    Args:
        frames: some to take batches from, at least one.
    """
    times = {}
    for way, (runtime, precision) in _WAYS.items():
        if runtime == "openvino" and find_spec("openvino") is None:
            continue
        torch.manual_seed(0)
        networks: Mapping[str, _Network] = {
            "unet": UNetSegmenter(build_unet(), precision, runtime=runtime),
            "encoder": FeatureEncoder(Autoencoder(), precision, runtime=runtime).encode,
        }
        for name, network in networks.items():
            for size in _BATCHES:
                batch = [frames[i % len(frames)] for i in range(size)]
                seconds = median(partial(network, batch))
                times[f"{name}_{way}_batch{size}_ms"] = round(1e3 * seconds / size, 2)
    return times
