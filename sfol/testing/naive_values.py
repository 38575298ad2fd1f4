"""The naive reference of values: what comparisons say, straight from the definition.

Like `sfol.testing.naive` it shares nothing with what engines and formulas compute.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from sfol.comparisons import Comparison
from sfol.facts import Bound, Facts
from sfol.knowledge_base import KnowledgeBase
from sfol.syntax import Atom


def said_of_values(kb: KnowledgeBase, facts: Facts) -> dict[Atom, Bound]:
    """Return what every comparison of a knowledge base says of the values in facts."""
    said = {}
    for predicate in kb.comparisons:
        comparison = predicate.operator
        assert isinstance(comparison, Comparison)
        for atom in facts:
            value = facts.value(atom.predicate, *atom.arguments)
            # A comparison of a value that is not known is not known.
            if atom.predicate == predicate.attribute and value is not None:
                true = _truth(comparison, value)
                said[Atom(predicate, atom.arguments)] = Bound(true, true)
    return said


def _truth(comparison: Comparison, value: float) -> float:
    first, last = comparison.limits[0], comparison.limits[-1]
    match comparison.name:
        case "<" | "<=" | ">" | ">=" as sign:
            return 1.0 if _CRISP[sign](value, first) else 0.0
        case "below":
            return _falling(comparison, value - first)
        case "above":
            return _falling(comparison, first - value)
        case "between":
            return _falling(comparison, max(first - value, value - last))
        case "near":
            return _falling(comparison, abs(value - first))
    raise NotImplementedError(f"what '{comparison.name}' means is not defined")


def _falling(comparison: Comparison, outside: float) -> float:
    # 1 where the comparison holds; outside of that it falls with r, the distance in margins.
    options = dict(comparison.options)
    margin = float(options.get("margin", 0.0))
    if outside <= 0.0 or margin == 0.0:
        return 1.0 if outside <= 0.0 else 0.0
    shape = str(options.get("shape", "linear"))
    return _SHAPES[shape](outside / margin, float(options.get("value_at_margin", 0.1)))


_CRISP: Mapping[str, Callable[[float, float], bool]] = {
    "<": lambda value, limit: value < limit,
    "<=": lambda value, limit: value <= limit,
    ">": lambda value, limit: value > limit,
    ">=": lambda value, limit: value >= limit,
}
_SHAPES: Mapping[str, Callable[[float, float], float]] = {
    "linear": lambda r, v: max(1.0 - (1.0 - v) * r, 0.0),
    "gaussian": lambda r, v: math.pow(v, r * r),
    "long_tail": lambda r, v: 1.0 / (1.0 + (1.0 / v - 1.0) * r * r),
    "cosine": lambda r, v: (1.0 + math.cos(min(r * math.acos(2.0 * v - 1.0), math.pi))) / 2.0,
    "hard": lambda r, v: v if r <= 1.0 else 0.0,
}
