"""What a user sees without the extra that the street needs."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("module", ["pybullet", "numba", "gymnasium", "scipy", "torch"])
def test_a_missing_extra_gives_one_line_that_names_it(module):
    code = (
        f"import sys; sys.modules['{module}'] = None; sys.argv = ['aeb', 'demo']\n"
        "from env.__main__ import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert done.returncode == 2
    # pybullet itself writes one line when it is imported
    lines = [line for line in done.stderr.splitlines() if "pybullet build time" not in line]
    assert len(lines) == 1, done.stderr
    assert module in lines[0]
    assert "pip install --editable '.[aeb]' in the checkout" in lines[0]
