"""The anonymous variable `_`: anybody in a positive literal, nobody at all in a negated one."""

import numpy as np
import pytest

from sfol import Facts, RewardFunction
from sfol.clauses import parse_clause, parse_condition
from sfol.errors import ClauseError
from sfol.literals import Positive
from sfol.syntax import Atom
from sfol.testing.naive import naive_conclusions
from sfol.tools.subsumption import compared
from tests.differential.dense import dense_conclusions
from tests.differential.programs import program

NEAR = "P(ego). P(a). P(b). R(ego, a): [0.1, 0.2]. R(ego, b): [0.05, 0.4]. R(a, b)."
EGO = Atom("h", ("ego",))


def concluded(rule, text, **semantics):
    kb = program(rule, **semantics)
    facts = Facts.parse(text)
    found = dict(RewardFunction(kb).conclude(facts).derived)
    naive = naive_conclusions(kb, facts)
    assert found.keys() == naive.keys()
    for atom, bound in naive.items():
        assert found[atom] == pytest.approx(bound)
    return found


def test_each_one_is_a_variable_of_its_own():
    clause = parse_clause("h(X) :- R(X, _), R(_, _), not S(X, _).")
    arguments = [literal.atom.arguments for literal in clause.body.literals]
    assert arguments == [("X", "_1"), ("_2", "_3"), ("X", "_")]
    assert str(clause) == "h(X) :- R(X, _), R(_, _), not S(X, _)."


def test_anybody_is_enough():
    assert concluded("h(X) :- P(X), R(X, _).", NEAR).keys() == {EGO, Atom("h", ("a",))}


def test_a_negated_one_is_no_more_certain_than_the_strongest_of_all_lets_it_be():
    found = concluded("h(X) :- P(X), not R(X, _).", NEAR, conjunction="minimum")
    assert found == {EGO: pytest.approx((0.6, 0.9)), Atom("h", ("b",)): (1.0, 1.0)}


def test_nobody_at_all():
    rule = "h(X) :- V(X), not P(_), not R(_, _)."
    assert concluded(rule, "V(ego). P(a): [0, 0].") == {EGO: (1.0, 1.0)}
    assert not concluded(rule, "V(ego). R(a, b): 0.9.")


def test_a_derived_predicate_can_be_denied_as_well():
    kb = program("g(X) :- P(X), Q(X).", "h(X) :- V(X), not g(_).")
    reward = RewardFunction(kb)
    facts = [
        Facts.parse(text) for text in ("V(ego). P(a). Q(a): 0.3.", "V(ego). P(a).", "P(a). Q(a).")
    ]
    outcome = reward.evaluate(reward.batch(facts))
    single = [reward.evaluate(each).confidences["h"] for each in facts]
    assert single[:2] == [0.0, 1.0]
    np.testing.assert_allclose(outcome.confidences["h"], single)
    for sorts in (1, 3):
        dense = dense_conclusions(kb, facts, sorts, np.asarray)
        assert [EGO in each for each in dense] == [False, True, False]


def test_gradients_reach_the_strongest():
    torch = pytest.importorskip("torch")
    reward = RewardFunction(program("h(X) :- V(X), not R(X, _)."))
    batch = reward.batch([Facts.parse("V(ego). R(ego, a): [0.1, 0.2]. R(ego, b): [0.1, 0.4].")])
    lower = torch.tensor(batch.lower)
    upper = torch.tensor(batch.upper, requires_grad=True)
    reward.evaluate(batch.with_bounds(lower, upper)).bounds["h"].lower.sum().backward()
    slopes = {str(atom): float(g) for (_, atom), g in zip(batch.atoms, upper.grad, strict=True)}
    assert slopes["R(ego, b)"] == pytest.approx(-0.5)
    assert slopes["R(ego, a)"] == 0.0


@pytest.mark.parametrize(
    ("facts", "line"),
    [
        ("Lid(p): [0.1, 0.2]. Lid(q): [0.1, 0.3].", "not Lid(_) [0.7, 0.9]  asserted"),
        ("", "not Lid(_) [1, 1]  unknown"),
        ("Lid(p): [0.1, 0.2]. Lid(q): [0.7, 0.8].", "lacks not Lid(_) (it is [0.7, 0.8])"),
    ],
)
def test_explanations_print_it(kitchen, facts, line):
    kb = kitchen({"Pot(P), Hot(P), Near(P, X).": "Near(_, X), not Lid(_)."})
    text = str(
        RewardFunction(kb).explain(Facts.parse(f"Near(p, cook). Near(q, cook). {facts}"), speed=1)
    )
    assert "careful(X) :- Person(X), Near(_, X), not Lid(_)." in text or "lacks" in line
    assert line in text
    assert "_1" not in text


def test_it_is_compared_as_what_it_means():
    def covered(general, special):
        kb = program(general, special)
        return [(a.name, b.name) for a, b in compared(kb.rules.values()).covered]

    assert covered("h(X) :- R(X, _).", "h(X) :- R(X, Y), P(Y).") == [("rule0", "rule1")]
    denied = "h(X) :- P(X), Q(Y), not R(X, _)."
    assert covered(denied, "h(X) :- P(X), Q(Y), not R(X, Y).") == []
    assert covered(denied, denied) == [("rule0", "rule1")]


@pytest.mark.parametrize("text", ["h(_) :- P(_).", "h(X) :- P(X), X != _.", "h(X) :- _(X)."])
def test_it_stands_nowhere_else(text):
    with pytest.raises(ClauseError, match="'_'") as caught:
        parse_clause(text)
    assert caught.value.offset == text.rindex("_") or caught.value.offset == text.index("_")


def test_facts_have_none():
    with pytest.raises(ClauseError):
        Facts.parse("R(_, ego).")


def test_a_condition_may_have_it():
    body = parse_condition("P(X), R(X, _)")
    assert body.literals[1] == Positive(Atom("R", ("X", "_1")))
