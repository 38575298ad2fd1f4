"""Literals that ask for a bound: `P(X) >= 0.5`."""

import pytest

from sfol import Facts, RewardFunction
from sfol.clauses import parse_clause
from sfol.errors import ClauseError
from sfol.syntax import Atom
from sfol.testing.naive import naive_conclusions
from sfol.tools.lint import lint
from sfol.tools.subsumption import compared
from tests.differential.programs import program


def bound_of(text, rule="h(X) :- P(X), Q(Y) >= 0.5."):
    kb, facts = program(rule), Facts.parse(text)
    found = RewardFunction(kb).evaluate(facts).bounds["h"]
    assert found == naive_conclusions(kb, facts).get(Atom("h", ("ego",)))
    return found


def test_what_is_less_certain_supports_nothing():
    assert bound_of("P(ego). Q(a): [0.49, 1].") is None
    assert bound_of("P(ego): 0. Q(a): [0.5, 0.5].") is None


def test_its_own_bound_takes_part():
    assert bound_of("P(ego). Q(a): [0.5, 0.7]. Q(b): [0.1, 0.9].") == pytest.approx((0.75, 0.85))


def test_the_greater_of_two_thresholds_counts():
    kb = program({"rule": "h(X) :- P(X) >= 0.2.", "threshold": 0.6})
    reward = RewardFunction(kb)
    assert reward.evaluate(Facts.parse("P(ego): [0.5, 1].")).bounds["h"] is None
    assert reward.evaluate(Facts.parse("P(ego): [0.6, 1].")).bounds["h"] == (0.6, 1.0)


def test_it_is_printed_as_it_is_read():
    text = "h(X) :- P(X) >= 0.5, R(X, _) >= 1, not Q(X)."
    assert str(parse_clause(text)) == text


@pytest.mark.parametrize(
    ("text", "message", "at"),
    [
        ("h(X) :- P(X) >= 1.5.", "a bound can't be 1.5", "1.5"),
        ("h(X) :- P(X), not Q(X) >= 0.5.", "'.' is expected where '>=' stands", ">="),
        ("h(X) :- P(X) >= Y.", "a number is expected where 'Y' stands", "Y."),
        ("h(X) >= 0.5 :- P(X).", "':-' is expected where '>=' stands", ">="),
    ],
)
def test_what_asks_for_something_else_is_refused(text, message, at):
    with pytest.raises(ClauseError, match=message.replace(".", r"\.")) as caught:
        parse_clause(text)
    assert caught.value.offset == text.index(at)


def test_explanations_say_what_was_asked(kitchen):
    kb = kitchen({"Hot(P),": "Hot(P) >= 0.5,"})
    reward = RewardFunction(kb)
    facts = "Pot(p). Near(p, cook). Hot(p): [{}, 1]."
    missed = str(reward.explain(Facts.parse(facts.format(0.3)), speed=1))
    assert "lacks Hot(p) >= 0.5 (its [0.3, 1] is below the threshold 0.5)" in missed
    assert "Hot(p) >= 0.5 [0.6, 1]  asserted" in str(
        reward.explain(Facts.parse(facts.format(0.6)), speed=1)
    )


def test_a_rule_that_asks_for_less_covers_one_that_asks_for_more():
    kb = program("h(X) :- P(X) >= 0.3.", "h(X) :- P(X) >= 0.5, Q(X).", "h(X) :- P(X) >= 0.2, V(X).")
    assert [(a.name, b.name) for a, b in compared(kb.rules.values()).covered] == [
        ("rule0", "rule1")
    ]


def test_lint_knows_what_it_excludes():
    def codes(rule):
        return {finding.code for finding in lint(program(rule)) if finding.path[0] == "rules"}

    assert "SF001" in codes("h(X) :- P(X) >= 0.8, not P(X).")
    assert "SF002" in codes("h(X) :- P(X) >= 0.3, not P(X).")
