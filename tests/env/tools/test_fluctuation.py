"""`aeb fluctuation`: how calm weights are, and how soon they follow."""

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

import sfol
from env.cli import app
from env.tools.fluctuation import RISE, compare, drives, lateness
from sfol.tools.replay import replay

STEP = 0.1


@pytest.fixture(scope="module")
def log():
    return drives(2, 0, "truth", sfol.KnowledgeBase.load("crossing"))


@pytest.mark.parametrize(
    ("before", "after", "late"),
    [
        ([0, 0.5, 0.5], [0, 0.45, 0.5], [0]),
        ([0, 0.5, 0.5], [0, 0.44, 0.5], [1]),
        ([0.5, 0, 0.5, 0], [0.5, 0, 0.1, 0.2], [0, 2]),
        ([0, 0.04, 0.08], [0, 0, 0], []),
        ([0, 1, 0, 0.5], [0, 0.5, 0.5, 0.5], [3, 0]),
    ],
)
def test_lateness_is_counted_from_each_rise(before, after, late):
    assert lateness(np.array(before, float), np.array(after, float)) == late


def test_steady_is_calmer_and_never_sees_less_danger(log):
    kbs = [sfol.KnowledgeBase.load(name) for name in ("crossing", "steady")]
    before, after = (replay(log, kb) for kb in kbs)
    found = compare(before, after, STEP)
    assert found["safety"].ratio > 3.0
    assert found["efficiency"].ratio > 1.5  # a single dip each, which nothing hides
    assert set(found["safety"].late) == {0}
    for one, other in zip(before, after, strict=True):
        for old, new in zip(one.outcomes, other.outcomes, strict=True):
            assert new.weights["safety"] >= old.weights["safety"] - 1e-12


def test_the_same_rules_are_as_restless(log):
    crossing = replay(log, sfol.KnowledgeBase.load("crossing"))
    for calm in compare(crossing, crossing, STEP).values():
        assert calm.ratio == 1.0
        assert set(calm.late) <= {0}
        assert RISE < calm.means[0] == calm.means[1]


def test_the_command_prints_a_table_and_draws(tmp_path):
    path = tmp_path / "w.png"
    arguments = ["fluctuation", "--episodes", "1", "--perception", "truth", "--plot", str(path)]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert "crossing, variation in 1/s" in done.output
    with Image.open(path) as picture:
        assert picture.size == (840, 504)
    done = CliRunner().invoke(app, ["fluctuation", "--episodes", "1", "--after", "cartpole"])
    assert "have no weight in common" in str(done.exception)
