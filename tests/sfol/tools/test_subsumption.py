"""Subsumption: what the search finds is what trying every substitution finds, or it says so."""

from itertools import product

from hypothesis import given, settings
from hypothesis import strategies as st

from sfol.clauses import parse_clause
from sfol.facts import TRUE, Bound
from sfol.knowledge_base import Rule
from sfol.literals import NotEqual
from sfol.syntax import variables
from sfol.tools.subsumption import compared
from tests.sfol.work import calls


def rule(name, text, threshold=0.0, negation_threshold=0.5, certainty=TRUE):
    return Rule(name, parse_clause(text), "", threshold, negation_threshold, certainty)


def covers_by_trying(general, special):
    """Tell whether some substitution of the general rule's variables makes it part of the other."""
    if general.threshold > special.threshold:
        return False
    if general.negation_threshold > special.negation_threshold:
        return False
    if not (
        general.certainty[0] >= special.certainty[0]
        and general.certainty[1] >= special.certainty[1]
    ):
        return False
    names = variables(*general.clause.head.arguments, *general.clause.body.terms)
    terms = {*special.clause.head.arguments, *special.clause.body.terms}
    wanted = part(special.clause, {})
    return any(
        part(general.clause, values) <= wanted and general.clause.head.substituted(values) == special.clause.head
        for chosen in product(terms, repeat=len(names))
        for values in [dict(zip(names, chosen, strict=True))]
    )  # fmt: skip


def part(clause, values):
    literals = (literal.substituted(values) for literal in clause.body.literals)
    return {
        frozenset(lit.terms) if isinstance(lit, NotEqual) else str(lit) for lit in literals
    }  # a difference has no direction


terms = st.sampled_from(["X", "Y", "Z", "ego"])
atoms = st.builds("{}({})".format, st.sampled_from("PQ"), terms) | st.builds("E({}, {})".format, terms, terms)  # fmt: skip


@st.composite
def rules(draw, name):
    body = ["P(X)", *draw(st.lists(atoms, max_size=4))]
    known = [v for v in ("X", "Y", "Z") if any(v in atom for atom in body)]
    if draw(st.booleans()):
        body.append(f"not {draw(atoms)}")
    if draw(st.booleans()):
        body.append(f"{draw(st.sampled_from(known))} != {draw(st.sampled_from(known))}")
    numbers = st.sampled_from([0.0, 0.5])
    certainty = draw(st.sampled_from([TRUE, TRUE, Bound(0.5, 0.5), Bound(0.5, 1.0)]))
    return rule(name, f"h(X) :- {', '.join(body)}.", draw(numbers), draw(numbers), certainty)


@settings(max_examples=150)
@given(rules("a"), rules("b"))
def test_it_finds_what_trying_every_substitution_finds(first, second):
    found = compared([first, second])
    assert (found.undecided, found.rest) == ((), ())
    if covers_by_trying(first, second):
        assert found.covered == ((first, second),)
    elif covers_by_trying(second, first):
        assert found.covered == ((second, first),)
    else:
        assert found.covered == ()


def test_only_rules_of_one_head_are_compared():
    other = rule("b", "g(X) :- P(X).")
    assert compared([rule("a", "h(X) :- P(X)."), other]).covered == ()


def test_a_spent_budget_is_told():
    texts = ["P(X), E(X, Y)", "P(X), E(Y, X)", "P(X), E(Y, Z)", "Q(X), E(X, X)"]
    several = [rule(f"r{i}", f"h(X) :- {text}.") for i, text in enumerate(texts)]
    assert [(a.name, b.name) for a, b in compared(several).covered] == [("r2", "r0"), ("r2", "r1")]
    few = compared(several, pair_steps=1)
    assert {(a.name, b.name) for a, b in few.undecided} >= {("r0", "r1"), ("r2", "r0")}
    none = compared(several, all_steps=0)
    assert (none.covered, [r.name for r in none.rest]) == ((), ["r0", "r1", "r2"])


def test_all_pairs_of_many_rules_end_with_the_budget():
    """No rule covers another, but any two could: twice the rules are about twice the work."""

    def work(count):
        names = [f"V{i}" for i in range(8)]
        bodies = [
            ", ".join(f"E({a}, {b})" for a, b in zip(names, names[k:] + names[:k], strict=True))
            for k in range(1, 8)
        ]
        several = [
            rule(f"r{i}", f"h(X) :- P(X), {bodies[i % 7]}, E(c{i}, c{i}).") for i in range(count)
        ]
        found = []
        work = calls(lambda: found.append(compared(several, all_steps=2_000)))
        assert len(found[0].rest) > count / 2
        return work

    once, twice = work(100), work(200)
    assert twice < 2.5 * once
