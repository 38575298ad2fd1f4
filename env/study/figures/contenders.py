"""Who drove the collision test, and how, over all training seeds of a setup."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields

from env.evaluation.evaluate import Settings, Summary
from env.evaluation.results import DriveResult
from env.evaluation.statistics import Mean, Share
from env.study.figures.paper import Paper
from env.world.cells import CELLS, Cell
from sfol.errors import UsageError

Measure = Share | Mean
Run = tuple[int, DriveResult]  # with the seed of the training

TRAFFIC = tuple(dict.fromkeys(cell.traffic for cell in CELLS))


def number(measure: Measure) -> float | None:
    """Return the share or the mean itself."""
    return measure.share if isinstance(measure, Share) else measure.mean


def pool(parts: Sequence[Measure]) -> Measure:
    """Return one measure over the episodes of all parts, which are all shares or all means."""
    shares = [part for part in parts if isinstance(part, Share)]
    if shares:
        return Share.out_of(sum(share.count for share in shares), sum(share.of for share in shares))
    return Mean.pooled(part for part in parts if isinstance(part, Mean))


def metric(name: str) -> Callable[[Summary], Measure | None]:
    """Return what picks a metric out of a summary: a share or a mean, or None where it lacks it."""

    def of(summary: Summary) -> Measure | None:
        measured = summary.measured.get(name)
        return None if isinstance(measured, int) else measured

    return of


@dataclass(frozen=True)
class Pooled:
    """What was measured over all training seeds.

    Attributes:
        whole: over the episodes of all seeds together.
        seeds: of each seed by itself.
    """

    whole: Measure
    seeds: tuple[Measure, ...]

    @property
    def value(self) -> float | None:
        """The share or the mean; None where no episode has the number."""
        return number(self.whole)

    @property
    def range(self) -> tuple[float, float] | None:
        """The seeds' smallest and largest; None of fewer than two seeds that have the number."""
        values = [value for value in map(number, self.seeds) if value is not None]
        return (min(values), max(values)) if len(values) > 1 else None


@dataclass(frozen=True)
class Contender:
    """A setup with its training seeds, or a scripted driver, which counts as one seed.

    Attributes:
        name: of setup or driver.
        perception: where facts came from.
        episodes: of a cell and seed.
        seeds: training seed → cell → what was measured.
    """

    name: str
    perception: str
    episodes: int
    seeds: Mapping[int, Mapping[Cell, Summary]]

    def measured(
        self, cells: Sequence[Cell], measure: Callable[[Summary], Measure | None]
    ) -> Pooled | None:
        """Return a measure over some cells, pooled over the seeds that have driven all of them.

        Args:
            cells: at least one.
            measure: picks it out of a summary; `metric` makes one.

        Returns:
            None where no seed has driven all those cells, or was measured so.
        """
        complete = [runs for runs in self.seeds.values() if all(cell in runs for cell in cells)]
        of_seeds = [[measure(runs[cell]) for cell in cells] for runs in complete]
        seeds = tuple(
            pool([part for part in parts if part is not None])
            for parts in of_seeds
            if None not in parts
        )
        return Pooled(pool(seeds), seeds) if seeds else None


@dataclass(frozen=True)
class Contenders:
    """Everybody who drove.

    Attributes:
        setups: by name.
        drivers: scripted ones, by name.
    """

    setups: Mapping[str, Contender]
    drivers: Mapping[str, Contender]


@dataclass(frozen=True)
class Group:
    """Setups that are shown together.

    Attributes:
        title: of the group.
        labels: setup → what it is called there.
    """

    title: str
    labels: Mapping[str, str]


def gather(study: Iterable[DriveResult], drivers: Iterable[DriveResult]) -> Contenders:
    """Sort drives by who drove them. Streets where nobody crosses are another test; left out.

    Args:
        study: drives of trained setups, named by setup and seed, and perhaps of scripted drivers.
        drivers: drives of scripted drivers. Of one who is in both, this one counts.

    Raises:
        UsageError: drives that would be pooled were driven under different conditions.
    """
    by_setup: dict[str, list[Run]] = {}
    by_driver: dict[str, list[Run]] = {}
    for result in _with_hazard(study):
        name, seed = _setup_and_seed(result.settings.driver)
        known = by_driver if seed is None else by_setup
        known.setdefault(name, []).append((seed or 0, result))
    scripted: dict[str, list[Run]] = {}
    for result in _with_hazard(drivers):
        scripted.setdefault(result.settings.driver, []).append((0, result))
    return Contenders(
        {name: _contender(name, runs) for name, runs in by_setup.items()},
        {name: _contender(name, runs) for name, runs in (by_driver | scripted).items()},
    )


def groups(paper: Paper, setups: Iterable[str]) -> list[Group]:
    """Return the paper's sets, and one more of those setups that are in none, if there are any."""
    sets = [Group(s.title, {setup.name: setup.label for setup in s.setups}) for s in paper.sets]
    others = sorted(set(setups).difference(*(group.labels for group in sets)))
    return [*sets, Group("Other setups", {name: name for name in others})] if others else sets


def in_order(groups: Iterable[Group]) -> list[str]:
    """Return the setups of all groups, each once."""
    return list(dict.fromkeys(name for group in groups for name in group.labels))


def level(traffic: str) -> tuple[Cell, ...]:
    """Return the cells with some traffic."""
    return tuple(cell for cell in CELLS if cell.traffic == traffic)


def _setup_and_seed(driver: str) -> tuple[str, int | None]:
    found = re.fullmatch(r"(.+)-seed(\d+)", driver)
    return (found[1], int(found[2])) if found else (driver, None)


def _with_hazard(results: Iterable[DriveResult]) -> list[DriveResult]:
    return [result for result in results if result.settings.hazard]


def _contender(name: str, runs: Sequence[Run]) -> Contender:
    first = runs[0][1].settings
    seeds: dict[int, dict[Cell, Summary]] = {}
    for seed, result in runs:
        _check_alike(first, result.settings)
        cell = Cell.parse(f"{result.settings.traffic}/{result.settings.occlusion}")
        seeds.setdefault(seed, {})[cell] = result.summary
    return Contender(name, first.perception, first.episodes, seeds)


def _check_alike(one: Settings, other: Settings) -> None:
    """Raise an error if two drives differ in more than who drove where."""
    conditions = {field.name for field in fields(Settings)} - {"driver", "policy", *Cell._fields}
    differ = [c for c in sorted(conditions) if getattr(one, c) != getattr(other, c)]
    if differ:
        raise UsageError(
            f"drives of '{one.driver}' in {one.traffic}/{one.occlusion} and of '{other.driver}' in "
            f"{other.traffic}/{other.occlusion} differ in {', '.join(differ)}, so that they can't "
            "be pooled",
            name=other.driver,
            suggestion="drive one of them again, or remove its files",
        )
