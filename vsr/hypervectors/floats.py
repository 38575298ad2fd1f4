"""Numbers that callers hand over, as tensors."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from sfol.errors import UsageError


def as_floats(numbers: Any, name: str) -> Tensor:
    """Return finite numbers as floats, on the device where they are, with their gradients.

    Args:
        numbers: a tensor, an array or a sequence.
        name: what they are called.

    Raises:
        UsageError: they are no real numbers, or one is not finite as float32.
    """
    try:
        tensor = torch.as_tensor(numbers)
    except (TypeError, ValueError, RuntimeError) as error:
        reason = str(error).splitlines()[0]
        raise UsageError(f"{name} are no numbers: {reason}", name=name) from None
    if tensor.is_complex():
        raise UsageError(f"{name} are complex", name=name, suggestion="real numbers")
    if not tensor.float().isfinite().all():
        raise UsageError(f"one of the {name} is not a finite number", name=name)
    return tensor if tensor.is_floating_point() else tensor.float()
