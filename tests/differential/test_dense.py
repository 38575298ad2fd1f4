"""The dense engine gives what the compiled one gives, and the definition by the letter."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfol import Facts, KnowledgeBase
from sfol.engines.program import Program
from sfol.knowledge_base.loading import bundled_names
from sfol.testing.naive import naive_conclusions
from sfol.testing.strategies import facts_for, scenes
from tests.differential.dense import asked, dense_conclusions
from tests.differential.programs import SMALL

TOLERANCE = 1e-9


def assert_agree(kb, facts, sorts, make=np.asarray):
    program, heads = Program.of(kb), set(kb.heads)
    found = dense_conclusions(kb, facts, sorts, make)
    for scene, conclusions in zip(facts, found, strict=True):
        expected = {
            # What is asserted of a head stays known without a rule that fires.
            **{atom: (1.0, 1.0) for atom in kb.background if atom.predicate in heads},
            **{atom: bound for atom, bound in scene.items() if atom.predicate in heads},
            **naive_conclusions(kb, scene),
        }
        expected = asked(program, expected, scene)
        concluded = asked(program, conclusions, scene)
        assert concluded.keys() == expected.keys()
        for atom, bound in expected.items():
            assert concluded[atom] == pytest.approx(tuple(bound), abs=TOLERANCE), atom


@pytest.mark.parametrize("sorts", [1, 2, 3])
@pytest.mark.parametrize(("kb", "facts"), SMALL)
def test_small_programs(kb, facts, sorts):
    assert_agree(kb, [facts, Facts(), facts], sorts)


def drawn(profile, make=np.asarray, **changes):
    @settings(settings.get_profile(profile), **changes)
    @given(scenes(), st.integers(1, 4))
    def agree(scene, sorts):
        kb, facts = scene
        less = Facts()
        for atom, bound in list(facts.items())[::2]:
            less.add(atom.predicate, *atom.arguments, bound=bound)
        for attribute, values in facts.values().items():
            for constants, value in list(values.items())[::2]:
                less.add(attribute, *constants, value=value)
        assert_agree(kb, [facts, less], sorts, make)

    agree()


def test_dense_and_naive_agree():
    drawn("differential")


@pytest.mark.long
def test_dense_and_naive_agree_on_many():
    drawn("differential-long")


def test_dense_of_tensors_and_naive_agree():
    torch = pytest.importorskip("torch")
    drawn("differential", torch.as_tensor, max_examples=50)


@pytest.mark.parametrize("name", [n for n in bundled_names() if not KnowledgeBase.load(n).timed])
def test_every_bundled_knowledge_base(name):
    kb = KnowledgeBase.load(name)

    @settings(settings.get_profile("differential"), max_examples=20)
    @given(
        st.lists(
            facts_for(kb, entities=(kb.subject, "e1", "e2"), max_size=30), min_size=1, max_size=3
        )
    )
    def agree(facts):
        assert_agree(kb, facts, 2)

    agree()
