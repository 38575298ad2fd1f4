"""`or` and `implies` in bodies: a rule for each way in which a body can hold."""

import json
from dataclasses import replace

import pytest

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.clauses import parse_clause, parse_condition, parse_conditions, parse_rule
from sfol.connectives import MAXIMUM_WAYS
from sfol.errors import ClauseError, InvalidKnowledgeBase
from sfol.knowledge_base.formatting import format_clause
from sfol.knowledge_base.printing import to_yaml
from sfol.syntax import Atom
from sfol.testing.cases import run_tests
from sfol.testing.naive import naive_conclusions
from sfol.tools.diff import compare
from sfol.tools.lint import lint
from tests.differential.dense import dense_conclusions
from tests.differential.programs import program
from tests.sfol.command_line import sfol

H = Atom("h", ("ego",))
SCENE = "P(ego): 0.8. Q(ego): [0.2, 0.3]. V(ego): [0.6, 0.9]. R(ego, a): 0.5. R(ego, b): 0.1."


@pytest.mark.parametrize(
    ("rule", "clauses"),
    [
        ("h(X) :- P(X) or Q(X).", ["h(X) :- P(X).", "h(X) :- Q(X)."]),
        ("h(X) :- P(X), (Q(X) or V(X)).", ["h(X) :- P(X), Q(X).", "h(X) :- P(X), V(X)."]),
        ("h(X) :- P(X), (Q(X) implies V(X)).", ["h(X) :- P(X), not Q(X).", "h(X) :- P(X), V(X)."]),
        (
            "h(X) :- P(X), (not Q(X) implies R(X, _)).",
            ["h(X) :- P(X), Q(X).", "h(X) :- P(X), R(X, _)."],
        ),
        (
            "h(X) :- P(X), ((Q(X), V(X)) implies R(X, _)).",
            ["h(X) :- P(X), not Q(X).", "h(X) :- P(X), not V(X).", "h(X) :- P(X), R(X, _)."],
        ),
        (
            "h(X) :- P(X), ((Q(X) or V(X)) implies R(X, _)).",
            ["h(X) :- P(X), not Q(X), not V(X).", "h(X) :- P(X), R(X, _)."],
        ),
        (
            "h(X) :- P(X), ((Q(X) implies V(X)) implies R(X, _)).",
            ["h(X) :- P(X), Q(X), not V(X).", "h(X) :- P(X), R(X, _)."],
        ),
        (
            "h(X) :- (P(X) or Q(X)), (V(X) or R(X, Y)).",
            [
                "h(X) :- P(X), V(X).",
                "h(X) :- P(X), R(X, Y).",
                "h(X) :- Q(X), V(X).",
                "h(X) :- Q(X), R(X, Y).",
            ],
        ),
        ("h(X) :- R(X, Y), (X != Y or P(Y)).", ["h(X) :- R(X, Y), X != Y.", "h(X) :- R(X, Y), P(Y)."]),
    ],
)  # fmt: skip
@pytest.mark.parametrize("disjunction", ["maximum", "probabilistic_sum"])
def test_a_rule_is_its_parts(rule, clauses, disjunction):
    one, several = (program(*rules, disjunction=disjunction) for rules in ([rule], clauses))
    assert [str(part.clause) for part in one.rules.values()] == clauses
    assert [*one.rules] == [f"rule0.{number}" for number in range(1, len(clauses) + 1)]
    facts = Facts.parse(SCENE)
    expected = RewardFunction(several).evaluate(facts).bounds["h"]
    assert expected is not None
    reward = RewardFunction(one)
    batch = reward.evaluate(reward.batch([facts])).bounds["h"]
    assert reward.evaluate(facts).bounds["h"] == expected
    assert (batch.lower[0], batch.upper[0]) == pytest.approx(expected)
    assert naive_conclusions(one, facts)[H] == pytest.approx(expected)
    assert dense_conclusions(one, [facts])[0][H] == pytest.approx(expected)


def test_parts_have_the_settings_of_the_rule():
    kb = program({"rule": "h(X) :- P(X) or Q(X).", "threshold": 0.25, "certainty": 0.5})
    assert RewardFunction(kb).evaluate(Facts.parse(SCENE)).bounds["h"] == pytest.approx((0.4, 0.4))
    assert {(r.threshold, r.certainty, r.entry) for r in kb.rules.values()} == {
        (0.25, (0.5, 0.5), "rule0")
    }


