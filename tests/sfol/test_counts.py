"""Counts in bodies: at least so many entities satisfy some literals."""

import pytest

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.clauses import parse_clause
from sfol.engines.program import Program
from sfol.errors import ClauseError, InvalidKnowledgeBase, KnowledgeBaseError
from sfol.knowledge_base import KnowledgeBaseFile
from sfol.knowledge_base.formatting import format_clause
from sfol.knowledge_base.printing import to_yaml
from sfol.testing.naive import naive_conclusions
from sfol.tools.diff import compare
from sfol.tools.graph import dependency_graph
from sfol.tools.lint import lint
from sfol.tools.subsumption import compared
from tests.differential.dense import dense_conclusions
from tests.differential.programs import program
from tests.sfol.test_certainty import bounds_of

CROWD = "h(X) :- V(X), count(Y: P(Y), R(Y, X)) >= 2."
THREE = "V(ego). P(a): 0.6. R(a, ego). P(b): [0.2, 0.8]. R(b, ego). P(c): 0.4. R(c, ego)."


def counting(literal, **more):
    return {"rule": f"h(X) :- V(X), {literal}.", **more}


@pytest.mark.parametrize(
    ("literal", "expected"),
    [
        ("exists(Y: P(Y), R(Y, X))", (0.6, 0.8)),
        ("count(Y: P(Y), R(Y, X)) >= 1", (0.6, 0.8)),
        ("count(Y: P(Y), R(Y, X)) >= 2", (0.4, 0.6)),
        ("count(Y: P(Y), R(Y, X)) >= 3", (0.2, 0.4)),
        ("count(Y: P(Y), R(Y, X)) >= 4", None),
        ("count(Y: P(Y) >= 0.4, R(Y, X)) >= 2", (0.4, 0.4)),
        ("count(Y: P(Y) >= 0.4, R(Y, X)) >= 3", None),
        ("count(Y: P(Y), R(Y, ego), Y != c) >= 2", (0.2, 0.6)),
        ("count(Y: P(Y), not R(Y, c), R(Y, X)) >= 2", (0.4, 0.6)),
        ("count(Y, Z: P(Y), P(Z), Y != Z) >= 6", (0.2, 0.4)),
        ("count(Y: P(Y), P(Z), Y != Z) >= 3", (0.2, 0.4)),
        ("exists(Y: P(Y), R(Y, _))", (0.6, 0.8)),
    ],
)
def test_the_bound_is_that_of_the_last_that_is_needed(literal, expected):
    for found in bounds_of(program(counting(literal), conjunction="minimum"), THREE):
        assert found == (None if expected is None else pytest.approx(expected)), literal


def test_the_number_of_others_and_of_their_reasons_does_not_matter():
    kb = program(counting("count(Y: R(Y, Z), S(Z, X)) >= 2"), conjunction="minimum")
    one = "V(ego). R(a, b): 0.3. S(b, ego). R(a, c): 0.5. S(c, ego). "
    assert all(found is None for found in bounds_of(kb, one))
    for found in bounds_of(kb, f"{one} R(d, c): 0.9."):
        assert found == pytest.approx((0.5, 0.5))


def test_the_more_people_the_more_caution():
    kb = KnowledgeBase.of(
        KnowledgeBaseFile.model_validate(
            {
                "version": 1,
                "name": "caution",
                "predicates": {"P(X)": ""},
                "rules": {
                    f"rule{n}": f"least{n}(ego) :- count(Y: P(Y)) >= {n}." for n in (1, 2, 3)
                },
                "weights": {
                    "caution": {
                        "normalizer": 3,
                        "coefficients": {"least1": 1, "least2": 1, "least3": 1},
                    }
                },
                "terms": {"t": {"weight": "caution", "formula": "1"}},
            }
        )
    )
    reward = RewardFunction(kb)
    scenes = [Facts.parse("".join(f"P(p{i}): 0.6. " for i in range(n))) for n in range(5)]
    expected = pytest.approx([0.0, 0.2, 0.4, 0.6, 0.6])
    assert [reward.evaluate(facts).reward for facts in scenes] == expected
    assert list(reward.evaluate(reward.batch(scenes)).reward) == expected


def test_a_count_is_for_each_value_of_what_stands_outside():
    kb = program("e(X, Z) :- T(X, Z), count(Y: R(Y, Z)) >= 2.", "h(X) :- e(X, _).")
    facts = Facts.parse("T(ego, a). T(ego, b). R(c, a). R(d, a). R(c, b).")
    assert [str(atom) for atom in RewardFunction(kb).evaluate(facts).derived] == [
        "e(ego, a)",
        "h(ego)",
    ]


