"""Where the files are that come with a package: the knowledge bases, the setups."""

from __future__ import annotations

from pathlib import Path


def data_folder(package: Path, name: str) -> Path:
    """Return a folder of bundled files: inside its package in a wheel, beside it in a checkout.

    Args:
        package: the folder of the package that carries it in a wheel.
        name: of the folder, such as ``rules``.
    """
    inside = package / name
    return inside if inside.is_dir() else package.parent / name
