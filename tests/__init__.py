"""What the software promises; the folders are those of the packages."""

from importlib.util import find_spec

import pytest


def skip_without(extra, *packages):
    """Skip the tests of a module, or of a folder, and say which extra of sfol they lack."""
    missing = [package for package in packages if find_spec(package) is None]
    if missing:
        pytest.skip(f"they need sfol[{extra}]: no {', '.join(missing)}", allow_module_level=True)