def test_what_is_inside_alone_has_no_meaning_outside_and_two_counts_share_nothing():
    kb = program("h(X) :- V(X), count(Y: P(Y), R(Y, Z)) >= 2, exists(Y: Q(Y), R(Z, Y)).")
    facts = "V(ego). P(a). P(b). R(a, c). R(b, d). Q(e). R(f, e)."
    assert all(found == (1.0, 1.0) for found in bounds_of(kb, facts))


def test_conclusions_are_counted_and_a_count_stands_beside_or():
    kb = program(
        "g(X) :- P(X), Q(X).",
        "h(X) :- V(X), (count(Y: g(Y)) >= 2 or exists(Y: R(Y, X))).",
    )
    for text, expected in (
        ("V(ego). P(a). Q(a).", None),
        ("V(ego). P(a). Q(a). P(b). Q(b).", (1.0, 1.0)),
        ("V(ego). R(a, ego).", (1.0, 1.0)),
    ):
        assert all(found == expected for found in bounds_of(kb, text)), text


def test_thresholds_hold_inside_and_for_what_is_counted():
    kb = program(counting("count(Y: P(Y), R(Y, X)) >= 2", threshold=0.5), conjunction="product")
    inside = "V(ego). P(a): 0.4. R(a, ego). P(b). R(b, ego)."
    counted = "V(ego). P(a): 0.6. R(a, ego): 0.6. P(b). R(b, ego)."
    both = "V(ego). P(a): 0.8. R(a, ego): 0.8. P(b). R(b, ego)."
    for text, expected in ((inside, None), (counted, None), (both, pytest.approx((0.64, 0.64)))):
        assert all(found == expected for found in bounds_of(kb, text)), text


def test_over_several_sorts_all_are_counted():
    kb = program(CROWD, "e(X, Z) :- T(X, Z), count(Y: R(Y, Z), P(Y)) >= 2.")
    facts = Facts.parse(f"{THREE} T(a, ego). T(b, c).")
    expected = naive_conclusions(kb, facts)
    for sorts in (1, 2, 3):
        found = dense_conclusions(kb, [Facts(), facts], sorts)[1]
        assert found.keys() == expected.keys()
        for atom, bound in expected.items():
            assert found[atom] == pytest.approx(tuple(bound))


def test_gradients_go_to_the_one_that_decides():
    torch = pytest.importorskip("torch")
    reward = RewardFunction(program(CROWD, conjunction="minimum"))
    batch = reward.batch([Facts.parse(THREE)])
    lower = torch.tensor(batch.lower, requires_grad=True)
    outcomes = reward.evaluate(batch.with_bounds(lower, torch.tensor(batch.upper)))
    outcomes.bounds["h"].lower.sum().backward()
    moved = [str(atom) for (_, atom), at in zip(batch.atoms, lower.grad, strict=True) if at]
    assert moved == ["P(c)"]


def test_what_an_engine_makes_of_a_count_is_not_seen():
    reward = RewardFunction(program(CROWD))
    facts = Facts.parse(THREE)
    assert reward.evaluate(facts).fired == {"rule0"}
    assert {atom.predicate for atom in reward.evaluate(facts).derived} == {"h"}
    assert reward.engine.program.auxiliary
    assert not Program.of(program("h(X) :- P(X).")).auxiliary


def test_an_explanation_shows_who_was_counted_or_how_many():
    kb = KnowledgeBase.of(
        KnowledgeBaseFile.model_validate(
            {
                "version": 1,
                "name": "crowd",
                "predicates": dict.fromkeys(["P(X)", "V(X)", "R(X, Y)"], ""),
                "rules": {"crowd": CROWD},
                "weights": {"w": {"normalizer": 1, "coefficients": {"h": 1}}},
                "terms": {"t": {"weight": "w", "formula": "1"}},
            }
        )
    )
    reward = RewardFunction(kb)
    text = str(reward.explain(Facts.parse(THREE)))
    assert "count(Y: P(Y), R(Y, ego)) >= 2 [0.7, 0.8]  3 counted" in text
    assert text.index("Y = b  [0.6, 0.9]") > text.index("Y = a  [0.8, 0.8]")
    assert "P(c) [0.4, 0.4]  asserted" in text
    text = str(reward.explain(Facts.parse("V(ego). P(a). R(a, ego).")))
    assert "lacks count(Y: P(Y), R(Y, ego)) >= 2 (it counts 1)" in text


