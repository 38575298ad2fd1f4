"""What every kind of body literal must answer, whichever kinds there are."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfol.clauses import Body, parse_clause, parse_condition
from sfol.knowledge_base import Rule
from sfol.literals import KINDS, AtomLiteral, NotEqual, Positive
from sfol.syntax import Atom, Reader, is_variable
from sfol.testing.strategies import LITERALS, bounds

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
        assert kind.parse(Reader(str(literal))) == literal
        assert parse_condition(str(literal)) == Body((literal,))


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
