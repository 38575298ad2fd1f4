"""What supports a body is what all its substitutions name, found without walking through them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.clauses import parse_clause
from sfol.engines.plan import Plan
from sfol.engines.tables import Tables
from sfol.facts import Bound
from sfol.literals import Negated

ONE_PIECE = [
    "h(X) :- A(X).",
    "h(X) :- A(X), P(X, Y), B(Y).",
    "h(X) :- P(X, Y), A(Y), Q(Y, Z).",
]
FALLS_APART = [
    "h(X) :- P(X, Y), Q(X, Z).",
    "h(X) :- A(Y), B(Z), P(X, W).",
    "h(X) :- P(X, Y), Q(Y, Z), P(Z, W), B(W).",
    "h(X) :- P(X, Y), Q(X, Z), Q(Y, V), P(Y, W), B(W).",
    "h(X) :- A(X), P(X, Y), not Q(X, Y), Q(Z, X), Z != X.",
    "h(X) :- P(X, Y), Q(X, Z), Y != Z.",
    "h(X) :- P(X, Y), Q(Y, Z), P(Z, X), A(V), not B(X).",
    "h(X) :- B(ada), P(X, Y), Q(bob, Z).",
]

names = st.sampled_from(["ego", "ada", "bob", "cy"])
bounds = st.sampled_from([Bound(0.0, 0.0), Bound(0.2, 0.6), Bound(0.5, 1.0), Bound(1.0, 1.0)])
unary = st.dictionaries(st.tuples(st.sampled_from("AB"), names), bounds, max_size=8)
binary = st.dictionaries(st.tuples(st.sampled_from("PQ"), names, names), bounds, max_size=24)


FLAT = [
    "h(X) :- A(X).",
    "h(X) :- A(X), B(X), P(X, ego), Q(X, X).",
    "h(X) :- A(X), A(X), B(Y).",
    "h(X) :- A(Y), B(Y), P(Y, X), Q(X, Y), P(Y, bob).",
    "h(X) :- B(ada), P(ada, Y), A(Y), Q(X, ego).",
]
NOT_FLAT = [
    "h(X) :- A(X), P(X, Y).",  # no unary literal has Y
    "h(X) :- A(Y), P(Y, Y).",
    "h(X) :- A(Y), B(Z).",
    "h(X) :- A(Y), not B(Y).",
    "h(X) :- A(Y), Y != X.",
]


def criterion(literal):
    if isinstance(literal, Negated):
        return lambda known: literal.bound(known) if known.upper < 0.5 else None
    return lambda known: known if known.upper > 0.0 else None


def plan_of(text, *known):
    return Plan.of(parse_clause(text).body, criterion, known)


@pytest.mark.parametrize("text", ONE_PIECE)
def test_a_body_in_one_piece_is_searched_as_it_is(text):
    assert not plan_of(text, "X").branches


@pytest.mark.parametrize("text", FALLS_APART)
def test_a_body_that_falls_apart_is_told_from_others(text):
    # Y and Z of the one with a guard between them belong together.
    assert plan_of(text, "X").branches == ("Y != Z" not in text)


@pytest.mark.parametrize("text", [*ONE_PIECE, *FALLS_APART])
@given(unary=unary, binary=binary)
def test_the_support_is_what_all_substitutions_name(text, unary, binary):
    facts = Facts()
    for atom, bound in {**unary, **binary}.items():
        facts.add(*atom, bound=bound)
    tables = Tables.of(facts)
    for known, values in (([], []), (["X"], ["ego"])):
        plan, expected = plan_of(text, *known), {}
        plan.search(
            tables,
            lambda s, e=expected: e.update(zip(enumerate(s.keys), s.bounds, strict=True)),
            values,
        )
        assert plan.support(tables, values) == expected


@pytest.mark.parametrize("text", FLAT)
@given(unary=unary, binary=binary)
def test_the_bounds_of_a_flat_body_are_those_of_its_support(text, unary, binary):
    facts = Facts()
    for atom, bound in {**unary, **binary}.items():
        facts.add(*atom, bound=bound)
    tables = Tables.of(facts)
    plan = plan_of(text, "X")
    assert plan.is_flat
    for value in ("ego", "ada"):
        expected = plan.support(tables, [value]).values()
        assert sorted(plan.bounds(tables, [value])) == sorted(expected)


@pytest.mark.parametrize("text", NOT_FLAT)
def test_a_body_that_one_loop_does_not_settle_is_not_flat(text):
    assert not plan_of(text, "X").is_flat


CROWD = """
version: 1
name: crowd
subject: ego
predicates:
  LeftOf(X, Y): X is left of Y.
  RightOf(X, Y): X is right of Y.
  CenterOf(X, Y): X is ahead of Y.
  crowded(X): There are people on all sides of X.
rules: {crowded: "crowded(X) :- LeftOf(A, X), RightOf(B, X), CenterOf(C, X)."}
semantics: {conjunction: average}
signals: {v: {unit: m/s}}
weights: {care: {normalizer: 1, coefficients: {crowded: 1.0}}}
terms: {care: {weight: care, formula: -v}}
"""


def test_a_body_with_more_substitutions_than_could_be_walked_is_concluded(tmp_path):
    path = tmp_path / "crowd.yaml"
    path.write_text(CROWD)
    people = 3000  # 27 thousand million substitutions
    facts = Facts()
    for i in range(people):
        facts.add("LeftOf", f"l{i}", "ego", bound=(0.0, 0.4))
        facts.add("RightOf", f"r{i}", "ego", bound=(0.3, 0.6))
        facts.add("CenterOf", f"c{i}", "ego", bound=(0.6, 0.8))
    outcome = RewardFunction(KnowledgeBase.load(path)).evaluate(facts, v=1.0)
    assert outcome.bounds["crowded"] == pytest.approx((0.3, 0.6))
