"""Draws replayed episodes over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sfol.errors import UsageError, missing_extra
from sfol.outcome import Outcome
from sfol.tools.replay import ReplayedEpisode
from sfol.writing import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_EPISODES = 8

_ROWS: Mapping[str, Callable[[Outcome], Mapping[str, float]]] = {
    "confidence": lambda outcome: outcome.confidences,
    "weight": lambda outcome: outcome.weights,
    "reward": lambda outcome: {**outcome.terms, "all": outcome.reward},
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
    shown = episodes[:MOST_EPISODES]
    rows = {title: values for title, values in _ROWS.items() if values(shown[0].outcomes[0])}
    figure = new_figure(1.5 + 4.5 * len(shown), 2.2 * len(rows))
    grid = figure.subplots(len(rows), len(shown), squeeze=False, sharex="col", sharey="row")
    for axes, (title, values) in zip(grid, rows.items(), strict=True):
        for axis, episode in zip(axes, shown, strict=True):
            _lines(axis, episode, values)
        axes[0].set_ylabel(title)
        axes[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
    for axis, episode in zip(grid[0], shown, strict=True):
        ending = episode.episode.ending or "cut short"
        axis.set_title(f"episode {episode.episode.number}: {ending}, return {episode.value:.4g}")
    for axis in grid[-1]:
        axis.set_xlabel("time in s")
    kind = path.suffix.lstrip(".").lower()
    known = figure.canvas.get_supported_filetypes()
    if kind not in known:
        raise UsageError(
            f"'{path}' has no image format", name=str(path), suggestion=f"known: {', '.join(known)}"
        )
    with replacing(path) as part:
        figure.savefig(part, format=kind, dpi=120)


def _lines(
    axis: Axes, episode: ReplayedEpisode, values: Callable[[Outcome], Mapping[str, float]]
) -> None:
    times = [step.time for step in episode.episode.steps]
    for name in values(episode.outcomes[0]):
        whole = name == "all"
        axis.plot(
            times,
            [values(outcome)[name] for outcome in episode.outcomes],
            label=name,
            color="black" if whole else None,
            linestyle=":" if whole else "-",
        )
