"""Predicates of no argument, and of up to four."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfol import Atom, Bound, Facts, KnowledgeBase, RewardFunction
from sfol.clauses import parse_rule
from sfol.errors import ClauseError, FactError, InvalidKnowledgeBase, WorkLimitError
from sfol.knowledge_base import KnowledgeBaseFile
from sfol.knowledge_base.formatting import format_clause
from sfol.knowledge_base.printing import to_yaml
from sfol.testing.laws import assert_same
from sfol.testing.naive import naive_conclusions
from sfol.tools.lint import lint
from tests.differential.dense import dense_conclusions
from tests.sfol.hall import ACTION, HALL, NEXT, OBSERVATION

DECLARED = ("P(X)", "R(X, Y)", "Raining", "Alarm", "Between(X, Y, Z)", "Gives(X, Y, Z, W)")


def program(*rules, terms=None, **semantics):
    return KnowledgeBase.of(
        KnowledgeBaseFile.model_validate(
            {
                "version": 1,
                "name": "program",
                "predicates": dict.fromkeys([*DECLARED, "h(X)", "t(X, Y, Z)"], ""),
                "rules": {f"rule{number}": rule for number, rule in enumerate(rules)},
                "semantics": semantics,
                **(terms or {"terms": {"nothing": {"weight": 1, "formula": "0"}}}),
            }
        )
    )


def derived(kb, text):
    """Return all conclusions, on which the engines agree; of h those of the subject."""
    facts = Facts.parse(text)
    reward = RewardFunction(kb)
    found = reward.conclude(facts).derived
    expected = naive_conclusions(kb, facts)
    assert found.keys() == expected.keys()
    dense = dense_conclusions(kb, [facts, Facts()], sorts=2)[0]
    batch = reward.evaluate(reward.batch([facts, Facts()]))
    for atom, bound in expected.items():
        assert found[atom] == pytest.approx(bound)
        if atom.predicate in batch.bounds:
            if atom.arguments not in ((), (kb.subject,)):
                continue
            bounds = batch.bounds[atom.predicate]
            assert (bounds.lower[0], bounds.upper[0]) == pytest.approx(bound)
            assert not bounds.known[1]
        assert dense[atom] == pytest.approx(tuple(bound))
    return {str(atom): bound for atom, bound in found.items()}


# -- no argument --------------------------------------------------------------------------------

WEIGHED = {
    "weights": {"w": {"normalizer": 1, "coefficients": {"Alarm": 2}}},
    "terms": {
        "t": {"weight": "w", "formula": "-1"},
        "hinge": {"weight": 1, "formula": "-(1 - Alarm)**2"},
    },
}


def test_a_proposition_is_asserted_read_concluded_and_weighed():
    kb = program("Alarm :- Raining, P(X), not R(X, _).", "h(X) :- Alarm, P(X).", terms=WEIGHED)
    found = derived(kb, "Raining: [0.5, 0.7]. P(ego). P(a). R(a, a).")
    assert found["Alarm"] == pytest.approx((2.5 / 3, 2.7 / 3))
    assert found["h(ego)"] == pytest.approx((5.5 / 6, 5.7 / 6))
    reward = RewardFunction(kb)
    outcome = reward.evaluate(Facts.parse("Raining: [0.5, 0.5]. P(ego)."))
    confidence = 2.5 / 3
    assert outcome.confidences["Alarm"] == pytest.approx(confidence)
    assert outcome.terms == pytest.approx({"t": -2 * confidence, "hinge": -((1 - confidence) ** 2)})
    explained = str(reward.explain(Facts.parse("Raining: [0.5, 0.5]. P(ego).")))
    assert "Alarm [0.8333, 0.8333]" in explained
    assert "Raining [0.5, 0.5]  asserted" in explained
    assert "rule rule0 lacks Raining" in str(reward.explain(Facts.parse("P(ego).")))


def test_where_nobody_reads_it_the_head_is_concluded_all_the_same():
    kb = program("Alarm :- Raining.", terms=WEIGHED)
    assert derived(kb, "Raining: [0.2, 0.4].") == {"Alarm": pytest.approx((0.2, 0.4))}
    assert derived(kb, "") == {}
    reward = RewardFunction(kb)
    assert reward.evaluate(Facts.parse("Alarm: [0.3, 0.3].")).confidences["Alarm"] == 0.3
    batch = reward.evaluate(reward.batch([Facts.parse("Alarm: [0.3, 0.3]."), Facts()]))
    assert batch.confidences["Alarm"].tolist() == [0.3, 0.0]


def test_negation_of_a_proposition():
    kb = program("h(X) :- P(X), not Raining.")
    assert derived(kb, "P(ego). Raining: [0.1, 0.2].")["h(ego)"] == pytest.approx((0.9, 0.95))
    assert "h(ego)" not in derived(kb, "P(ego). Raining.")


def test_a_proposition_is_read_off_an_observation(tmp_path):
    path = tmp_path / "hall.yaml"
    path.write_text(
        HALL.replace("  Robot(X): X", "  Dark: It is dark.\n  Robot(X): X")
        .replace("Robot(X), Person(P), Close(P, X), Ahead", "Dark, Person(P), Close(P, X), Ahead")
        .replace("  Person(P in person): 1.0", "  Person(P in person): 1.0\n  Dark: 1 - light")
    )
    reward = RewardFunction(path)
    facts = reward.observe(OBSERVATION)
    assert facts.bound("Dark") == pytest.approx((0.25 * 0.95, 0.25 * 1.05))
    arrays = {
        "people": np.array([OBSERVATION["people"]] * 2),
        "mask": np.array([OBSERVATION["mask"]] * 2),
        "body": {"state": np.array([OBSERVATION["body"]["state"]] * 2)},
        "light": np.array([0.75, 0.5]),
    }
    after = {"body": {"state": np.array([NEXT["body"]["state"]] * 2)}}
    many = reward.transition(arrays, np.array([ACTION] * 2), after)
    single = reward.transition(OBSERVATION, ACTION, NEXT)
    assert many.confidences["careful"][0] == pytest.approx(single.confidences["careful"])
    assert many.confidences["careful"][1] > many.confidences["careful"][0]


# -- three and four -----------------------------------------------------------------------------


@pytest.mark.parametrize("semantics", [{}, {"groundings": "best"}, {"conjunction": "product"}])
@pytest.mark.parametrize(
    "rule",
    [
        "h(X) :- P(X), Between(Y, X, Z).",
        "h(X) :- P(X), Between(X, X, Z).",
        "h(X) :- Between(X, Y, X), R(X, Y).",
        "h(X) :- P(X), Between(Y, Y, Y).",
        "h(X) :- P(X), P(Y), Between(X, _, Y).",
        "h(X) :- P(X), not Between(X, _, b).",
        "h(X) :- P(X), not Between(_, X, X).",
        "t(Z, X, Y) :- Between(X, Y, Z), R(X, Z), X != Y.",
        "t(X, X, Y) :- Between(Y, X, Z), not R(Z, X).",
        "t(X, b, Y) :- P(X), P(Y), Gives(X, Y, X, Z).",
        "t(X, Y, Z) :- P(X), P(Y), P(Z), R(X, Z).",
        "h(X) :- Gives(X, Y, Z, W), R(Y, Z), R(Z, W).",
        "h(X) :- R(X, Y), R(X, Z), Gives(Z, X, Y, Z).",
    ],
)
def test_engines_agree(rule, semantics):
    names = ("ego", "a", "b")
    texts = ["P(ego): 0.9.", "P(a): [0.5, 0.8].", "R(ego, a): 0.7.", "R(ego, b): 0.2.", "R(a, b)."]
    numbers = itertools.count(1)
    for x, y, z in itertools.product(names, repeat=3):
        number = next(numbers)
        if number % 3:
            texts.append(f"Between({x}, {y}, {z}): [{number / 90}, {number / 60}].")
        if number % 4 < 2:
            texts.append(f"Gives({x}, {y}, {z}, {names[number % 3]}): {number / 40}.")
    assert derived(program(rule, **semantics), " ".join(texts))


@given(st.lists(st.tuples(*[st.sampled_from(["ego", "a", "b", "c"])] * 4), max_size=30))
def test_a_body_of_four_variables_finds_what_trying_all_finds(rows):
    kb = program("h(X) :- Gives(X, Y, Z, W), Gives(W, Z, Y, X), X != W.")
    facts = Facts()
    for number, row in enumerate(rows):
        facts.add("Gives", *row, bound=Bound(number / 60, 0.5), merge="maximum")
    assert_same(naive_conclusions(kb, facts), RewardFunction(kb).conclude(facts).derived)


def test_a_wide_head_does_not_wait_for_ever():
    kb = program(
        "t(X, Y, Z) :- P(X), P(Y), P(Z), R(X, _), R(Y, _), R(Z, _).", "h(X) :- t(X, _, _)."
    )
    facts = Facts()
    for number in range(200):
        facts.add("P", f"p{number}")
        facts.add("R", f"p{number}", "p0")
    with pytest.raises(WorkLimitError, match="'rule0'"):
        RewardFunction(kb, work_limit=50_000).evaluate(facts)


# -- text ---------------------------------------------------------------------------------------


def test_text_and_facts():
    text = 'Raining: [0.5, 0.6].\nBetween(a, b, c).\nGives(a, 7, "B", d): [0.0, 1.0].'
    facts = Facts.parse(text)
    assert str(facts) == text
    assert facts.bound("Raining") == (0.5, 0.6)
    assert facts.entities() == ("a", "b", "c", "7", '"B"', "d")
    assert Atom("Raining", ()) in facts
    assert format_clause("Raining :0.5 . Between( a,b ,c ) .") == "Raining: 0.5. Between(a, b, c)."
    rule = "Alarm :- Raining, (not Alarm2 or Gives(a, _, X, X)), Between(X, X, _)."
    assert str(parse_rule(rule)) == rule


def test_it_is_printed_as_it_is_declared(tmp_path):
    kb = program("Alarm :- Raining.", "t(X, Y, Z) :- Gives(X, Y, Z, _), Between(X, Y, Z).")
    printed = to_yaml(kb)
    assert "Gives(X, Y, Z, W):" in printed
    assert "Raining:" in printed
    (tmp_path / "again.yaml").write_text(printed)
    assert KnowledgeBase.load(tmp_path / "again.yaml").hash == kb.hash
    assert {f.code for f in lint(kb)} == {"SF003", "SF006", "SF017"}


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ("h(X) :- P(X), P.", "'P' has 0 arguments here (it is declared as P(X))"),
        ("h(X) :- P(X), Between(X, X).", "'Between' has 2 arguments here"),
        ("h(X) :- P(X), Raining(X).", "'Raining' has 1 arguments here (it is declared as Raining)"),
        ("h(X) :- P(X), Rainig.", "unknown predicate 'Rainig' (did you mean 'Raining'?)"),
        ("h(X) :- P(X), Between(X, X, X, X, X).", "'Between' has more than 4 arguments"),
        ("Alarm() :- P(X).", "an argument is expected where ')' stands (without any it is written 'Alarm')"),
    ],
)  # fmt: skip
def test_mistakes(rule, message):
    with pytest.raises(InvalidKnowledgeBase) as caught:
        program(rule)
    (error,) = caught.value.errors
    assert message in str(error)


def test_an_overlay_may_remove_the_rules_of_a_proposition(tmp_path):
    kb = program("Alarm :- Raining.", "h(X) :- P(X).", terms=WEIGHED)
    (tmp_path / "base.yaml").write_text(to_yaml(kb))
    overlay = "version: 1\nname: less\nextends: base\nremove: {rules: [rule0]}\n"
    (tmp_path / "less.yaml").write_text(overlay)
    less = RewardFunction(KnowledgeBase.load(tmp_path / "less.yaml"))
    assert less.evaluate(Facts.parse("Raining. P(ego).")).terms["hinge"] == -1.0
    assert "nothing concluded" in str(less.explain(Facts()))


def test_a_proposition_that_cannot_be_read_is_not_unknown_as_well():
    with pytest.raises(InvalidKnowledgeBase) as caught:
        program("Noise :- P(X) & Raining.", "h(X) :- P(X), Noise.")
    (error,) = caught.value.errors
    assert "the character '&'" in str(error)


def test_what_a_weight_cannot_name():
    weights = {"weights": {"w": {"normalizer": 1, "coefficients": {"t": 1}}}}
    with pytest.raises(InvalidKnowledgeBase, match="the head 't' has 3 arguments"):
        program("t(X, Y, Z) :- Between(X, Y, Z).", terms=weights)


def test_facts_that_do_not_fit():
    reward = RewardFunction(program("h(X) :- P(X)."))
    with pytest.raises(FactError, match="facts give 'P' 0 constants; it has 1"):
        reward.conclude(Facts.parse("P."))
    with pytest.raises(FactError, match="'P' has 5 constants"):
        Facts().add("P", *"abcde")
    with pytest.raises(FactError, match="has 1 constants here and 0 elsewhere"):
        Facts.parse("Raining. Raining(a).")
    with pytest.raises(ClauseError, match="'or' is no predicate without arguments"):
        Facts.parse("or.")
