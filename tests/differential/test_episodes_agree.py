"""Time read by the letter, from the whole history, and as episodes remember it."""

import pytest
from hypothesis import given, settings

from sfol import RewardFunction
from sfol.testing.laws import assert_same
from sfol.testing.naive import naive_episode
from sfol.testing.strategies import episodes


def episodes_agree(profile, *, arities=(0, 1, 2, 3), engine="compiled", tally=None):
    @settings(settings.get_profile(profile))
    @given(episodes(arities))
    def agree(drawn):
        kb, steps = drawn
        episode = RewardFunction(kb, engine=engine).episode()
        for facts, expected in zip(steps, naive_episode(kb, steps), strict=True):
            if tally is not None:
                tally["steps"] += 1
                tally["that concluded something"] += bool(expected)
                tally["with operators"] += bool(kb.timed)
            assert_same(expected, episode.conclude(facts).derived)

    agree()


@pytest.mark.filterwarnings("ignore::sfol.errors.SilentZeroWarning")
def test_episodes_and_the_whole_history_agree(tally):
    episodes_agree("differential", tally=tally)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::sfol.errors.SilentZeroWarning")
def test_episodes_and_the_whole_history_agree_on_many():
    episodes_agree("differential-long")


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::sfol.errors.SilentZeroWarning")
def test_pyreason_agrees(pyreason):
    episodes_agree("differential", arities=(1, 2), engine="pyreason")