def test_conditions_of_entity_weights_can_hold_in_several_ways(kitchen, tmp_path):
    conditions = """entity_weights:
  - {when: "Pot(X), (Hot(X) or Lid(X))", weight: 2}
  - {when: Pot(X), weight: 1}
"""
    kb = kitchen({"signals:": f"{conditions}signals:"})
    facts = Facts.parse("Pot(a). Pot(b). Hot(b). Pot(c). Lid(c).")
    assert [*RewardFunction(kb).entity_weights(facts, "abc").values()] == [1.0, 2.0, 2.0]
    (tmp_path / "again.yaml").write_text(to_yaml(kb))
    assert KnowledgeBase.load(tmp_path / "again.yaml").hash == kb.hash


@pytest.mark.parametrize(
    "text",
    [
        "h(X) :- P(X), (Q(X) or (R(X, Y), Y != X)).",
        "h(X) :- P(X) implies (Q(X) or R(X, _)).",
        "h(X) :- (P(X) >= 0.5 or or(X)), not not(X), (implies(X) or Q(X)).",
    ],
)
def test_it_is_printed_and_formatted_as_it_is_read(text):
    rule = parse_rule(text)
    assert str(rule) == text
    assert parse_rule(str(rule)) == rule
    assert format_clause(text.replace(" ", "  ").replace(" (", "(")) == text


@pytest.mark.parametrize(
    ("text", "message", "at"),
    [
        ("h(X) :- P(X), Q(X) or R(X).", "'or' stands beside ','", "or"),
        ("h(X) :- P(X) or Q(X), R(X).", "',' stands beside 'or'", ", R"),
        ("h(X) :- P(X) implies Q(X) implies R(X).", "beside 'implies'", "implies R"),
        ("h(X) :- P(X), (Q(X) or R(X).", "')' is expected where '.' stands", "."),
        ("h(X) :- V(X), (X != Y implies R(X)).", "'X != Y' can't stand to the left", "X !="),
        ("h(X) :- V(X), (P(X) >= 0.5 implies R(X)).", "can't stand to the left", "P("),
        ("h(X) :- ((P(X) implies Q(X) >= 0.5) implies R(X)).", "'Q(X) >= 0.5' can't", "(P("),
        ("h(X) :- " + "(" * 17 + "P(X)" + ")" * 17 + ".", "more than 16 deep", "(P("),
        ("h(X) :- P(X), or Q(X).", "'or' has nothing to its left", "or"),
        ("h(X) :- " + ", ".join(["(P(X) or Q(X))"] * 7) + ".", "can hold in 128 ways", "h"),
        ("h(X) :- " + ", ".join(["(P(X) or Q(X))"] * 64) + ".", "in more than a million ways", "h"),
        ("h(X) :- " + " or ".join(["P(X)"] * 65) + ".", "more than 64 literals", "h"),
        ("h(X) :- " + ", ".join(["(P(X), P(X))"] * 33) + ".", "more than 64 literals", "h"),
    ],
)
def test_what_cannot_be_read_says_why_and_where(text, message, at):
    with pytest.raises(ClauseError) as caught:
        parse_rule(text)
    assert message in caught.value.message
    assert caught.value.suggestion
    assert caught.value.offset == text.index(at)


def test_as_many_ways_as_are_allowed():
    rule = parse_rule("h(X) :- " + ", ".join(["(P(X) or Q(X))"] * 6) + ".")
    assert len(rule.clauses) == MAXIMUM_WAYS
    assert len(parse_conditions("P(X) or Q(X)")) == 2


@pytest.mark.parametrize("parse", [parse_clause, parse_condition])
def test_who_asks_for_one_clause_gets_one(parse):
    text = "P(X), (Q(X) or R(X))"
    with pytest.raises(ClauseError, match="this stands for 2 clauses"):
        parse(f"h(X) :- {text}." if parse is parse_clause else text)


def errors(*rules):
    with pytest.raises(InvalidKnowledgeBase) as caught:
        program(*rules)
    return [error.message for error in caught.value.errors]


def test_every_part_has_to_be_safe_and_a_mistake_is_told_once():
    assert errors("h(X) :- P(X), (Q(Y) implies R(X, Y)).") == [
        "the variable 'Y' stands in no positive literal of 'P(X), not Q(Y)', "
        "one way in which the body can hold"
    ]
    assert errors("h(X) :- Pp(X), (Q(X) or V(X)).") == ["unknown predicate 'Pp'"]
    assert errors("h(ego) :- ego != ada or P(ego).") == [
        "'ego != ada', one way in which the body can hold, has guards and no literal"
    ]


