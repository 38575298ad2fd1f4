"""Where the trained weights are: those of the networks, and those of the policy."""

from __future__ import annotations

import os
from pathlib import Path

FOLDER_VARIABLE = "AEB_WEIGHTS"
WHERE_FROM = f"weights come with a checkout; {FOLDER_VARIABLE} names another folder"

_IN_THE_PACKAGE = Path(__file__).parents[1] / "weights"


def weights_folder() -> Path:
    """Return where weights are looked for when nobody names a folder."""
    named = os.environ.get(FOLDER_VARIABLE)
    return Path(named) if named else _IN_THE_PACKAGE
