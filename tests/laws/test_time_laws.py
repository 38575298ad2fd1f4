"""Laws of time, on drawn knowledge bases and episodes."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sfol import RewardFunction
from sfol.clauses import parse_clause
from sfol.knowledge_base import KnowledgeBase
from sfol.temporal import Latched, Memory, Since, steps_of
from sfol.testing.laws import assert_same
from sfol.testing.strategies import ENTITIES, episodes, facts_for, timed_knowledge_bases

pytestmark = pytest.mark.filterwarnings("ignore::sfol.errors.SilentZeroWarning")
on_drawn = settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


def concluded(kb, steps, memory=None):
    episode = RewardFunction(kb).episode()
    if memory is not None:
        episode.memory = memory
    return [episode.conclude(facts).derived for facts in steps]


def looks_back(kb: KnowledgeBase) -> int:
    """Return how many steps back something can still count; all windows may add up."""
    bodies = [rule.clause.body for rule in kb.rules.values()]
    return sum(1 + steps_of(n.operator.duration or 0.0, 0.25) for b in bodies for n in b.timed)


def forgets(kb: KnowledgeBase) -> bool:
    return not any(isinstance(n.operator, Since | Latched) for n in kb.timed)


@on_drawn
@given(episodes(), st.integers(1, 1_000_000))
def test_an_episode_that_begins_later_is_the_same(drawn, later):
    kb, steps = drawn
    for now, then in zip(
        concluded(kb, steps), concluded(kb, steps, Memory(step=later)), strict=True
    ):
        assert_same(now, then)


@st.composite
def two_pasts(draw):
    """Draw a knowledge base that forgets, two different pasts, and what comes after both."""
    kb = draw(timed_knowledge_bases().filter(forgets))
    scenes = st.lists(facts_for(kb, ENTITIES[:2], max_size=8), max_size=4)
    ending = draw(st.lists(facts_for(kb, ENTITIES[:2], max_size=8), min_size=1, max_size=3))
    return kb, draw(scenes), draw(scenes), ending


@on_drawn
@given(two_pasts())
def test_what_is_older_than_all_windows_no_longer_counts(drawn):
    kb, one, other, ending = drawn
    between = [ending[0]] * looks_back(kb)
    after = [concluded(kb, [*past, *between, *ending])[-1] for past in (one, other)]
    assert_same(*after)


@on_drawn
@given(episodes(), st.integers(0, 8))
def test_an_episode_goes_on_from_any_step(drawn, cut):
    kb, steps = drawn
    episode = RewardFunction(kb).episode()
    for facts in steps[:cut]:
        episode.conclude(facts)
    rest = concluded(kb, steps[cut:], episode.memory)
    for found, expected in zip(rest, concluded(kb, steps)[cut:], strict=True):
        assert_same(found, expected)


@on_drawn
@given(episodes())
def test_facts_of_a_step_are_not_changed(drawn):
    kb, steps = drawn
    before = [facts.copy() for facts in steps]
    concluded(kb, steps)
    assert steps == before


@on_drawn
@given(timed_knowledge_bases())
def test_printed_rules_over_time_are_the_rules(kb):
    for rule in kb.rules.values():
        assert parse_clause(str(rule.clause), kb.attributes) == rule.clause
