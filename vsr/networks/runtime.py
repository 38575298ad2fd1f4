"""What runs a trained network: one face for all, chosen by name."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Literal, Protocol, get_args

import torch
from torch import Tensor, nn

from sfol.errors import UsageError, did_you_mean
from vsr.networks.inference import Precision, Runner, default_device
from vsr.segmentation import Frame

RuntimeName = Literal["auto", "torch", "openvino"]


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
    runtime: RuntimeName = "auto",
    precision: Precision = "auto",
    device: torch.device | None = None,
) -> Runtime:
    """Return what runs a network.

    Args:
        network: takes float (B, 1, H, W) from -1 to 1. It is taken over and can't be trained
            further.
        runtime: ``torch``, on any device, the reference; ``openvino``, on the processor, where
            convolutions compute with whole numbers of eight bits; or ``auto``, which takes OpenVINO
            where it is installed, the processor has instructions for such numbers, and neither a
            precision nor a device was chosen nor is there a GPU; else torch.
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
    chosen = precision != "auto" or (device is not None and device.type != "cpu")
    if runtime == "auto":
        runtime = "torch" if chosen or not _openvino_is_fastest() else "openvino"
    if runtime == "torch":
        return Runner(network, precision, device or default_device())
    if chosen:
        raise UsageError(
            "the runtime 'openvino' computes on the processor, with numbers of eight bits",
            name=runtime,
            suggestion="leave precision and device as they are, or choose the runtime 'torch'",
        )
    from vsr.networks.openvino_runtime import OpenVinoRuntime  # noqa: PLC0415  (an extra)

    return OpenVinoRuntime(network)


def _openvino_is_fastest() -> bool:
    """Tell whether OpenVINO is there, and computes faster here than torch does."""
    return (
        find_spec("openvino") is not None
        and default_device().type == "cpu"
        and bool(torch.cpu._is_vnni_supported())
    )
