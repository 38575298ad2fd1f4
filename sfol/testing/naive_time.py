"""The naive reference of time: what operators over time say, from all steps that there were.

Like `sfol.testing.naive` it follows the definition sentence by sentence. It remembers everything,
and shares nothing with what episodes remember.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from functools import partial

from sfol.facts import Bound
from sfol.knowledge_base import KnowledgeBase, Rule
from sfol.syntax import Atom, Timed
from sfol.temporal import Fell, Held, Latched, Once, Previously, Rose, Since

Known = Mapping[Atom, Bound]
# What is known of an atom at a step, by the step's number.
_Course = Callable[[int], Bound | None]


def said_of(kb: KnowledgeBase, rules: Sequence[Rule], steps: Sequence[Known]) -> dict[Atom, Bound]:
    """Return what operators over time, of which some rules speak, say at the last step.

    Args:
        kb: the knowledge base.
        rules: some of its rules.
        steps: all atoms that were known at each step from the first on; of the last, those that are
            known so far.
    """
    entities = {name for known in steps for atom in known for name in atom.arguments}
    names = sorted(entities | {kb.subject})
    asked = {name for rule in rules for name in rule.clause.body.asked}
    spoken = {name for name in asked if isinstance(name, Timed)}
    said = {}
    for predicate in spoken:
        for arguments in itertools.product(names, repeat=predicate.arity):
            atom = Atom(predicate, arguments)
            bound = _course(kb, atom, steps)(len(steps) - 1)
            if bound is not None:
                said[atom] = bound
    return said


def needed_now(atom: Atom) -> Iterator[str]:
    """Yield the predicates of which a step must know everything before what an atom says there."""
    if not isinstance(atom.predicate, Timed):
        yield atom.predicate
    # The past never depends on the present.
    elif not isinstance(atom.predicate.operator, Previously):
        for operand in atom.predicate.atoms(atom.arguments):
            yield from needed_now(operand)


def _course(kb: KnowledgeBase, atom: Atom, steps: Sequence[Known]) -> _Course:
    if not isinstance(atom.predicate, Timed):
        return lambda step: steps[step].get(atom)
    said = partial(_said, kb, atom.predicate)
    operands = [_course(kb, a, steps) for a in atom.predicate.atoms(atom.arguments)]
    return lambda step: said(operands[0], operands[-1], step)


def _said(
    kb: KnowledgeBase, predicate: Timed, first: _Course, last: _Course, step: int
) -> Bound | None:
    """Return what an operator says at a step; most have one operand, which is first and last."""
    said: Bound | None
    match predicate.operator:
        case Previously():
            said = _before(last, step)
        case Once(back):
            said = _once(last, _window(kb, step, back))
        case Held(back):
            said = _held(last, step, _window(kb, step, back), kb, back)
        case Since():
            said = _since(first, last, step)
        case Latched(on, off):
            said = _latched(last, step, on, off)
        case Rose():
            said = _both(last(step), _before(last, step))
        case Fell():
            said = _both(_before(last, step), last(step))
        case _:
            raise NotImplementedError(f"what '{predicate}' means is not defined")
    return said


def _before(course: _Course, step: int) -> Bound | None:
    # The bound of A one step before; unknown at the first step.
    return course(step - 1) if step else None


def _length(kb: KnowledgeBase) -> Fraction:
    assert kb.time is not None, "a duration needs the length of a step"
    return Fraction(str(kb.time.step))


def _window(kb: KnowledgeBase, step: int, back: float) -> list[int]:
    # The last d: this step, and all earlier ones that are at most d ago.
    return [s for s in range(step + 1) if (step - s) * _length(kb) <= Fraction(str(back))]


def _once(course: _Course, window: Sequence[int]) -> Bound | None:
    bounds = [bound for step in window if (bound := course(step)) is not None]
    return _greatest(bounds) if bounds else None


def _held(
    course: _Course, step: int, window: Sequence[int], kb: KnowledgeBase, back: float
) -> Bound | None:
    # Unknown until d has passed: as long as the steps within d before this one are not all there.
    bounds = [course(earlier) for earlier in window]
    known = [bound for bound in bounds if bound is not None]
    if (step + 1) * _length(kb) <= Fraction(str(back)) or len(known) < len(bounds):
        return None
    return _least(known)


def _since(kept: _Course, begun: _Course, step: int) -> Bound | None:
    chains = []
    for start in range(step + 1):
        chain = [begun(start), *(kept(later) for later in range(start + 1, step + 1))]
        known = [bound for bound in chain if bound is not None]
        if len(known) == len(chain):
            chains.append(_least(known))
    return _greatest(chains) if chains else None


def _latched(course: _Course, step: int, on: float, off: float) -> Bound | None:
    is_on = False
    for earlier in range(step + 1):
        bound = course(earlier)
        confidence = 0.0 if bound is None else (bound.lower + bound.upper) / 2
        threshold = off if is_on else on
        # What misses a threshold by less than a thousand-millionth of it reaches it.
        is_on = confidence >= threshold or threshold - confidence <= threshold * 1e-9
    return Bound(1.0, 1.0) if is_on else None


def _both(true: Bound | None, false: Bound | None) -> Bound | None:
    """Return A and not B as literals hold without thresholds of a rule's own."""
    opposite = Bound(1.0, 1.0) if false is None else Bound(1.0 - false.upper, 1.0 - false.lower)
    if true is None or true.upper <= 0.0 or opposite.lower < 0.5 * (1.0 - 1e-9):
        return None
    return _least([true, opposite])


def _least(bounds: Sequence[Bound]) -> Bound:
    return Bound(min(b.lower for b in bounds), min(b.upper for b in bounds))


def _greatest(bounds: Sequence[Bound]) -> Bound:
    return Bound(max(b.lower for b in bounds), max(b.upper for b in bounds))
