"""Networks in whole numbers: which of their values are rounded to eight bits, and how.

Inputs, what ReLUs give, and the weights of convolutions are rounded; that is all that goes into
convolutions. Weights are known; how large the rest becomes is read off the normalisations, which
have learnt it: channel c of what they give has the mean β_c and the standard deviation abs(γ_c)
over the frames of the training. So no frames are needed.

Source: B. Jacob et al., "Quantization and training of neural networks for efficient
integer-arithmetic-only inference", CVPR 2018, for the rounding; M. Nagel et al., "Data-free
quantization through weight equalization and bias correction", ICCV 2019, for the ranges.
"""

from __future__ import annotations

import math
import operator
from typing import NamedTuple, cast

import torch
from torch import Tensor, fx, nn
from torch.fx.experimental.optimization import fuse
from torch.nn import functional

from sfol.errors import UsageError

# How many standard deviations above its mean a channel's values may be. Features of the shipped
# encoder kept a cosine of 0.9994 to those of float32 with 6, and of 0.9998 with 8, as with ranges
# measured on frames; ranges twice as wide keep 0.9994.
_REACH = 8.0
WEIGHT_REACH = 127  # multiples of its step that a weight is at most, up and down


def quantised(network: nn.Module) -> fx.GraphModule:
    """Return a network whose convolutions compute with numbers of eight bits.

    It computes in floats what hardware and libraries for whole numbers compute from it: every
    rounding is a node of its own.

    Args:
        network: convolutions, each followed by a normalisation or by the network's end, ReLUs, and
            what moves values about; it takes floats from -1 to 1. It is not changed.

    Raises:
        UsageError: a ReLU has no normalisation before it.
    """
    graph_module = fx.symbolic_trace(network.eval().requires_grad_(False))
    for node, largest in _largest_values(graph_module).items():
        _round_after(node, largest, signed=node.op == "placeholder")
    graph_module.recompile()
    fused = cast(fx.GraphModule, fuse(graph_module))
    for name, module in list(fused.named_modules()):
        if isinstance(module, nn.Conv2d):
            fused.set_submodule(name, RoundedConvolution(module))
    return fused


class _Spread(NamedTuple):
    """Mean and variance of each channel, float (C,)."""

    mean: Tensor
    variance: Tensor

    def plus(self, other: _Spread) -> _Spread:
        """Return the spread of the sum of two values that know nothing of each other."""
        return _Spread(self.mean + other.mean, self.variance + other.variance)

    def rectified(self) -> _Spread:
        """Return the spread of max(x, 0) for normal x."""
        deviation = self.variance.sqrt().clamp_min(1e-6)
        ratio = self.mean / deviation
        density = torch.exp(-0.5 * ratio.square()) / math.sqrt(2 * math.pi)
        share = torch.special.ndtr(ratio)  # above zero
        mean = self.mean * share + deviation * density
        square = (self.mean.square() + self.variance) * share + self.mean * deviation * density
        return _Spread(mean, (square - mean.square()).clamp_min(0.0))

    def largest(self) -> float:
        """Return what hardly any value of any channel exceeds."""
        return float((self.mean + _REACH * self.variance.sqrt()).max())


def _largest_values(network: fx.GraphModule) -> dict[fx.Node, float]:
    """Return where values are rounded, and how large they become there: inputs and ReLUs."""
    spreads: dict[fx.Node, _Spread] = {}
    largest: dict[fx.Node, float] = {}
    for node in network.graph.nodes:
        known = [spreads[before] for before in node.all_input_nodes if before in spreads]
        module = network.get_submodule(node.target) if node.op == "call_module" else None
        if node.op == "placeholder":
            largest[node] = 1.0
        elif isinstance(module, nn.BatchNorm2d):
            spreads[node] = _Spread(module.bias.detach(), module.weight.detach().square())
        elif isinstance(module, nn.ReLU):
            if not known:
                raise UsageError(
                    f"nothing is known of what goes into '{node.target}'",
                    name=str(node.target),
                    suggestion="normalise it, or compute in floats",
                )
            largest[node] = known[0].largest()
            spreads[node] = known[0].rectified()
        elif node.target is operator.add and len(known) == 2:
            spreads[node] = known[0].plus(known[1])
        elif len(known) == 1 and not isinstance(module, nn.Conv2d):
            spreads[node] = known[0]  # pooled or enlarged
    return largest


def _round_after(node: fx.Node, largest: float, *, signed: bool) -> None:
    """Put a rounding between a node and all who use it."""
    lowest, highest = (-127, 127) if signed else (0, 255)
    with node.graph.inserting_after(node):
        rounded = node.graph.call_function(
            torch.fake_quantize_per_tensor_affine,
            (node, largest / highest, 0, lowest, highest),
        )
    node.replace_all_uses_with(rounded, delete_user_cb=lambda user: user is not rounded)


class RoundedConvolution(nn.Module):
    """A convolution whose weights are rounded, with a step of its own for each channel.

    Attributes:
        convolution: with weights as they were.
        steps: float32 (C,), what a weight of each output channel is a multiple of.
    """

    steps: Tensor
    _zeros: Tensor

    def __init__(self, convolution: nn.Conv2d) -> None:
        super().__init__()
        self.convolution = convolution
        largest = convolution.weight.abs().amax(dim=(1, 2, 3)).clamp_min(1e-9)
        self.register_buffer("steps", largest / WEIGHT_REACH)
        self.register_buffer("_zeros", torch.zeros(len(largest), dtype=torch.int32))

    def forward(self, values: Tensor) -> Tensor:
        """Return the convolution of values, (B, C, H, W)."""
        own = self.convolution
        weight = torch.fake_quantize_per_channel_affine(
            own.weight, self.steps, self._zeros, 0, -WEIGHT_REACH, WEIGHT_REACH
        )
        return functional.conv2d(
            values, weight, own.bias, own.stride, own.padding, own.dilation, own.groups
        )
