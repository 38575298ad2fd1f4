"""How long the networks take for a frame, in both arithmetics and for two sizes of batch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Literal, Protocol

import torch

from sfol.tools.bench import median
from vsr.networks.autoencoder import Autoencoder, FeatureEncoder
from vsr.networks.unet import UNetSegmenter, build_unet
from vsr.segmentation import Frame

_PRECISIONS: tuple[Literal["float32", "bfloat16"], ...] = ("float32", "bfloat16")
_BATCHES = (1, 8)


class _Network(Protocol):
    def __call__(self, frames: Sequence[Frame]) -> object: ...


def measure(frames: Sequence[Frame]) -> dict[str, float]:
    """Return the median time of the UNet and of the encoder, in ms a frame.

    Weights don't matter for speed, so they are random: nothing has to be trained first. The keys
    are such as ``unet_bfloat16_batch8_ms``. bfloat16 is measured everywhere; ``auto`` uses it only
    where the hardware computes in it.

    Args:
        frames: some to take batches from, at least one.
    """
    times = {}
    for precision in _PRECISIONS:
        torch.manual_seed(0)
        networks: Mapping[str, _Network] = {
            "unet": UNetSegmenter(build_unet(), precision),
            "encoder": FeatureEncoder(Autoencoder(), precision).encode,
        }
        for name, network in networks.items():
            for size in _BATCHES:
                batch = [frames[i % len(frames)] for i in range(size)]
                seconds = median(partial(network, batch))
                times[f"{name}_{precision}_batch{size}_ms"] = round(1e3 * seconds / size, 2)
    return times
