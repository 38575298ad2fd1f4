"""Rewards as operations of torch alone, which ask the host nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sfol import arrays
from sfol.recorded_steps import Recording, leaf_of

Tensor = Any  # of torch, which is never imported before somebody calls this


@dataclass(frozen=True)
class TensorOutcome:
    """What steps are worth: tensors, float64, with the leading axes of the steps.

    Where nothing can be said of a step without an error, all of them are NaN.

    Attributes:
        reward: R.
        terms: term → weight × formula, signed.
        weights: weight → w.
        confidences: head → τ̂ of the subject, 0 where nothing was concluded.
    """

    reward: Tensor
    terms: Mapping[str, Tensor]
    weights: Mapping[str, Tensor]
    confidences: Mapping[str, Tensor]


class TensorReward:
    """What `RewardFunction.transitions` does to tensors, and nothing beside it.

    No question is left whose answer is in the tensors. So it is one graph to ``torch.compile``, it
    can be mapped by ``torch.vmap``, and a device need not be waited for; gradients go through it.
    It knows the numbers of rules and formulas as they were when it was made.

    Args:
        recording: of one step, with the outputs in the order of `TensorOutcome`.
        terms: names of these outputs.
        weights: likewise.
        heads: likewise.
    """

    def __init__(
        self,
        recording: Recording,
        terms: Sequence[str],
        weights: Sequence[str],
        heads: Sequence[str],
    ) -> None:
        import torch  # noqa: PLC0415  (an extra, and slow to import)

        self._leaves = recording.leaves
        self._program = recording.program
        self._groups = tuple(terms), tuple(weights), tuple(heads)
        self._torch = torch
        self._functions = _functions(torch)

    def __call__(  # noqa: PLR0913, PLR0917 (what `env.step` returns)
        self,
        observation: Any,
        action: Any = None,
        next_observation: Any = None,
        native: Any = None,
        terminated: Any = None,
        truncated: Any = None,
        /,
    ) -> TensorOutcome:
        """Return what steps are worth.

        Args:
            observation: before the action, of the form that this was made for: its tensors, all of
                one device, have the same leading axes, or none for a single step.
            action: likewise, as are the others; those that nothing reads may be None.
            next_observation: after the action.
            native: the environment's own reward.
            terminated: whether the step terminated the episode.
            truncated: whether the episode was truncated after it.
        """
        torch, program = self._torch, self._program
        step = (observation, action, next_observation, native, terminated, truncated)
        columns = {
            name: leaf_of(step, leaf).double().flatten(-len(leaf.shape))
            if leaf.shape
            else leaf_of(step, leaf).double()[..., None]
            for name, leaf in self._leaves.items()
        }
        like = next(iter(columns.values()))[..., 0]
        holds = torch.ones_like(like, dtype=torch.bool)
        lanes: list[Tensor] = [None] * program.size
        for place, value in program.constants:
            kind = torch.bool if isinstance(value, bool) else torch.float64
            lanes[place] = torch.full((), value, dtype=kind, device=like.device)
        for name, index, place in program.given:
            lanes[place] = number = columns[name][..., index]
            holds = holds & ~torch.isnan(number)
        for operation, inputs, place in program.operations:
            lanes[place] = self._functions[operation](*(lanes[i] for i in inputs))
        for place, value in program.guards:
            holds = holds & (lanes[place] if value else ~lanes[place])
        nothing = torch.full_like(like, torch.nan)
        values = iter([torch.where(holds, lanes[place], nothing) for place in program.outputs])
        reward = next(values)
        terms, weights, heads = ({name: next(values) for name in g} for g in self._groups)
        return TensorOutcome(reward, terms, weights, heads)


def _functions(torch: Any) -> dict[str, Callable[..., Tensor]]:
    """Return what each operation of a tape is to tensors."""
    of_numbers = {
        "+": torch.add,
        "-": torch.sub,
        "*": torch.mul,
        "/": torch.true_divide,
        "**": torch.pow,
        "neg": torch.neg,
        "abs": torch.abs,
        "<": torch.lt,
        "<=": torch.le,
        ">": torch.gt,
        ">=": torch.ge,
        "==": torch.eq,
        "!=": torch.ne,
        "isnan": torch.isnan,
        "isfinite": torch.isfinite,
        "minimum": torch.minimum,
        "maximum": torch.maximum,
        "cos": torch.cos,
        "hypot": arrays.hypot,  # which has a gradient everywhere
        "atan2": torch.atan2,
        "exp": torch.exp,
        "log": torch.log,
        "sqrt": torch.sqrt,
    }
    of_truths = {
        "and": torch.logical_and,
        "or": torch.logical_or,
        "not": torch.logical_not,
        "where": lambda condition, *rest: torch.where(condition.bool(), *map(_number, rest)),
    }
    return of_truths | {name: _of_numbers(function) for name, function in of_numbers.items()}


def _of_numbers(function: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """Return a function that takes truth values as numbers, which torch does not always."""
    return lambda *tensors: function(*map(_number, tensors))


def _number(tensor: Tensor) -> Tensor:
    return tensor.double()