@pytest.mark.parametrize(
    ("literal", "message", "suggestion"),
    [
        ("not count(Y: P(Y)) >= 2", "can't be negated", "rule of its own"),
        ("count(y: P(y)) >= 2", "'y' is no variable", "upper-case"),
        ("count(Y, Y: P(Y)) >= 2", "stands twice before the colon", "once"),
        ("count(Y: P(Y)) >= 0", "at least 0", "from 1 to 1000000"),
        ("count(Y: P(Y)) >= 1e300", r"at least 1e\+300", "from 1 to 1000000"),
        ("count(Y: P(Y)) >= 1.5", "at least 1.5", "from 1 to"),
        ("count(Y: P(Y))", "'>=' is expected", "at least"),
        ("count(Y: P(Y) or Q(Y)) >= 2", r"'\)' is expected", "or"),
        ("count(Y: P(Y), exists(Z: R(Y, Z))) >= 2", "inside of another", "rule of its own"),
    ],
)
def test_what_is_no_count_is_refused_where_it_stands(literal, message, suggestion):
    with pytest.raises(ClauseError, match=message) as caught:
        parse_clause(f"h(X) :- V(X), {literal}.")
    assert suggestion in caught.value.suggestion
    assert caught.value.offset >= len("h(X) :- V(X), ")


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ("h(X) :- V(X), count(X: P(X)) >= 2.", "'X' belongs to .* and stands outside"),
        ("h(X) :- V(X), count(Y: P(Z)) >= 2.", "'Y' stands in no positive literal inside"),
        ("h(X) :- V(X), count(Y: P(Y), Y != X) >= 2.", "'X' stands in no positive literal inside"),
        ("h(Y) :- V(X), count(Y: P(Y)) >= 2.", "'Y' stands in no positive literal of the body"),
        ("h(X) :- count(Y: R(Y, X)) >= 2.", "'X' stands in no positive literal of the body"),
        ("h(X) :- V(X), count(Y: N(Y)) >= 2.", "unknown predicate 'N'"),
        ("h(X) :- V(X), count(Y: h(Y)) >= 2.", "h → h|'h'"),
    ],
)
def test_variables_and_predicates_of_a_count_are_checked(rule, message):
    with pytest.raises(InvalidKnowledgeBase, match=message):
        program(rule)


def test_a_condition_of_an_entity_weight_does_not_count():
    content = {
        "version": 1,
        "name": "k",
        "predicates": {"P(X)": "", "R(X, Y)": ""},
        "rules": {"r": "h(X) :- P(X)."},
        "entity_weights": [{"when": "P(X), exists(Y: R(X, Y))", "weight": 1}],
        "terms": {"t": {"weight": 1, "formula": "0"}},
    }
    with pytest.raises(InvalidKnowledgeBase, match="a condition can't have a count"):
        KnowledgeBase.of(KnowledgeBaseFile.model_validate(content))


def test_predicates_may_be_called_like_counts():
    clause = parse_clause("h(X) :- count(X, Y), exists(Y), not count(Y, X).")
    assert str(clause) == "h(X) :- count(X, Y), exists(Y), not count(Y, X)."
    assert not clause.body.quantified


def test_pyreason_refuses_counts_by_name():
    pytest.importorskip("pyreason")
    with pytest.raises(KnowledgeBaseError, match="can't express the literal 'count") as caught:
        RewardFunction(program(CROWD), engine="pyreason")
    assert caught.value.suggestion == "use engine='compiled'"


def test_printed_formatted_and_compared_it_is_there(tmp_path):
    path = tmp_path / "crowd.yaml"
    path.write_text(to_yaml(program(CROWD)), encoding="utf-8")
    found = KnowledgeBase.load(path)
    assert found.hash == program(CROWD).hash != program(CROWD.replace("2", "3")).hash
    (change,) = compare(program(CROWD.replace("2", "3")), found)
    assert "count(Y: P(Y), R(Y, X)) >= 2" in str(change)
    assert format_clause("h(X):-V(X),count(Y:P(Y),R(Y,X))>=2.") == CROWD


def test_a_rule_that_asks_for_fewer_covers_one_that_asks_for_more():
    more = program(CROWD, CROWD.replace("2", "3")).rules.values()
    (found,) = compared(more).covered
    assert [rule.name for rule in found] == ["rule0", "rule1"]
    other = program(CROWD, CROWD.replace("R(Y, X)", "S(Y, X)")).rules.values()
    assert not compared(other).covered


def test_lint_and_graph_look_inside():
    kb = program("k(X) :- P(X), X != X.", "h(X) :- V(X), exists(Y: k(Y), not Q(Y)).")
    assert "rule1" in " ".join(f.message for f in lint(kb) if "never fire" in f.message)
    edges = dependency_graph(kb).edges(data="negated")
    read = {(source.name, negated) for source, rule, negated in edges if rule.name == "rule1"}
    assert read == {("V", False), ("k", False), ("Q", True)}
