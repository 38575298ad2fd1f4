"""Replay: a log under a knowledge base, as a table and as a picture."""

import sys
import xml.etree.ElementTree as ET
from dataclasses import replace

import pytest

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.logs import Log, LoggedEpisode, LoggedStep, LogWriter, read_log
from sfol.tools.plotting import plot
from sfol.tools.replay import replay, unknown_names
from tests.sfol.command_line import sfol

NEAR = Facts.parse("Pedestrian(p): 0.8. OnRoad(p). CenterOf(p, ego).")


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "drives.parquet"
    with LogWriter(path, KnowledgeBase.load("aeb")) as log:
        for ending, steps in (("success", 100), ("collision", 3)):
            for step in range(steps):
                log.step(NEAR, step / 10, v=6.0, v_next=6.0 - step / 100, d=9.0)
            log.end_episode(ending)
    return path


def test_a_replay_is_the_sum_of_evaluations(drives):
    kb = KnowledgeBase.load("crossing")
    episodes = replay(read_log(drives), kb)
    reward = RewardFunction(kb)
    expected = [reward(NEAR, v=6.0, v_next=6.0 - step / 100, d=9.0) for step in range(3)]
    assert [outcome.reward for outcome in episodes[1].outcomes] == expected
    assert episodes[1].value == sum(expected)


def test_what_a_knowledge_base_does_not_know_is_left_out(tmp_path):
    kb = KnowledgeBase.load("aeb")
    path = tmp_path / "x.parquet"
    with LogWriter(path, kb) as log:
        log.step(Facts.parse("Pot(p). NoCrosswalk(ego). EmptyLane(ego)."), 0, v=2, v_next=2, w=1)
    log = read_log(path)
    assert unknown_names(log, kb) == ("Pot", "w")
    assert replay(log, kb)[0].outcomes[0].confidences["efficiency1"] == 1.0
    assert "does not know Pot, w; left out" in sfol("replay", path).err


def test_the_table(drives):
    done = sfol("replay", drives)
    assert done.code == 0
    assert "episode 0: success, 100 steps, return" in done.out
    assert "episode 1: collision, 3 steps, return" in done.out
    names = ("signal v_next", "confidence safe1", "weight efficiency", "term comfort", "reward")
    assert all(f"│ {name} " in done.out for name in names)
    assert max(map(len, done.out.splitlines())) <= 200
    assert done.err == ""
    one = sfol("replay", drives, "crossing", "--episode", 1, "--every", 2)
    assert "episode 0" not in one.out
    (line,) = [line for line in one.out.splitlines() if "signal v_next" in line]
    assert [cell.strip() for cell in line.split("│")[2:-1]] == ["6", "5.98"]


@pytest.mark.parametrize("steps", [1, 2, 15, 16, 100])
@pytest.mark.parametrize("every", [None, 1, 7])
def test_the_first_and_the_last_step_are_shown(tmp_path, steps, every):
    """What ends an episode, such as a crash, comes with its last step."""
    path = tmp_path / "x.parquet"
    with LogWriter(path, KnowledgeBase.load("aeb")) as log:
        for step in range(steps):
            log.step(NEAR, float(step), v=float(step), v_next=0.0, d=9.0)
    done = sfol("replay", path, *([] if every is None else ["--every", every]))
    lines = [line for line in done.out.splitlines() if "│ signal v " in line]
    shown = [int(cell) for line in lines for cell in line.split("│")[2:-1]]
    assert max(map(len, done.out.splitlines())) <= 200
    if every is None:
        assert (shown[0], shown[-1], len(lines)) == (0, steps - 1, 1)
        assert len(shown) == steps or shown[1] * 14 >= steps - 1
    else:
        assert shown == sorted({*range(0, steps, every), steps - 1})


@pytest.mark.parametrize("ending", ["png", "svg"])
def test_the_picture(drives, tmp_path, ending):
    path = tmp_path / f"out.{ending}"
    assert sfol("replay", drives, "--plot", path).code == 0
    start = path.read_bytes()[:300]
    assert b"PNG" in start or b"<svg" in start or b"<?xml" in start


@pytest.mark.parametrize("name", ["$x^$", "$\\frac$", "_x", "all", "a\x07b\n", "<!-- -->", "🙂"])
@pytest.mark.filterwarnings("ignore:Glyph")
def test_names_in_a_picture_are_texts(tmp_path, kitchen, name):
    kb = kitchen()
    term = replace(kb.terms["haste"], name=name)
    kb = replace(kb, terms={name: term, "haste": kb.terms["haste"]})
    log = Log(
        "kitchen", "", "", (LoggedEpisode(0, name, (LoggedStep(0.0, Facts(), {"speed": 1.0}),)),)
    )
    plot(replay(log, kb), tmp_path / "x.svg")
    drawn = ET.parse(tmp_path / "x.svg")
    assert drawn.getroot().tag.endswith("svg")


def test_errors(drives, tmp_path, monkeypatch, kitchen):
    assert "the log has no episode 2" in sfol("replay", drives, "--episode", 2).err
    assert "can't be read" in sfol("replay", tmp_path / "none").err
    assert "no image format" in sfol("replay", drives, "--plot", tmp_path / "x.doc").err
    other = tmp_path / "other.parquet"
    with LogWriter(other, kitchen()) as log:
        log.step(Facts(), 0.0, speed=1.0)
    assert "recorded under 'kitchen', which is not bundled" in sfol("replay", other).err
    assert sfol("replay", other, tmp_path / "kitchen.yaml").code == 0
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    done = sfol("replay", drives, "--plot", tmp_path / "x.png")
    assert (done.code, "sfol[plot]" in done.err) == (2, True)


@pytest.mark.parametrize("name", ["{}/kitchen.yaml", "{}/kitchen", "../rules/aeb.yaml", "", "a\0b"])
def test_the_name_in_a_log_is_no_path(tmp_path, kitchen, name):
    kb = replace(kitchen(), name=name.format(tmp_path))
    path = tmp_path / "x.parquet"
    with LogWriter(path, kb) as log:
        log.step(Facts(), 0.0, speed=1.0)
    done = sfol("replay", path)
    assert done.code == 2
    assert "which is not bundled" in done.err


def test_a_knowledge_base_that_changed_is_noted(tmp_path):
    path = tmp_path / "x.parquet"
    kb = KnowledgeBase.load("crossing")
    for recorded, err in (
        (kb, ""),
        (replace(kb, subject="you"), "note: 'crossing' has changed since the recording\n"),
    ):
        with LogWriter(path, recorded) as log:
            log.step(Facts(), 0.0, v=1.0, v_next=1.0)
        assert sfol("replay", path).err == err
