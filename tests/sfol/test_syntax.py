"""Clauses: what is read, what is printed, what is refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfol.clauses import Body, Clause, parse_clause, parse_condition
from sfol.errors import ClauseError
from sfol.facts import Bound, Facts
from sfol.literals import Negated, NotEqual, Positive
from sfol.syntax import Atom, parse_ground_atom, parse_signature

names = st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,6}", fullmatch=True).filter(lambda n: n != "not")
constants = st.from_regex(r"[a-z][A-Za-z0-9_]{0,6}", fullmatch=True).filter(lambda n: n != "not")
atoms = st.builds(Atom, names, st.lists(names, min_size=1, max_size=2).map(tuple))
literals = (
    st.builds(Positive, atoms) | st.builds(Negated, atoms) | st.builds(NotEqual, names, names)
)
bodies = st.builds(Body, st.lists(literals, min_size=1, max_size=6).map(tuple))
ground_atoms = st.builds(Atom, names, st.lists(constants, min_size=1, max_size=2).map(tuple))
bounds = st.tuples(st.floats(0, 1), st.floats(0, 1)).map(lambda p: Bound(min(p), max(p)))


@given(st.builds(Clause, atoms, bodies))
def test_parsing_a_printed_clause_gives_the_clause(clause):
    assert parse_clause(str(clause)) == clause


@given(bodies)
def test_parsing_a_printed_condition_gives_the_condition(body):
    assert parse_condition(str(body)) == body


@given(st.dictionaries(ground_atoms, bounds, max_size=6))
def test_parsing_printed_facts_gives_the_facts(known):
    facts = Facts()
    arity = {}
    for atom, bound in known.items():
        if arity.setdefault(atom.predicate, len(atom.arguments)) == len(atom.arguments):
            facts.add(atom.predicate, *atom.arguments, bound=bound)
    assert Facts.parse(str(facts)) == facts


def test_the_papers_rule():
    clause = parse_clause(
        "safe3(X) :- Vehicle(X), Vehicle(Y), Crosswalk(A), RightOf(Y, X), Occludes(Y, A)."
    )
    assert clause.head == Atom("safe3", ("X",))
    assert clause.body.literals[3] == Positive(Atom("RightOf", ("Y", "X")))


def test_negation_guards_comments_and_free_layout():
    clause = parse_clause("h( X ):-P(X,Y),\n  % a comment\n not Q(Y) , X!=Y # another\n .")
    assert clause.body == Body(
        (Positive(Atom("P", ("X", "Y"))), Negated(Atom("Q", ("Y",))), NotEqual("X", "Y"))
    )


def test_guards_stand_last_wherever_they_were_written():
    body = parse_condition("X != Y, P(X, Y), not Q(Y)")
    assert str(body) == "P(X, Y), not Q(Y), X != Y"
    assert list(map(str, body.atom_literals)) == ["P(X, Y)", "not Q(Y)"]


def test_a_predicate_may_be_called_not():
    assert parse_condition("not(X)").literals == (Positive(Atom("not", ("X",))),)


@pytest.mark.parametrize(
    ("text", "offset", "message"),
    [
        ("h(X)", 4, "':-' is expected where the text ends"),
        ("h(X) :- P(A, B, C, D, E).", 23, "'P' has more than 4 arguments"),
        ("h(X) :- P(X), not.", 17, "a predicate is expected where '.' stands"),
        ("implies :- P.", 0, "'implies' is no predicate without arguments"),
        ("h(X) :- P(X)", 12, "'.' is expected where the text ends"),
        ("h(X) :- P(X), .", 14, "a predicate is expected where '.' stands"),
        ("h(X) :- P(X, Y Z).", 15, "')' is expected where 'Z' stands"),
        ("h() :- P(X).", 2, "an argument is expected where ')' stands"),
        ("h(X) :- P(X). Q(X).", 14, "the end is expected where 'Q' stands"),
        ("h(X) :- P(X) & Q(X).", 13, "the character '&' has no place"),
        ("h(X) :- Pé(X).", 8, "'Pé' is not a name"),
        ("h(X) :- P(X), X != .", 19, "a term is expected where '.' stands"),
        ("h(X) :- P(X), _ != X.", 14, "'_' is a term only of"),
    ],
)
def test_errors_say_where(text, offset, message):
    with pytest.raises(ClauseError) as caught:
        parse_clause(text)
    assert caught.value.offset == offset
    assert message in caught.value.message


def test_a_clause_torn_at_its_comma_is_explained():
    with pytest.raises(ClauseError, match=r'"CenterOf\(p1, ego\)"'):
        parse_ground_atom("CenterOf(p1")


def test_facts_have_no_variables():
    with pytest.raises(ClauseError, match="has a variable, 'X'"):
        parse_ground_atom("P(X)")


def test_parameters_of_a_predicate_are_different_variables():
    assert parse_signature("P(X, Y)") == Atom("P", ("X", "Y"))
    with pytest.raises(ClauseError, match="must be different variables"):
        parse_signature("P(X, X)")
    with pytest.raises(ClauseError, match="must be different variables"):
        parse_signature("P(x)")


def test_a_huge_text_is_refused():
    with pytest.raises(ClauseError, match="characters"):
        parse_condition("P(X), " * 20_000 + "P(X)")
