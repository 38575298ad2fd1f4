"""Schedules: numbers of the reward that change while an agent is trained."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

from sfol.errors import did_you_mean
from sfol.knowledge_base.format import KnowledgeBaseFile
from sfol.knowledge_base.parts import ScheduledNumber
from sfol.knowledge_base.reporting import Reporter


def checked_schedules(file: KnowledgeBaseFile, reporter: Reporter) -> dict[str, ScheduledNumber]:
    """Return the schedules of a file: the number's name as written → how it changes.

    Args:
        file: the merged content of all files of a chain.
        reporter: notes every name that is no number of the file.
    """
    known = {".".join(number): number for number in _numbers(file)}
    found = {}
    for target, entry in file.schedules.items():
        if target not in known:
            reporter.report(
                ("schedules", target),
                f"'{target}' is no number that can be scheduled",
                target,
                did_you_mean(target, known)
                or "write weights.<weight>.<head> or terms.<term>.<parameter>",
            )
            continue
        found[target] = ScheduledNumber(
            *known[target], entry.start, entry.end, entry.over, entry.by
        )
    return found


def values_at(
    schedules: Mapping[str, ScheduledNumber], steps: int, episodes: int
) -> dict[str, float]:
    """Return the value of every scheduled number at a moment of a training.

    Args:
        schedules: of a knowledge base.
        steps: how many steps were taken, over all environments.
        episodes: how many episodes have ended, likewise.
    """
    done = {"steps": steps, "episodes": episodes}
    return {target: number.value_at(done[number.by]) for target, number in schedules.items()}


def _numbers(
    file: KnowledgeBaseFile,
) -> Iterator[tuple[Literal["weights", "terms"], str, str]]:
    """Yield the numbers that can be set at run time: section, weight or term, name."""
    for name, weight in file.weights.items():
        yield from (("weights", name, head) for head in weight.coefficients)
    for name, term in file.terms.items():
        yield from (("terms", name, parameter) for parameter in term.parameters)
