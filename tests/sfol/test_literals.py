"""What every kind of body literal must answer, whichever kinds there are."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfol.clauses import Body, parse_clause, parse_condition
from sfol.engines.tables import Tables
from sfol.errors import KnowledgeBaseError
from sfol.facts import TRUE, Facts
from sfol.knowledge_base import Rule
from sfol.literals import KINDS, AtomLiteral, Literal, Negated, NotEqual, Positive
from sfol.syntax import Atom, Reader, is_variable
from sfol.testing.strategies import LITERALS, bounds

ATTRIBUTES = ("Weight", "Gap")  # of which drawn literals speak
every_kind = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
strangers = (Positive(Atom("Strange", ("X",))), NotEqual("strange", "X"))


def some(kind):
    """Literals of one kind; a body may have none of it, so those of several bodies."""
    bodies = st.lists(LITERALS[kind](["Calm", "Near"], ["X", "Y", "Z"]), min_size=4, max_size=8)
    return bodies.map(lambda drawn: [literal for literals in drawn for literal in literals])


def test_every_kind_can_be_drawn():
    assert set(LITERALS) == set(KINDS)


@every_kind
@settings(max_examples=20)
@given(data=st.data())
def test_what_is_printed_is_read_as_the_same_literal(kind, data):
    for literal in data.draw(some(kind)):
        assert kind.parse(Reader(str(literal), ATTRIBUTES)) == literal
        assert parse_condition(str(literal), ATTRIBUTES) == Body((literal,))


@every_kind
@settings(max_examples=20)
@given(data=st.data())
def test_a_literal_matches_its_instances_and_no_stranger(kind, data):
    for literal in data.draw(some(kind)):
        values = {term: f"{term.lower()}1" for term in literal.terms if is_variable(term)}
        instance = literal.substituted(values)
        assert not any(map(is_variable, instance.terms))
        assert literal.matched(instance, values) == values
        assert all(literal.matched(stranger, values) is None for stranger in strangers)


@every_kind
@settings(max_examples=20)
@given(data=st.data(), known=bounds(), threshold=st.sampled_from([0.0, 0.5, 1.0]))
def test_a_literal_that_holds_has_its_own_bound(kind, data, known, threshold):
    rule = Rule("r", parse_clause("h(X) :- Calm(X)."), "", threshold, threshold)
    for literal in data.draw(some(kind)):
        if isinstance(literal, AtomLiteral):
            for reading in (literal.holds(rule), literal.reaches(threshold)):
                assert reading(known) in (None, literal.bound(known))


def test_a_guard_keeps_what_has_no_value():
    guard = NotEqual("X", "ada")
    assert guard.substituted({"X": "bob"}) == NotEqual("bob", "ada")
    assert guard.substituted({}) == guard


RULE = Rule("r", parse_clause("h(X) :- Calm(X)."), "", 0.5, 0.25)


def test_an_atom_as_pyreason_says_it_counts_from_its_threshold():
    for literal, threshold in (
        (Positive(Atom("Near", ("X", "Y"))), 0.5),
        (Positive(Atom("Near", ("X", "Y")), 0.75), 0.75),
        (Negated(Atom("Near", ("X", "Y"))), 0.25),
    ):
        said = literal.query(RULE)
        assert said.terms == ("X", "Y")
        assert said.threshold == pytest.approx(threshold)
        assert said.counts
        assert not said.symmetric


def test_a_guard_as_pyreason_says_it_does_not_count_and_has_no_direction():
    said = NotEqual("X", "Y").query(RULE)
    assert said.terms == ("X", "Y")
    assert said.threshold == 1.0
    assert not said.counts
    assert said.symmetric


def test_pyreason_is_given_rows_for_what_it_has_no_words_for():
    scene, domain = Tables.of(Facts.parse("Near(ada, bob): [0.25, 0.5].")), ("ada", "bob")
    assert Negated(Atom("Near", ("X", "Y"))).query_rows(scene, domain) == {
        ("ada", "ada"): TRUE,
        ("ada", "bob"): (0.5, 0.75),
        ("bob", "ada"): TRUE,
        ("bob", "bob"): TRUE,
    }
    different = {("ada", "bob"): TRUE, ("bob", "ada"): TRUE}
    assert NotEqual("X", "Y").query_rows(scene, domain) == different


def test_a_kind_that_pyreason_has_no_words_for_is_refused_by_its_text():
    with pytest.raises(KnowledgeBaseError, match="can't express the literal 'X != Y'") as caught:
        Literal.query(NotEqual("X", "Y"), RULE)
    assert caught.value.name == "X != Y"
    assert "engine='compiled'" in caught.value.suggestion
