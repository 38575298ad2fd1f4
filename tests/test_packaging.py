"""What an installation has: a wheel the logic alone, a checkout the street and the descriptor too."""

import os
import subprocess
import sys
import zipfile
from configparser import ConfigParser
from pathlib import Path

import pytest

pytest.importorskip("hatchling", reason="a wheel is built with hatchling, of the extra dev")

ROOT = Path(__file__).parents[1]
OURS = "OURS = 'the package of whoever installs sfol'\n"


def run(*command, **options):
    done = subprocess.run(command, capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def build(kind, folder):
    run(sys.executable, "-m", "hatchling", "build", "-t", f"wheel:{kind}", "-d", folder, cwd=ROOT)
    (wheel,) = folder.glob("*.whl")
    return wheel


def entry_points(wheel):
    with zipfile.ZipFile(wheel) as files:
        (name,) = (name for name in files.namelist() if name.endswith("/entry_points.txt"))
        found = ConfigParser()
        found.read_string(files.read(name).decode())
    return {group: [*found[group]] for group in found.sections()}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    return build("standard", tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def site(wheel, tmp_path_factory):
    """A folder of packages that had an `env` and a `vsr` before sfol came."""
    pytest.importorskip("pip", reason="the wheel is installed with pip")
    site = tmp_path_factory.mktemp("site")
    for name in ("env", "vsr"):
        (site / name).mkdir()
        (site / name / "__init__.py").write_text(OURS)
    options = ("--quiet", "--no-deps", "--no-index", "--upgrade", "--target", site)
    run(sys.executable, "-m", "pip", "install", *options, wheel)
    return site


def in_site(site, folder, *command):
    return run(*command, cwd=folder, env={**os.environ, "PYTHONPATH": str(site)})


def test_a_wheel_has_one_package_and_one_command(wheel):
    with zipfile.ZipFile(wheel) as files:
        top = {name.partition("/")[0] for name in files.namelist()}
    assert top == {"sfol", wheel.name.removesuffix("-py3-none-any.whl") + ".dist-info"}
    assert entry_points(wheel) == {"console_scripts": ["sfol"]}


def test_a_checkout_has_the_street_and_no_copy_of_the_rules(tmp_path):
    wheel = build("editable", tmp_path)
    with zipfile.ZipFile(wheel) as files:
        assert not [name for name in files.namelist() if name.endswith(".yaml")]
        (paths,) = (name for name in files.namelist() if name.endswith(".pth"))
        assert files.read(paths).decode().strip() == str(ROOT)
    assert entry_points(wheel) == {
        "console_scripts": ["sfol", "aeb"],
        "sfol.grounding": ["segmentation"],
    }


def test_packages_of_the_same_names_stay_as_they_were(site, tmp_path):
    code = "import env, vsr, sfol; print(env.OURS == vsr.OURS, sfol.__file__)"
    same, file = in_site(site, tmp_path, sys.executable, "-c", code).split(maxsplit=1)
    assert same == "True"
    assert Path(file.strip()).parent == site / "sfol"
    assert {path.read_text() for path in site.glob("[ev]*/__init__.py")} == {OURS}
    assert [path.name for path in (site / "bin").iterdir()] == ["sfol"]


@pytest.mark.parametrize("command", ["check", "test"])
@pytest.mark.parametrize("name", ["aeb", "cartpole", "ablations/pe_cs"])
def test_the_command_of_a_wheel_knows_the_bundled_knowledge_bases(site, tmp_path, command, name):
    done = in_site(site, tmp_path, site / "bin" / "sfol", command, name)
    assert name in done


def test_a_wheel_rewards_and_begins_new_files(site, tmp_path):
    code = "import sfol; print(sfol.RewardFunction('aeb')(sfol.Facts(), v=1, v_next=1, d=9))"
    assert float(in_site(site, tmp_path, sys.executable, "-c", code)) == 0.0
    in_site(site, tmp_path, site / "bin" / "sfol", "init", "mine.yaml")
    assert "0 failed" in in_site(site, tmp_path, site / "bin" / "sfol", "test", "mine.yaml")
