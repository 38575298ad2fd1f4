"""Time read by the letter, from the whole history, and as episodes remember it."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.errors import KnowledgeBaseError
from sfol.knowledge_base.loading import bundled_names
from sfol.testing.laws import assert_same
from sfol.testing.naive import naive_episode
from sfol.testing.strategies import episodes, facts_for


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


@pytest.mark.parametrize("name", [n for n in bundled_names() if KnowledgeBase.load(n).timed])
def test_every_bundled_knowledge_base_over_time(name):
    kb = KnowledgeBase.load(name)
    scenes = facts_for(kb, entities=(kb.subject, "e1"), max_size=12)

    @settings(settings.get_profile("differential"), max_examples=20)
    @given(st.lists(scenes, min_size=1, max_size=3), st.integers(1, 15))
    def agree(several, times):
        steps = [facts for facts in several for _ in range(times)]
        episode = RewardFunction(kb).episode()
        for facts, expected in zip(steps, naive_episode(kb, steps), strict=True):
            assert_same(expected, episode.conclude(facts).derived)

    agree()


def test_pyreason_agrees_by_hand(pyreason):
    kb = KnowledgeBase.load("steady")
    scenes = [
        "Pedestrian(p1): 0.8. OnRoad(p1). CenterOf(p1, ego).",
        "NoCrosswalk(ego). EmptyLane(ego).",
        "",
        "Truck(t1): 0.9. Crosswalk(a1). RightOf(t1, ego). Occludes(t1, a1).",
    ]
    both = [RewardFunction(kb, engine=name).episode() for name in ("compiled", "pyreason")]
    for facts in map(Facts.parse, scenes):
        one, other = (episode.conclude(facts) for episode in both)
        assert one.derived
        assert_same(one.derived, other.derived)
        assert one.memory.weights == pytest.approx(other.memory.weights)


def test_a_program_for_pyreason_alone_is_refused():
    with pytest.raises(
        KnowledgeBaseError, match="has no memory, and 'steady' says 'once'"
    ) as caught:
        KnowledgeBase.load("steady").to_pyreason(Facts())
    assert "engine='pyreason'" in caught.value.suggestion
