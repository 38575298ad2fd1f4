"""Facts: bounds, margins, merges, and what is refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfol.errors import ClauseError, FactError, SfolError
from sfol.facts import TRUE, Bound, Facts
from sfol.knowledge_base import KnowledgeBase
from sfol.knowledge_base.loading import bundled_names
from sfol.syntax import Atom


def test_a_margin_makes_a_bound_of_a_confidence():
    facts = Facts(margin=0.05)
    facts.add("Pedestrian", "p1", confidence=0.8)
    assert facts.bound("Pedestrian", "p1") == pytest.approx((0.76, 0.84))


def test_without_a_margin_a_confidence_is_what_it_says():
    facts = Facts()
    facts.add("Pedestrian", "p1", confidence=1.0)
    facts.add("OnRoad", "p1", confidence=0.8)
    assert facts.bound("Pedestrian", "p1") == (1.0, 1.0)
    assert facts.bound("OnRoad", "p1") == (0.8, 0.8)


def test_the_papers_five_percent_stand_in_its_own_file_alone():
    margins = {name: KnowledgeBase.load(name).grounding.margin for name in bundled_names()}
    chains = {name: KnowledgeBase.load(name).files for name in bundled_names()}
    papers = {name for name, files in chains.items() if any("aeb.yaml" in f for f in files)}
    assert "aeb" in papers
    assert margins == {name: 0.05 if name in papers else 0.0 for name in margins}


def test_a_bound_is_cut_at_one():
    facts = Facts(margin=0.1)
    facts.add("Pedestrian", "p1", confidence=0.95)
    assert facts.bound("Pedestrian", "p1") == pytest.approx((0.855, 1.0))


@given(st.floats(0, 1), st.floats(0, 1))
def test_every_confidence_gives_a_bound_around_it(confidence, margin):
    lower, upper = Bound.around(confidence, margin)
    assert 0 <= lower <= confidence <= upper <= 1


def test_without_bound_or_confidence_an_atom_is_true():
    assert Facts.parse("OnRoad(p1).").bound("OnRoad", "p1") == TRUE


def test_text_with_bound_confidence_and_neither():
    facts = Facts.parse(["P(a): [0.2, 0.3]. Q(a): 0.5.", "R(a, b)."], margin=0.1)
    assert facts.bound("P", "a") == (0.2, 0.3)
    assert facts.bound("Q", "a") == pytest.approx((0.45, 0.55))
    assert facts.bound("R", "a", "b") == (1, 1)
    assert len(facts) == 3
    assert facts.entities() == ("a", "b")


def test_an_unknown_atom_has_no_bound():
    facts = Facts.parse("P(a).")
    assert facts.bound("P", "b") is None
    assert ("P", "b") not in facts
    assert ("P", "a") in facts
    assert Atom("P", ("a",)) in facts
    assert "P" not in facts


@pytest.mark.parametrize(
    "pair", [(0.5, 0.4), (-0.1, 0.5), (0.5, 1.1), (math.nan, 1.0), (0, math.nan)]
)
def test_a_bad_bound_is_refused_and_nothing_is_added(pair):
    facts = Facts()
    with pytest.raises(FactError, match=r"P\(a\) has the bound"):
        facts.add("P", "a", bound=pair)
    assert len(facts) == 0
    assert not list(facts.predicates())


@pytest.mark.parametrize("confidence", [-0.1, 1.1, math.nan, math.inf])
def test_a_bad_confidence_is_refused(confidence):
    with pytest.raises(FactError, match="confidence"):
        Facts().add("P", "a", confidence=confidence)


def test_a_bound_and_a_confidence_are_one_too_many():
    with pytest.raises(FactError, match="a bound and a confidence"):
        Facts().add("P", "a", confidence=0.5, bound=(0.5, 0.5))


def test_the_same_assertion_twice_is_fine_and_another_one_is_not():
    facts = Facts.parse("P(a): [0.2, 0.6]. P(a): [0.2, 0.6].")
    with pytest.raises(FactError, match="asserted twice"):
        facts.add("P", "a", bound=(0.3, 0.5))
    facts.add("P", "a", bound=(0.3, 0.5), merge="maximum")
    assert facts.bound("P", "a") == (0.3, 0.6)
    facts.add("P", "a", bound=(0.1, 0.2), merge="replace")
    assert facts.bound("P", "a") == (0.1, 0.2)
    with pytest.raises(FactError, match="'maximun' is no merge"):
        facts.add("P", "a", bound=(0.3, 0.5), merge="maximun")


@pytest.mark.parametrize("constants", [("Ego",), ("1a",), ("a b",), ("",), ("a",) * 5, ("a", "B")])
def test_malformed_constants_are_refused(constants):
    with pytest.raises(FactError):
        Facts().add("P", *constants)


def test_one_predicate_has_one_arity():
    facts = Facts.parse("P(a).")
    with pytest.raises(FactError, match="2 constants here and 1 elsewhere"):
        facts.add("P", "a", "b")


def test_a_fact_that_is_no_fact():
    with pytest.raises(ClauseError, match=r"'\.' is expected"):
        Facts.parse("P(a)")


def test_copies_are_independent_and_about_selects():
    facts = Facts.parse("P(a). Q(a, b). P(c).")
    twin = facts.copy()
    twin.add("P", "d")
    assert len(facts) == 3
    assert set(map(str, facts.about("a"))) == {"P(a)", "Q(a, b)"}


def test_what_is_about_an_entity_keeps_its_bounds():
    facts = Facts.parse("Pot(p): 0.5. Near(q, p): [0.1, 0.2]. Pot(q).", margin=0.1)
    assert facts.about("p") == Facts.parse("Pot(p): [0.45, 0.55]. Near(q, p): [0.1, 0.2].")
    assert facts.about("p").margin == 0.1


def test_what_is_not_known_is_not_there():
    facts = Facts.parse("Pot(p).")
    assert facts.bound("Lid", "p") is None
    assert facts.bound("Pot", "q") is None
    assert ("Pot", "p") in facts
    assert Atom("Pot", ("p",)) in facts
    for other in (("Lid", "p"), ("Pot", "q"), (), "Pot", ["Pot", "p"], None):
        assert other not in facts


def test_facts_are_equal_to_facts_alone():
    facts = Facts.parse("Pot(p).")
    assert facts == Facts.parse("Pot(p).", margin=0.5)
    assert facts != Facts.parse("Pot(p): [0.5, 1.0].")
    assert facts != dict(facts.items())


@pytest.mark.parametrize(
    ("refused", "name", "suggestion"),
    [
        (lambda known: Facts(margin=2), "the margin", "a number between 0 and 1"),
        (lambda known: Facts.parse(3), "facts", "give a text, or a list of texts"),
        (lambda known: Bound.around(2, 0.05), "a bound: the confidence", "between 0 and 1"),
        (lambda known: Bound.around(0.5, 2), "a bound: the margin", "between 0 and 1"),
        (lambda known: Bound.checked(0.5, 0.4), "a bound", "0 ≤ lower ≤ upper ≤ 1"),
        (lambda known: known.add("Q", "a", bound=(None, 1)), "Q(a)", "give a single number"),
        (lambda known: known.add("Q", "a", bound=(0.5,)), "Q(a)", "(lower, upper)"),
        (lambda known: known.add("R", "a", "b", bound=(0.5, 2)), "R(a, b)", "lower ≤ upper ≤ 1"),
        (lambda known: known.add("Q", "a", bound=(0, 1), confidence=1), "Q(a)", "one of them"),
        (lambda known: known.add("P", "a"), "P(a)", "merge='replace' or merge='maximum'"),
        (lambda known: known.add("P", "a", merge="maximun"), "maximun", "mean 'maximum'?"),
        (lambda known: known.add("Q", *"abcde"), "Q", "an atom has 4 at most"),
        (lambda known: known.add("Q", "Ego"), "Ego", "begins with a lower-case letter"),
        (lambda known: known.add("Q q", "a"), "Q q", None),
        (lambda known: known.add("P", "a", "b"), "P", None),
        (lambda known: known.about(3), "an entity", "give its name"),
        (lambda known: known.relation(3), "a predicate", "give its name"),
    ],
)
def test_what_is_refused_is_named_with_what_to_do_instead(refused, name, suggestion):
    with pytest.raises(SfolError) as caught:
        refused(Facts.parse("P(a): [0.2, 0.6]."))
    assert name in caught.value.message
    assert caught.value.name == name
    assert suggestion is None or suggestion in caught.value.suggestion
