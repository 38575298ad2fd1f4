"""Networks on a processor, in whole numbers of eight bits, by OpenVINO."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, fx, nn
from torch.nn import functional

from sfol.errors import UsageError, missing_extra
from vsr.networks.inference import stack_gray, to_input
from vsr.networks.quantisation import WEIGHT_REACH, RoundedConvolution, quantised
from vsr.segmentation import Frame

try:
    import openvino
    from openvino import opset13 as operations
except ImportError as error:
    raise missing_extra(
        str(error.name), "the runtime 'openvino' needs it", extra="openvino"
    ) from error

_Size = tuple[int, ...]


class OpenVinoRuntime:
    """A `Runtime` that computes as `vsr.networks.quantisation` says.

    It has as many threads as torch has when it is made, and compiles the network once for each
    size of frames.

    Args:
        network: as `quantised` takes it; it is set to evaluation, for good.

    Raises:
        UsageError: the network has parts that nothing is known of here.
    """

    def __init__(self, network: nn.Module) -> None:
        self._network = quantised(network)
        self._threads = torch.get_num_threads()
        self._compiled: dict[_Size, Callable[[Any], Any]] = {}

    def __call__(self, frames: Sequence[Frame]) -> Tensor:
        """See `vsr.networks.runtime.Runtime`."""
        inputs = to_input(stack_gray(frames)).numpy()
        size = inputs.shape[2:]
        if size not in self._compiled:
            self._compiled[size] = self._compile(size)
        return torch.from_numpy(self._compiled[size](inputs)[0]).movedim(-1, 1)

    def _compile(self, size: _Size) -> Callable[[Any], Any]:
        pictures = operations.parameter([-1, 1, *size], np.float32)
        # Channels last, as convolutions have them: OpenVINO needs 17 of 42 ms to move the UNet's.
        output = operations.transpose(_Builder(self._network).run(pictures), [0, 2, 3, 1])
        settings = {
            "INFERENCE_NUM_THREADS": self._threads,
            "NUM_STREAMS": 1,
            # Pinned, the threads of all processes would share the first processor: two workers
            # took 24 ms for what each took 12 ms for alone.
            "ENABLE_CPU_PINNING": False,
            "INFERENCE_PRECISION_HINT": "f32",  # of what is no convolution; same numbers everywhere
        }
        model = openvino.Model([output], [pictures])
        compiled: Callable[[Any], Any] = openvino.Core().compile_model(model, "CPU", settings)
        return compiled


class _Builder(fx.Interpreter):
    """Runs a network with OpenVINO's operations in place of tensors, which draws its graph."""

    def call_module(self, target: Any, args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> Any:
        """Return the operation of a module."""
        del kwargs
        (values,) = args
        match self.fetch_attr(target):
            case RoundedConvolution() as rounded:
                return _convolution(rounded, values)
            case nn.ReLU():
                return operations.relu(values)
            case nn.MaxPool2d() as pool:
                return _max_pool(pool, values)
            case nn.Identity():
                return values
            case other:
                raise _unknown(type(other).__name__)

    def call_function(self, target: Any, args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> Any:
        """Return the operation of a function."""
        if target not in _FUNCTIONS:
            raise _unknown(getattr(target, "__name__", str(target)))
        return _FUNCTIONS[target](*args, **kwargs)


def _convolution(rounded: RoundedConvolution, values: Any) -> Any:
    own = rounded.convolution
    reach = (WEIGHT_REACH * rounded.steps).numpy().reshape(-1, 1, 1, 1)
    weight = operations.constant(own.weight.detach().numpy())
    levels = 2 * WEIGHT_REACH + 1
    convolved = operations.convolution(
        values,
        operations.fake_quantize(weight, -reach, reach, -reach, reach, levels),
        strides=list(own.stride),
        pads_begin=list(own.padding),
        pads_end=list(own.padding),
        dilations=list(own.dilation),
    )
    if own.bias is None:
        return convolved
    return operations.add(convolved, own.bias.detach().numpy().reshape(1, -1, 1, 1))


def _max_pool(pool: nn.MaxPool2d, values: Any) -> Any:
    pads = [pool.padding, pool.padding]
    pooled = operations.max_pool(
        values,
        strides=[pool.stride, pool.stride],
        dilations=[pool.dilation, pool.dilation],
        pads_begin=pads,
        pads_end=pads,
        kernel_shape=[pool.kernel_size, pool.kernel_size],
    )
    return pooled.output(0)


def _rounded(values: Any, step: float, zero: int, lowest: int, highest: int) -> Any:
    low, high = np.float32(step * (lowest - zero)), np.float32(step * (highest - zero))
    return operations.fake_quantize(values, low, high, low, high, highest - lowest + 1)


def _enlarged(values: Any, *, size: tuple[int, int], mode: str, **others: Any) -> Any:
    if mode != "nearest" or any(others.values()):
        raise _unknown(f"interpolate with {mode=}")
    return operations.interpolate(
        values,
        np.array(size, np.int64),
        mode=mode,
        shape_calculation_mode="sizes",
        axes=np.array([2, 3], np.int64),
        coordinate_transformation_mode="asymmetric",
        nearest_mode="floor",
    )


def _joined(parts: Sequence[Any], dim: int) -> Any:
    return operations.concat(parts, dim)


def _attribute(values: Any, name: str) -> list[int]:
    if name != "shape":
        raise _unknown(name)
    shape = values.get_output_partial_shape(0)
    return [-1 if side.is_dynamic else side.get_length() for side in shape]


def _unknown(part: str) -> UsageError:
    return UsageError(
        f"the runtime 'openvino' does not know '{part}'", name=part, suggestion="runtime 'torch'"
    )


_FUNCTIONS: Mapping[Any, Callable[..., Any]] = {
    operator.add: operations.add,
    operator.getitem: operator.getitem,
    getattr: _attribute,
    torch.cat: _joined,
    torch.fake_quantize_per_tensor_affine: _rounded,
    functional.interpolate: _enlarged,
}