def test_the_names_of_parts_are_taken(kitchen):
    with pytest.raises(InvalidKnowledgeBase) as caught:
        kitchen(
            {
                "rules:": "rules:\n  care.2: careful(X) :- Person(X).",
                "Hot(P),": "(Hot(P) or Lid(P)),",
            }
        )
    (error,) = caught.value.errors
    assert "'care.2' is what a part of the rule 'care' is called" in str(error)
    assert error.place.line == 12


@pytest.fixture
def either(kitchen):
    return kitchen({"Hot(P),": "(Hot(P) or Lid(P)),"})


def test_it_is_written_out_as_one_rule(either, tmp_path):
    (tmp_path / "out.yaml").write_text(to_yaml(either))
    again = KnowledgeBase.load(tmp_path / "out.yaml")
    assert again.hash == either.hash
    assert again.rules == either.rules
    assert "careful(X) :- Person(X), Pot(P), (Hot(P) or Lid(P)), Near(P, X)." in to_yaml(either)
    assert (
        "careful(X) :- Person(X), Pot(P), (Hot(P) or Lid(P)), Near(P, X)."
        in sfol("show", tmp_path / "kitchen.yaml").out
    )
    assert "1 rules" in sfol("check", tmp_path / "kitchen.yaml").out
    assert sfol("fmt", "--check", tmp_path / "kitchen.yaml").code == 0


def test_parts_that_were_taken_out_as_objects_are_written_out_alone(either, tmp_path):
    left = replace(either, rules={n: r for n, r in either.rules.items() if n != "care.1"})
    (tmp_path / "out.yaml").write_text(to_yaml(left))
    assert KnowledgeBase.load(tmp_path / "out.yaml").hash == left.hash != either.hash


def test_explanations_name_the_part_and_the_rule(either):
    reward = RewardFunction(either)
    explained = reward.explain(Facts.parse("Pot(p). Near(p, cook). Lid(p): 0.5."), speed=1)
    assert "Person(X), Pot(P), Lid(P), Near(P, X).  [0.875, 0.875], a part of care" in str(
        explained
    )
    assert "rule care.2 with X = cook, P = p" in str(explained)
    assert '"part_of": "care"' in json.dumps(explained.to_dict())
    missed = str(reward.explain(Facts.parse("Pot(p). Near(p, cook)."), speed=1))
    assert "rule care.1 lacks Hot(p)" in missed
    assert "rule care.2 lacks Lid(p)" in missed


def test_what_fired_is_the_part_and_the_rule(either):
    outcome = RewardFunction(either).evaluate(
        Facts.parse("Pot(p). Near(p, cook). Lid(p)."), speed=1
    )
    assert outcome.fired == {"care", "care.2"}
    assert [*run_tests(either).coverage] == ["care.1", "care.2"]


def test_a_difference_shows_the_rule_and_the_part_that_changed(kitchen, either):
    other = kitchen({"Hot(P),": "(Hot(P) or not Lid(P)),"})
    (change,) = compare(either, other)
    assert (change.section, change.name, [*change.before]) == ("rules", "care", ["", "care.2"])
    assert change.after["care.2"] == "careful(X) :- Person(X), Pot(P), not Lid(P), Near(P, X)."
    (change,) = compare(kitchen(), either)
    assert set(change.after) == {"", "care.1", "care.2"}


def test_lint_speaks_of_the_part_and_the_rule(kitchen, tmp_path):
    def messages(body):
        kb = kitchen({"Pot(P), Hot(P), Near(P, X)": body})
        return {f.code: f for f in lint(kb) if f.path[0] == "rules"}

    covered = messages("Near(P, X), (Pot(P) or (Pot(P), Hot(P)))")["SF005"]
    assert covered.message.startswith(
        "the rule 'care.2' (a part of 'care') holds only where 'care.1' (a part of 'care') does"
    )
    assert covered.path == ("rules", "care")
    never = messages("Near(P, X), (Pot(P) or P != P)")["SF001"]
    assert "'care.2' (a part of 'care') can never fire" in never.message
    both = messages("Near(P, X), (Pot(P) or (Hot(P), not Hot(P)))")["SF002"]
    assert "'care.2' (a part of 'care') asks for" in both.message
    assert "kitchen.yaml:12" in sfol("lint", tmp_path / "kitchen.yaml").out
