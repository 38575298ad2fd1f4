"""What runs a trained network: one face for all, chosen by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, Protocol, get_args

import torch
from torch import Tensor, nn

from sfol.errors import UsageError, did_you_mean
from vsr.networks.inference import Precision, Runner, default_device
from vsr.segmentation import Frame

RuntimeName = Literal["torch", "openvino"]


class Runtime(Protocol):
    """A network that is run, never trained."""

    def __call__(self, frames: Sequence[Frame]) -> Tensor:
        """Return the network's output for a batch of frames.

        Raises:
            UsageError: there are no frames, they differ in size, or their sides are no multiples
                of 32.
        """
        ...


def runtime_of(
    network: nn.Module,
    runtime: RuntimeName = "torch",
    precision: Precision = "auto",
    device: torch.device | None = None,
) -> Runtime:
    """Return what runs a network.

    Args:
        network: takes float (B, 1, H, W) from -1 to 1. It is taken over and can't be trained
            further.
        runtime: ``torch``, on any device, the reference; or ``openvino``, on the processor, where
            convolutions compute with whole numbers of eight bits.
        precision: arithmetic of torch; ``auto`` takes the fastest that the hardware has.
        device: where torch computes; the GPU where there is one.

    Raises:
        UsageError: there is no such runtime, or a precision or a device was chosen for OpenVINO.
        MissingExtraError: OpenVINO is not installed.
    """
    if runtime not in get_args(RuntimeName):
        raise UsageError(
            f"there is no runtime '{runtime}'",
            name=runtime,
            suggestion=did_you_mean(runtime, get_args(RuntimeName)),
        )
    if runtime == "torch":
        return Runner(network, precision, device or default_device())
    if precision != "auto" or (device is not None and device.type != "cpu"):
        raise UsageError(
            "the runtime 'openvino' computes on the processor, with numbers of eight bits",
            name=runtime,
            suggestion="leave precision and device as they are, or choose the runtime 'torch'",
        )
    from vsr.networks.openvino_runtime import OpenVinoRuntime  # noqa: PLC0415  (an extra)

    return OpenVinoRuntime(network)
