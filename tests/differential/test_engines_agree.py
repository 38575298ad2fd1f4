"""Three readings of one definition: compiled, naive and PyReason, on drawn programs and scenes."""

import pytest
from hypothesis import given, settings

from sfol import Facts, KnowledgeBase
from sfol.engines.compiled import CompiledEngine
from sfol.knowledge_base.loading import bundled_names
from sfol.testing.laws import assert_same
from sfol.testing.naive import naive_conclusions
from sfol.testing.strategies import facts_for, scenes

LEAST_SHARE = 0.6  # of the drawn programs, PyReason grounds all rules of this many itself


def compiled_and_naive_agree(profile):
    @settings(settings.get_profile(profile))
    @given(scenes())
    def agree(scene):
        kb, facts = scene
        assert_same(naive_conclusions(kb, facts), CompiledEngine(kb).conclude(facts).derived)

    agree()


def all_three_agree(profile, pyreason, tally):
    @settings(settings.get_profile(profile))
    @given(scenes(arities=(1, 2), plain=True))
    def agree(scene):
        kb, facts = scene
        engine = pyreason(kb)
        expected = naive_conclusions(kb, facts)
        tally["programs"] += 1
        tally["that concluded something"] += bool(expected)
        tally["grounded by PyReason"] += not engine.grounded_for_pyreason
        tally["with a rule grounded for PyReason"] += bool(engine.grounded_for_pyreason)
        assert_same(expected, CompiledEngine(kb).conclude(facts).derived)
        assert_same(expected, engine.conclude(facts).derived)

    agree()
    assert tally["grounded by PyReason"] >= LEAST_SHARE * tally["programs"]


def test_compiled_and_naive_agree():
    compiled_and_naive_agree("differential")


@pytest.mark.long
def test_compiled_and_naive_agree_on_many():
    compiled_and_naive_agree("differential-long")


def test_all_three_agree(pyreason, tally):
    all_three_agree("differential", pyreason, tally)


@pytest.mark.long
def test_all_three_agree_on_many(pyreason, tally):
    all_three_agree("differential-long", pyreason, tally)


@pytest.mark.parametrize("name", [n for n in bundled_names() if not KnowledgeBase.load(n).timed])
def test_pyreason_accepts_every_bundled_knowledge_base(pyreason, name):
    kb = KnowledgeBase.load(name)
    engine, compiled = pyreason(kb), CompiledEngine(kb)
    assert engine.grounded_for_pyreason == frozenset()
    for case in kb.tests:
        facts = Facts.parse(case.facts, margin=kb.grounding.margin)
        assert_same(compiled.conclude(facts).derived, engine.conclude(facts).derived)

    @settings(settings.get_profile("differential"), max_examples=10)
    @given(facts_for(kb, entities=(kb.subject, "e1", "e2"), max_size=30))
    def agree(facts):
        assert_same(naive_conclusions(kb, facts), compiled.conclude(facts).derived)
        assert_same(naive_conclusions(kb, facts), engine.conclude(facts).derived)

    agree()
