"""How restless are the weights of two knowledge bases on the same drives?

`aeb fluctuation` lets the cautious driver drive through all cells, puts what was seen to both, and
prints for every weight its total variation a second, and how far one is behind the other where it
rises. Source of the question: the paper's sections "Trajectory Analysis" and "Discussion".
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import track
from rich.table import Table

import sfol
from env import CELLS
from env.driving.drivers import Cautious
from env.driving.rollout import rollout
from env.evaluation.metrics import fluctuation
from env.street.crossing import OccludedCrossing
from sfol.cli.output import escaped
from sfol.errors import UsageError
from sfol.logs import Log, LoggedEpisode, LoggedStep
from sfol.tools.plotting import new_figure, save
from sfol.tools.replay import ReplayedEpisode, replay
from sfol.tools.texts import visible
from sfol.writing import check_writable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RISE = 0.05  # by which a weight must grow in a step for that to count as a rise
FOLLOWED = 0.9  # share of what a weight rises to that the other one must reach

Reals = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Calm:
    """A weight under two knowledge bases, over some episodes.

    Attributes:
        before: mean total variation under the first, in 1/s.
        after: the same under the second.
        means: mean of the weight under the first, and under the second.
        late: of each rise under the first, by how many steps the second one is late.
    """

    before: float
    after: float
    means: tuple[float, float]
    late: tuple[int, ...]

    @property
    def ratio(self) -> float:
        """How many times as restless the first one is."""
        return self.before / self.after if self.after else float("inf")


def drives(episodes: int, seed: int, perception: str, rules: sfol.KnowledgeBase) -> Log:
    """Drive the cautious driver through all cells in turn; return what was seen.

    Args:
        episodes: how many.
        seed: of the first episode; the others count on from it.
        perception: where facts come from; see `OccludedCrossing`.
        rules: say how facts are read; what they reward changes no drive.
    """
    streets = [
        OccludedCrossing(**cell, perception=perception, observation="none", rules=rules)
        for cell in CELLS.values()
    ]
    try:
        recorded = [
            _recorded(streets[number % len(streets)], number, seed + number)
            for number in track(range(episodes), "driving …", transient=True)
        ]
    finally:
        for street in streets:
            street.close()
    return Log(rules.name, rules.hash, sfol.__version__, tuple(recorded))


def _recorded(street: OccludedCrossing, number: int, seed: int) -> LoggedEpisode:
    steps = []
    for step in rollout(street, Cautious(), seed):
        steps.append(LoggedStep(step.time, step.scene.facts, step.signals))
    return LoggedEpisode(number, step.ending, tuple(steps))


def compare(
    before: Sequence[ReplayedEpisode], after: Sequence[ReplayedEpisode], dt: float
) -> dict[str, Calm]:
    """Return every weight that both knowledge bases have.

    Args:
        before: episodes under the first.
        after: the same episodes under the second.
        dt: length of a step, in s.
    """
    names = [name for name in before[0].outcomes[0].weights if name in after[0].outcomes[0].weights]
    return {name: _calm(list(_courses(name, before, after)), dt) for name in names}


def _courses(
    name: str, before: Sequence[ReplayedEpisode], after: Sequence[ReplayedEpisode]
) -> Iterator[tuple[Reals, Reals]]:
    for one, other in zip(before, after, strict=True):
        yield _course(name, one), _course(name, other)


def _course(name: str, episode: ReplayedEpisode) -> Reals:
    return np.array([outcome.weights[name] for outcome in episode.outcomes])


def _calm(courses: Sequence[tuple[Reals, Reals]], dt: float) -> Calm:
    olds, news = zip(*courses, strict=True)
    before, after = (
        float(np.mean([fluctuation(course, dt) for course in each])) for each in (olds, news)
    )
    means = (float(np.concatenate(olds).mean()), float(np.concatenate(news).mean()))
    return Calm(before, after, means, tuple(n for pair in courses for n in lateness(*pair)))


def lateness(before: Reals, after: Reals) -> list[int]:
    """Return, for each rise of a weight, how many steps later another one has followed.

    A rise is a step in which the weight grows by more than `RISE`; the other one has followed when
    it reaches `FOLLOWED` of what the weight comes to in that step. Where it never does, the steps
    that are left of the episode count.

    Args:
        before: the weight, (T,).
        after: the other one, (T,).
    """
    rises = np.flatnonzero(np.diff(before, prepend=0.0) > RISE)
    found = []
    for at in rises.tolist():
        reached = np.flatnonzero(after[at:] >= FOLLOWED * before[at])
        found.append(int(reached[0]) if reached.size else len(after) - at)
    return found


def print_fluctuation(
    rules: tuple[str | Path, str | Path],
    episodes: int,
    seed: int,
    perception: str,
    picture: Path | None,
) -> None:
    """Print how restless the weights of two knowledge bases are.

    Args:
        rules: the two, by name or path.
        episodes: how many are driven, through all cells in turn.
        seed: of the first episode.
        perception: where facts come from.
        picture: a file for the weights over the most restless episode; None for none.

    Raises:
        UsageError: the two have no weight in common.
    """
    if picture is not None:
        check_writable(picture)
    first, second = (sfol.KnowledgeBase.load(name) for name in rules)
    common = first.weights.keys() & second.weights.keys()
    if not common:
        raise UsageError(f"'{first.name}' and '{second.name}' have no weight in common")
    log = drives(episodes, seed, perception, first)
    before, after = replay(log, first), replay(log, second)
    dt = _length_of_step(log)
    found = compare(before, after, dt)
    console = Console(highlight=False)
    console.print(_table(found, (first.name, second.name), episodes))
    if picture is not None:
        worst = max(range(episodes), key=lambda n: _restlessness(before[n], list(found), dt))
        save(draw(before[worst], after[worst], (first.name, second.name), list(found)), picture)
        console.print(escaped(picture), soft_wrap=True)


def _length_of_step(log: Log) -> float:
    first, second, *_ = log.episodes[0].steps
    return second.time - first.time


def _restlessness(episode: ReplayedEpisode, names: Sequence[str], dt: float) -> float:
    return sum(fluctuation(_course(name, episode), dt) for name in names)


def _table(found: Mapping[str, Calm], names: tuple[str, str], episodes: int) -> Table:
    title = f"{episodes} episodes"
    table = Table("weight of", *found, title=title, box=SIMPLE_HEAD, title_justify="left")
    rows: Mapping[str, Callable[[Calm], str]] = {
        f"{names[0]}, variation in 1/s": lambda calm: f"{calm.before:.3f}",
        f"{names[1]}, variation in 1/s": lambda calm: f"{calm.after:.3f}",
        "ratio": lambda calm: f"{calm.ratio:.2f}",
        f"{names[0]}, mean": lambda calm: f"{calm.means[0]:.2f}",
        f"{names[1]}, mean": lambda calm: f"{calm.means[1]:.2f}",
        f"rises under {names[0]}": lambda calm: f"{len(calm.late)}",
        "followed late, mean in steps": lambda calm: f"{np.mean(calm.late or [0]):.1f}",
        "followed late, at most": lambda calm: f"{max(calm.late, default=0)}",
    }
    for name, shown in rows.items():
        table.add_row(visible(name), *(shown(calm) for calm in found.values()))
    for column in table.columns[1:]:
        column.justify = "right"
    return table


def draw(
    before: ReplayedEpisode,
    after: ReplayedEpisode,
    names: tuple[str, str],
    weights: Sequence[str],
) -> Figure:
    """Draw weights over one episode under two knowledge bases, a panel for each weight."""
    figure = new_figure(7.0, 0.8 + 1.7 * len(weights))
    panels = figure.subplots(len(weights), 1, squeeze=False, sharex=True, sharey=True)[:, 0]
    times = [step.time for step in before.episode.steps]
    for axis, weight in zip(panels, weights, strict=True):
        axis.step(times, _course(weight, before), where="post", color="#E69F00", linewidth=0.9)
        axis.step(times, _course(weight, after), where="post", color="#0072B2", linewidth=1.6)
        axis.set_ylabel(f"weight of {weight}", parse_math=False)
        axis.set_ylim(bottom=0.0)
        axis.grid(color="0.9", linewidth=0.6)
    panels[-1].set_xlabel("time in s")
    figure.legend(panels[0].get_lines(), names, ncols=2, loc="outside upper center", frameon=False)
    return figure
