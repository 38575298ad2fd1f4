"""What may import what, and how light the core is."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
HEAVY = ("torch", "pyreason", "scipy", "gymnasium", "pybullet")


def test_import_sfol_imports_nothing_heavy():
    code = f"import sfol, sys; print([m for m in {HEAVY!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def imported(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.partition(".")[0]


@pytest.mark.parametrize(
    ("package", "never"),
    [("sfol", {"vsr", "env", "pybullet"}), ("vsr", {"env", "pybullet"})],
)
def test_imports_go_in_one_direction(package, never):
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    for path in files:
        assert not never & set(imported(path)), path
