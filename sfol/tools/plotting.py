"""Draws replayed episodes over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sfol.errors import UsageError, missing_extra
from sfol.outcome import Outcome
from sfol.tools.replay import ReplayedEpisode
from sfol.tools.texts import visible
from sfol.writing import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_EPISODES = 8

_Values = Callable[[Outcome], Mapping[str, float]]
_ROWS: Mapping[str, _Values] = {
    "confidence": lambda outcome: outcome.confidences,
    "weight": lambda outcome: outcome.weights,
    "reward": lambda outcome: outcome.terms,
}


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure that opens no window.

    Args:
        width: in inches.
        height: in inches.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure  # noqa: PLC0415  (an extra, and slow to import)
    except ImportError:
        raise missing_extra("matplotlib", "plots need it", extra="plot") from None
    return Figure(figsize=(width, height), layout="constrained")


def plot(episodes: Sequence[ReplayedEpisode], path: Path) -> None:
    """Draw confidences, weights and rewards over time, a column for each episode.

    Args:
        episodes: at least one; of more than `MOST_EPISODES` the first ones are drawn.
        path: the image; its ending names the format, such as ``.png`` or ``.svg``.

    Raises:
        MissingExtraError: matplotlib is not installed.
        UsageError: the format is not known.
    """
    save(_drawn(episodes[:MOST_EPISODES]), path)


def save(figure: Figure, path: Path) -> None:
    """Write a figure into a file.

    Args:
        figure: whatever was drawn.
        path: the image; its ending names the format, such as ``.png`` or ``.svg``.

    Raises:
        UsageError: the format is not known.
    """
    kind = path.suffix.lstrip(".").lower()
    known = figure.canvas.get_supported_filetypes()
    if kind not in known:
        raise UsageError(
            f"'{path}' has no image format", name=str(path), suggestion=f"known: {', '.join(known)}"
        )
    with replacing(path) as part:
        figure.savefig(part, format=kind, dpi=120)


def _drawn(shown: Sequence[ReplayedEpisode]) -> Figure:
    rows = {title: values for title, values in _ROWS.items() if values(shown[0].outcomes[0])}
    figure = new_figure(1.5 + 4.5 * len(shown), 2.2 * len(rows))
    grid = figure.subplots(len(rows), len(shown), squeeze=False, sharex="col", sharey="row")
    for axes, (title, values) in zip(grid, rows.items(), strict=True):
        for axis, episode in zip(axes, shown, strict=True):
            _lines(axis, episode, values)
            if title == "reward":
                rewards = [outcome.reward for outcome in episode.outcomes]
                axis.plot(_times(episode), rewards, label="all", color="black", linestyle=":")
        axes[0].set_ylabel(title)
        legend = axes[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
        for label in legend.get_texts():
            label.set_parse_math(False)  # a name with two dollars is no formula
    for axis, episode in zip(grid[0], shown, strict=True):
        ending = episode.episode.ending or "cut short"
        title = f"episode {episode.episode.number}: {visible(ending)}, return {episode.value:.4g}"
        axis.set_title(title, parse_math=False)
    for axis in grid[-1]:
        axis.set_xlabel("time in s")
    return figure


def _lines(axis: Axes, episode: ReplayedEpisode, values: _Values) -> None:
    for name in values(episode.outcomes[0]):
        numbers = [values(outcome)[name] for outcome in episode.outcomes]
        axis.plot(_times(episode), numbers, label=visible(name), linestyle="-")


def _times(episode: ReplayedEpisode) -> list[float]:
    return [step.time for step in episode.episode.steps]
