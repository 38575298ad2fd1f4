"""A window that shows the street while somebody drives."""

from __future__ import annotations

import weakref
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from matplotlib import pyplot as plt
from matplotlib.backends.registry import BackendFilter, backend_registry
from matplotlib.image import AxesImage

from sfol.errors import UsageError

_DPI = 80


class Window:
    """Shows pictures as they come; whoever drops it closes it.

    Args:
        title: of the window.

    Raises:
        UsageError: matplotlib has no screen to draw on.
    """

    def __init__(self, title: str) -> None:
        self._title = title
        self._image: AxesImage | None = None
        self._closing: Callable[[], object] = lambda: None
        if plt.get_backend().lower() not in backend_registry.list_builtin(
            BackendFilter.INTERACTIVE
        ):
            raise _no_screen()

    def show(self, picture: npt.NDArray[np.uint8]) -> None:
        """Show an RGB picture, uint8 (H, W, 3); the first one opens the window.

        Raises:
            UsageError: the screen cannot be opened.
        """
        if self._image is None:
            self._image = self._open(picture)
        self._image.set_data(picture)
        plt.pause(1e-3)

    def close(self) -> None:
        """Close the window; a second call does nothing."""
        self._closing()
        self._image = None

    def _open(self, picture: npt.NDArray[np.uint8]) -> AxesImage:
        height, width = picture.shape[:2]
        try:
            figure = plt.figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
        except ImportError as error:  # a backend that was asked for by name, without a screen
            raise _no_screen() from error
        # Closed with its street even if nobody says so; by itself, since titles may be the same.
        self._closing = weakref.finalize(self, plt.close, figure)
        if figure.canvas.manager is not None:
            figure.canvas.manager.set_window_title(self._title)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_axis_off()
        return axes.imshow(picture)


def _no_screen() -> UsageError:
    return UsageError(
        "render_mode can't be 'human': there is no screen for a window",
        name="human",
        suggestion="render_mode='rgb_array'; gymnasium.wrappers.RecordVideo makes a film of it",
    )
