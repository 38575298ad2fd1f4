"""Statements about all: what some literals say of somebody, others say as well."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.clauses import parse_clause, parse_rule
from sfol.errors import ClauseError, InvalidKnowledgeBase, KnowledgeBaseError
from sfol.knowledge_base import KnowledgeBaseFile
from sfol.knowledge_base.formatting import format_clause
from sfol.knowledge_base.printing import to_yaml
from sfol.syntax import Atom
from sfol.testing import strategies
from sfol.testing.naive import naive_conclusions
from sfol.tools.graph import dependency_graph
from sfol.tools.lint import lint
from sfol.tools.subsumption import compared
from tests.differential.dense import dense_conclusions
from tests.differential.programs import program
from tests.sfol.test_certainty import bounds_of

PEOPLE = "V(ego). P(a): 0.9. P(b): [0.6, 0.8]. Q(a): 0.7. Q(b): [0.5, 0.9]."


def every(literal, **more):
    return {"rule": f"h(X) :- V(X), {literal}.", **more}


def assert_bounds(kb, text, expected):
    for found in bounds_of(kb, text):
        assert found == (None if expected is None else pytest.approx(expected)), text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("V(ego).", (1.0, 1.0)),  # of nobody
        ("V(ego). Q(a): 0.2.", (1.0, 1.0)),
        ("V(ego). P(a): 0. Q(a): 0.", (1.0, 1.0)),
        ("V(ego). P(a). Q(a): 0.7.", (0.7, 0.7)),
        ("V(ego). P(a): 0.4. Q(a): 0.1.", (0.6, 0.6)),  # who is hardly one is spared
        ("V(ego). P(a): 0.4.", (0.6, 0.6)),  # as if the body were false
        ("V(ego). P(a): [0.2, 0.4].", (0.6, 0.8)),
        ("V(ego). P(a): 0.6.", None),
        ("V(ego). P(a). Q(a): 0.4.", None),  # below the threshold of what is denied
        (PEOPLE, (0.5, 0.7)),
        (f"{PEOPLE} P(c).", None),
        (f"{PEOPLE} P(c). Q(c): [0.6, 0.65].", (0.5, 0.65)),
    ],
)
def test_the_bound_is_that_of_the_one_who_satisfies_it_least(text, expected):
    assert_bounds(program(every("forall(Y: P(Y))(Q(Y))"), conjunction="minimum"), text, expected)


def test_it_is_one_literal_of_the_conjunction():
    kb = program(every("P(a), forall(Y: P(Y))(Q(Y))"))
    assert_bounds(kb, PEOPLE, ((1 + 0.9 + 0.5) / 3, (1 + 0.9 + 0.7) / 3))


def test_inside_the_least_literal_decides_whatever_the_conjunction_is():
    text = "V(ego). P(a): 0.9. R(a, ego): 0.8. Q(a): 0.6. S(a, ego): 0.7."
    kb = program(every("forall(Y: P(Y), R(Y, X))(Q(Y), S(Y, X))"), conjunction="product")
    assert_bounds(kb, text, (0.6, 0.6))
    two = "forall(Y: P(Y), R(Y, X))(Q(Y)), forall(Y: P(Y), R(Y, X))(S(Y, X))"
    assert_bounds(program(every(two), conjunction="minimum"), text, (0.6, 0.6))


@pytest.mark.parametrize(
    ("body", "text", "expected"),
    [
        ("not R(Y, X)", "P(a).", (1.0, 1.0)),
        ("not R(Y, X)", "P(a). R(a, ego): 0.2.", (0.8, 0.8)),
        ("not R(Y, X)", "P(a). R(a, ego): 0.8.", None),
        ("not R(Y, X)", "P(a): 0.3. R(a, ego): 0.8.", (0.7, 0.7)),
        ("not R(_, Y)", "P(a). R(b, a): 0.1. R(c, a): [0, 0.3].", (0.7, 0.9)),
        ("Q(Z), R(Y, Z)", "P(a). Q(b). R(a, b): 0.6. Q(c). R(a, c): 0.9.", (0.9, 0.9)),
        ("Q(Z), not R(Y, Z)", "P(a). Q(b).", (1.0, 1.0)),
        ("Y != b", "P(a).", (1.0, 1.0)),
        ("Y != b", "P(a). P(b): 0.9.", None),
        ("Y != b", "P(a). P(b): 0.2.", (0.8, 0.8)),
        ("S(Y, X) >= 0.5", "P(a). S(a, ego): 0.6.", (0.6, 0.6)),
    ],
)
def test_what_the_body_may_say(body, text, expected):
    kb = program(every(f"forall(Y: P(Y))({body})"), conjunction="minimum")
    assert_bounds(kb, f"V(ego). {text}", expected)


def test_pairs_and_guards_that_ask_for_a_bound():
    apart = program("h(ego) :- forall(Y, Z: P(Y) >= 0.5, P(Z) >= 0.5, Y != Z)(R(Y, Z)).")
    assert_bounds(apart, "P(a). P(b): 0.4.", (1.0, 1.0))
    assert_bounds(apart, "P(a). P(b). R(a, b): 0.9. R(b, a): 0.8.", (0.8, 0.8))
    assert_bounds(apart, "P(a). P(b). R(a, b): 0.9.", None)


def test_thresholds_hold_inside_and_the_negation_threshold_for_the_whole():
    literal = "forall(Y: P(Y))(Q(Y))"
    strict = program(every(literal, threshold=0.8), conjunction="minimum")
    assert_bounds(strict, "V(ego). P(a): 0.7. Q(a): 0.", (1.0, 1.0))  # no threshold is reached
    assert_bounds(strict, "V(ego). P(a). Q(a): 0.7.", None)
    lenient = program(every(literal, negation_threshold=0.1), conjunction="minimum")
    assert_bounds(lenient, "V(ego). P(a). Q(a): 0.4.", (0.4, 0.4))


def test_it_is_for_each_value_of_what_stands_outside():
    kb = program("e(X, Z) :- T(X, Z), forall(Y: P(Y))(not R(Y, Z)).", "h(X) :- e(X, _).")
    facts = Facts.parse("T(ego, a). T(ego, b). P(c). R(c, a).")
    expected = naive_conclusions(kb, facts)
    assert {str(atom) for atom in expected} == {"e(ego, b)", "h(ego)"}
    assert dict(RewardFunction(kb).evaluate(facts).derived) == expected
    for sorts in (1, 2, 3):
        assert dense_conclusions(kb, [Facts(), facts], sorts)[1].keys() == expected.keys()


def test_gradients_go_to_the_one_that_decides():
    torch = pytest.importorskip("torch")
    reward = RewardFunction(program(every("forall(Y: P(Y))(Q(Y))"), conjunction="minimum"))
    batch = reward.batch([Facts.parse("V(ego). P(a): 0.9. Q(a): 0.8. P(b): 0.9. Q(b): 0.7.")])
    lower = torch.tensor(batch.lower, requires_grad=True)
    outcomes = reward.evaluate(batch.with_bounds(lower, torch.tensor(batch.upper)))
    outcomes.bounds["h"].lower.sum().backward()
    moved = [str(atom) for (_, atom), at in zip(batch.atoms, lower.grad, strict=True) if at]
    assert moved == ["Q(b)"]


@pytest.mark.parametrize(
    ("literal", "message", "suggestion"),
    [
        ("not forall(Y: P(Y))(Q(Y))", "forall can't be negated", "rule of its own"),
        ("forall(y: P(y))(Q(y))", "'y' is no variable", "upper-case"),
        ("forall(Y, Y: P(Y))(Q(Y))", "stands twice", "once"),
        ("forall(Y: P(Y))", r"'\(' is expected", "stands behind"),
        ("forall(Y: P(Y))()", "a predicate is expected", ""),
        ("forall(Y: P(Y), exists(Z: R(Y, Z)))(Q(Y))", "inside of another", "rule of its own"),
        ("forall(Y: P(Y))(forall(Z: P(Z))(R(Y, Z)))", "inside of another", "rule of its own"),
        ("forall(Y: P(Y) or Q(Y))(Q(Y))", r"'\)' is expected", "or"),
    ],
)
def test_what_is_no_forall_is_refused_where_it_stands(literal, message, suggestion):
    with pytest.raises(ClauseError, match=message) as caught:
        parse_clause(f"h(X) :- V(X), {literal}.")
    assert suggestion in (caught.value.suggestion or "")
    assert caught.value.offset is not None


@pytest.mark.parametrize(
    ("literal", "message"),
    [
        ("forall(X: P(X))(Q(X))", "'X' belongs to 'forall.*' and stands outside"),
        ("forall(Y: V(X))(Q(Y))", "'Y' stands in no positive literal inside"),
        ("forall(Y: P(Y), not R(Y, Z))(Q(Y))", "'Z' stands in no positive literal inside"),
        ("forall(Y: P(Y))(not R(Y, Z))", "'Z' stands in no positive literal inside"),
        ("forall(Y: R(Y, Z))(S(Y, Z))", "'Z' stands on both sides"),
        ("forall(Y: P(Y))(Person(Y))", "unknown predicate 'Person'"),
        ("forall(Y: P(Y))(h(Y))", "in a circle"),
    ],
)
def test_variables_and_predicates_of_a_forall_are_checked(literal, message):
    with pytest.raises(InvalidKnowledgeBase, match=message):
        program(f"h(X) :- V(X), {literal}.")


def test_a_predicate_may_be_called_forall():
    clause = parse_clause("h(X) :- forall(X), not forall(X, X).")
    assert str(clause) == "h(X) :- forall(X), not forall(X, X)."


def knowledge_base(rule):
    return KnowledgeBase.of(
        KnowledgeBaseFile.model_validate(
            {
                "version": 1,
                "name": "every",
                "predicates": dict.fromkeys(["P(X)", "Q(X)", "V(X)", "R(X, Y)"], ""),
                "rules": {"every": rule},
                "weights": {"w": {"normalizer": 1, "coefficients": {"h": 1}}},
                "terms": {"t": {"weight": "w", "formula": "1"}},
            }
        )
    )


def test_an_explanation_shows_of_whom_it_speaks_and_who_is_against_it():
    reward = RewardFunction(knowledge_base("h(X) :- V(X), forall(Y: P(Y))(Q(Y), not R(Y, X))."))
    text = str(reward.explain(Facts.parse(f"{PEOPLE} R(b, ego): 0.2.")))
    assert "forall(Y: P(Y))(Q(Y), not R(Y, ego)) [0.5, 0.7]  of 2" in text
    assert text.index("Y = b  [0.5, 0.8]") < text.index("Y = a  [0.7, 0.7]")
    assert "Q(b) [0.5, 0.9]  asserted" in text
    assert "not R(a, ego) [1, 1]  unknown" in text
    text = str(reward.explain(Facts.parse("V(ego). P(a). P(b): 0.9.")))
    assert "lacks forall(Y: P(Y))(Q(Y), not R(Y, ego)) (it is [0, 0] for Y = a)" in text


def test_a_rule_without_anybody_is_explained():
    reward = RewardFunction(knowledge_base("h(X) :- V(X), forall(Y: P(Y))(Q(Y))."))
    assert "forall(Y: P(Y))(Q(Y)) [1, 1]  of 0" in str(reward.explain(Facts.parse("V(ego).")))


def test_printed_and_formatted_it_is_the_same(tmp_path):
    text = "h( X ):-V(X) ,forall( Y,Z:P(Y) ,R(Y,Z) ) (Q(Y),not R(Z , X)) ."
    shown = "h(X) :- V(X), forall(Y, Z: P(Y), R(Y, Z))(Q(Y), not R(Z, X))."
    assert format_clause(text) == shown == str(parse_clause(text))
    assert parse_clause(shown) == parse_clause(text)
    kb = program(shown)
    path = tmp_path / "every.yaml"
    path.write_text(to_yaml(kb), encoding="utf-8")
    assert KnowledgeBase.load(path).rules == kb.rules


def test_the_graph_shows_what_speaks_against_a_forall_as_negated():
    graph = dependency_graph(knowledge_base("h(X) :- V(X), forall(Y: P(Y))(Q(Y), not R(Y, X))."))
    shown = {source.name: data.get("negated") for source, _, data in graph.edges(data=True)}
    assert (shown["P"], shown["Q"], shown["R"]) == (True, False, True)


def test_lint_knows_that_it_holds_of_nobody():
    kb = program("g(X) :- P(X), X != X.", "h(X) :- V(X), forall(Y: g(Y))(g(Y)).")
    never = [finding.message for finding in lint(kb) if finding.code == "SF001"]
    assert len(never) == 1
    assert "rule0" in never[0]


@pytest.mark.parametrize(
    ("special", "covered"),
    [
        ("forall(Y: P(Y))(Q(Y))", True),
        ("forall(Y: P(Y) >= 0.5)(Q(Y))", False),
        ("forall(Y: P(Y))(Q(Y) >= 0.5)", False),
        ("forall(Y: P(Y), Q(Y))(Q(Y))", False),
        ("exists(Y: P(Y), Q(Y))", False),
    ],
)
def test_a_rule_covers_another_only_with_the_same_forall(special, covered):
    kb = program(every("forall(Y: P(Y))(Q(Y))"), every(f"P(X), {special}"))
    assert bool(compared(kb.rules.values()).covered) == covered


def test_pyreason_refuses_it_by_its_text():
    pytest.importorskip("pyreason")
    kb = program(every("forall(Y: P(Y))(Q(Y))"))
    with pytest.raises(KnowledgeBaseError, match="can't express the literal 'forall") as caught:
        RewardFunction(kb, engine="pyreason")
    assert caught.value.suggestion == "use engine='compiled'"


def test_it_stands_beside_or_and_on_the_right_of_implies():
    kb = program("h(X) :- V(X), (forall(Y: P(Y))(Q(Y)) or S(X, X)).", conjunction="minimum")
    assert_bounds(kb, "V(ego). P(a).", None)
    assert_bounds(kb, "V(ego). P(a). S(ego, ego): 0.4.", (0.4, 0.4))
    assert_bounds(kb, "V(ego). P(a). Q(a): 0.9. S(ego, ego): 0.4.", (0.9, 0.9))
    kb = program("h(X) :- V(X), (S(X, X) implies forall(Y: P(Y))(Q(Y))).", conjunction="minimum")
    assert_bounds(kb, "V(ego). P(a).", (1.0, 1.0))
    assert_bounds(kb, "V(ego). P(a). S(ego, ego).", None)
    with pytest.raises(ClauseError, match="can't stand to the left of 'implies'"):
        parse_rule("h(X) :- V(X), (forall(Y: P(Y))(Q(Y)) implies S(X, X)).")


def test_a_knowledge_base_without_has_no_further_rules():
    assert not RewardFunction(program("h(X) :- P(X).")).engine.program.auxiliary
    reward = RewardFunction(program(every("forall(Y: P(Y))(Q(Y))")))
    assert {atom.predicate for atom in reward.evaluate(Facts.parse(PEOPLE)).derived} == {"h"}
    assert reward.evaluate(Facts.parse(PEOPLE)).fired == {"rule0"}


RULES = [
    "h(X) :- V(X), forall(Y: P(Y))(Q(Y)).",
    "h(X) :- V(X), forall(Y: P(Y), R(Y, X))(S(Y, Z), Q(Z), not R(Z, X)).",
    "h(X) :- P(X), forall(Y, Z: R(Y, Z), Y != Z)(S(Z, Y) >= 0.25, not Q(Y)).",
    "e(X, Z) :- R(X, Z), forall(Y: P(Y), not S(Y, _))(not R(Y, Z), Y != X).",
    "e(X, Z) :- P(X), Q(Z), forall(Y: V(Y))(R(Y, X), R(Y, Z)).",
    "h(ego) :- forall(Y: P(Y), R(Y, Z))(Q(Y), S(b, Y)).",
]
ATOMS = [f"{name}({one})" for name in "PQV" for one in ("a", "b", "ego")]
ATOMS += [f"{name}({one}, {two})" for name in "RS" for one in ("a", "b") for two in ("b", "ego")]


@pytest.mark.parametrize("rule", RULES)
@settings(max_examples=15)
@given(
    st.dictionaries(st.sampled_from(ATOMS), strategies.bounds(), min_size=6),
    st.sampled_from(["average", "minimum", "product", "lukasiewicz"]),
    st.sampled_from([0.0, 0.25, 0.5]),
    st.sampled_from([0.0, 0.25, 0.5]),
)
def test_engines_agree(rule, known, conjunction, threshold, negation_threshold):
    thresholds = {"threshold": threshold, "negation_threshold": negation_threshold}
    # What reads heads makes them concluded for everybody, over arrays as well.
    reader = "g(ego) :- h(_)."
    kb = program({"rule": rule, **thresholds}, reader, conjunction=conjunction)
    facts = Facts.parse("".join(f"{a}: [{b.lower!r}, {b.upper!r}]. " for a, b in known.items()))
    reward = RewardFunction(kb)
    expected = naive_conclusions(kb, facts)
    every = [dict(reward.conclude(facts).derived), *(
        dense_conclusions(kb, [Facts(), facts], sorts)[1] for sorts in (1, 2)
    )]  # fmt: skip
    for found in every:
        assert found.keys() == expected.keys()
        for atom, bound in expected.items():
            assert found[atom] == pytest.approx(tuple(bound), abs=1e-9)
    subjects = reward.evaluate(reward.batch([facts])).bounds.get("h")
    if subjects is not None:
        bound = expected.get(Atom("h", ("ego",)))
        assert bool(subjects.known[0]) == (bound is not None)
        if bound is not None:
            assert float(subjects.lower[0]) == pytest.approx(bound.lower, abs=1e-9)
            assert float(subjects.upper[0]) == pytest.approx(bound.upper, abs=1e-9)
