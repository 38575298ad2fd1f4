"""Numbers of entities: facts that are values, and what bodies say of them."""

import json
import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.clauses import parse_clause
from sfol.errors import ClauseError, FactError, InvalidKnowledgeBase, UsageError
from sfol.knowledge_base import KnowledgeBaseFile
from sfol.knowledge_base.formatting import format_clause, format_file
from sfol.knowledge_base.printing import to_yaml
from sfol.knowledge_base.schema import json_schema
from sfol.logs import LogWriter, read_log
from sfol.soft_comparisons import SHAPES
from sfol.testing.naive import naive_conclusions, naive_episode
from sfol.tools.diff import compare
from sfol.tools.graph import GraphNode, dependency_graph
from sfol.tools.lint import lint
from sfol.tools.replay import known, unknown_names
from tests.differential.dense import dense_conclusions

DECLARED = {"Distance(P, X)": "From P to X, in m.", "Speed(X)": "In m/s.", "Heat": "In K."}


def program(*rules, **more):
    content = {
        "version": 2,
        "name": "road",
        "predicates": {"P(X)": "", "Q(X)": ""},
        "attributes": DECLARED,
        "rules": {f"r{n}": rule for n, rule in enumerate(rules)},
        "weights": {"w": {"normalizer": 1, "coefficients": {"h": 1.0}}},
        "terms": {"t": {"weight": "w", "formula": 1}},
        **more,
    }
    return KnowledgeBase.of(KnowledgeBaseFile.model_validate(content))


def bounds_of(kb, text):
    """Return the bound of h(ego) by each engine; None where it is not concluded."""
    facts = Facts.parse(text)
    reward = RewardFunction(kb)
    batch = reward.evaluate(reward.batch([Facts(), facts])).bounds["h"]
    atom = ("h", ("ego",))
    yield reward.evaluate(facts).bounds["h"]
    yield naive_conclusions(kb, facts).get(atom)
    yield (batch.lower[1], batch.upper[1]) if batch.known[1] else None
    yield dense_conclusions(kb, [facts])[0].get(atom)


def assert_bounds(kb, text, expected):
    for found in bounds_of(kb, text):
        assert found == (None if expected is None else pytest.approx(expected)), text


# -- facts --------------------------------------------------------------------------------------


def test_facts_have_values():
    facts = Facts.parse("P(a). Distance(a, ego) = 7.5. Heat = -3. Speed(a) = 1e-7.")
    assert facts.value("Distance", "a", "ego") == 7.5
    assert facts.value("Heat") == -3.0
    assert facts.value("Speed", "b") is None
    assert facts.value("Speed", ["b"]) is None
    assert facts.bound("Speed", "a") is None
    assert set(facts.entities()) == {"a", "ego"}
    assert len(facts) == len(list(facts)) == 4
    assert ("Speed", "a") in facts
    assert ("Speed", "b") not in facts
    assert Facts.parse(str(facts)) == facts != Facts.parse("P(a).")
    assert facts.copy() == facts
    assert facts.about("ego") == Facts.parse("Distance(a, ego) = 7.5.")
    assert pickle.loads(pickle.dumps(facts)) == facts


def test_a_copy_is_apart():
    facts = Facts.parse("Speed(a) = 1.")
    facts.copy().add("Speed", "a", value=2, merge="replace")
    assert facts.value("Speed", "a") == 1.0


def test_values_merge_by_name():
    facts = Facts.parse("Speed(a) = 1. Speed(a) = 1.")
    with pytest.raises(FactError, match=r"asserted twice, with 1\.0 and 2\.0"):
        facts.add("Speed", "a", value=2)
    facts.add("Speed", "a", value=2, merge="replace")
    facts.add("Speed", "a", value=np.float32(1), merge="maximum")
    assert facts.value("Speed", "a") == 2.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "fast", [1, 2], True + 1j])
def test_a_value_is_a_finite_number(value):
    with pytest.raises(FactError, match="give a finite number"):
        Facts().add("Speed", "a", value=value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Speed(a) = 1e999.", "the number 1e999 is too great"),
        ("Speed(a) = nan.", "a number is expected where 'nan' stands"),
        ("Speed(a) = [1, 2].", "a number is expected"),
        ("Speed(A) = 1.", "has a variable"),
        ("Speed(a) = 1", "a fact ends with a full stop"),
    ],
)
def test_no_value(text, message):
    with pytest.raises(ClauseError, match=message):
        Facts.parse(text)


def test_arguments_of_a_value_are_checked():
    with pytest.raises(FactError, match="is not a constant"):
        Facts().add("Speed", "Mary", value=1)
    with pytest.raises(FactError, match="1 constants here and 2 elsewhere"):
        Facts.parse("Speed(a, b) = 1. Speed(a) = 1.")
    with pytest.raises(FactError, match="give one of them"):
        Facts().add("Speed", "a", value=1, confidence=0.5)


# -- what bodies say ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sign", "below", "at", "over"),
    [("<", 1, 0, 0), ("<=", 1, 1, 0), (">", 0, 0, 1), (">=", 0, 1, 1)],
)
def test_signs(sign, below, at, over):
    kb = program(f"h(X) :- Speed(X) {sign} 2.5.")
    for value, holds in ((2, below), (2.5, at), (3, over)):
        assert_bounds(kb, f"Speed(ego) = {value}.", (1, 1) if holds else None)
    assert_bounds(kb, "Speed(a) = 2. Speed(b) = 3.", None)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    ("comparison", "edge", "outwards"),
    [("below({}, 10", 10, 1), ("above({}, 10", 10, -1), ("between({}, 0, 10", 10, 1),
     ("between({}, 0, 10", 0, -1), ("near({}, 10", 10, 1), ("near({}, 10", 10, -1)],
)  # fmt: skip
def test_soft_comparisons_have_the_value_at_the_margin(shape, comparison, edge, outwards):
    literal = f"{comparison.format('Speed(X)')}, margin=4, value_at_margin=0.25, shape={shape})"
    kb = program(f"h(X) :- {literal}.")
    assert_bounds(kb, f"Speed(ego) = {edge}.", (1, 1))
    assert_bounds(kb, f"Speed(ego) = {edge + 4 * outwards}.", (0.25, 0.25))


def test_a_soft_comparison_is_one_literal_of_the_conjunction():
    kb = program("h(X) :- P(X), below(Distance(Y, X), 10, margin=5).")
    text = "P(ego): [0.6, 0.8]. Distance(a, ego) = 12.5."
    assert_bounds(kb, text, ((0.6 + 0.55) / 2, (0.8 + 0.55) / 2))
    assert_bounds(kb, f"{text} Distance(a, ego) = 12.5. Distance(a, b) = 1.", (0.575, 0.675))
    # Far away it is known to be false, and supports nothing.
    assert_bounds(kb, "P(ego). Distance(a, ego) = 16.", None)


def test_a_margin_is_no_uncertainty():
    """`grounding.margin` is for confidences; a value is known."""
    kb = program("h(X) :- below(Speed(X), 10, margin=5).", grounding={"margin": 0.05})
    assert_bounds(kb, "Speed(ego) = 12.5.", (0.55, 0.55))


def test_an_unknown_value_is_unknown():
    kb = program("h(X) :- P(X), not Speed(X) < 10.")
    assert_bounds(kb, "P(ego).", (1, 1))
    assert_bounds(kb, "P(ego). Speed(ego) = 12.", (1, 1))
    assert_bounds(kb, "P(ego). Speed(ego) = 2.", None)


def test_everywhere_a_literal_stands():
    kb = program(
        "h(X) :- P(X), Distance(_, X) < 5, (Speed(X) > 1 or Heat >= 300), not Distance(b, X) < 2.",
        semantics={"conjunction": "minimum"},
    )
    near = "P(ego). Distance(a, ego) = 4. Distance(b, ego) = 3."
    assert_bounds(kb, f"{near} Speed(ego) = 2.", (1, 1))
    assert_bounds(kb, f"{near} Heat = 300.", (1, 1))
    assert_bounds(kb, near, None)
    assert_bounds(kb, "P(ego). Heat = 300. Distance(b, ego) = 1.", None)


def test_in_counts_and_foralls():
    many = program("h(X) :- P(X), count(Y: Distance(Y, X) < 5) >= 2.")
    all_ = program("h(X) :- P(X), forall(Y: Q(Y))(Distance(Y, X) >= 5).")
    text = "P(ego). Q(a). Q(b). Distance(a, ego) = 1. Distance(b, ego) = {}."
    assert_bounds(many, text.format(2), (1, 1))
    assert_bounds(many, text.format(6), None)
    assert_bounds(all_, text.replace("= 1", "= 7").format(6), (1, 1))
    assert_bounds(all_, text.format(6), None)


def test_an_asked_bound_is_asked_of_a_soft_comparison():
    kb = program("h(X) :- below(Speed(X), 10, margin=5) >= 0.5.")
    assert_bounds(kb, "Speed(ego) = 12.5.", (0.55, 0.55))
    assert_bounds(kb, "Speed(ego) = 13.", None)


def test_over_time():
    kb = program(
        "h(X) :- once[2](Speed(X) > 5), not rose(below(Distance(_, X), 3)).",
        time={"step": 1, "unit": "s"},
    )
    texts = ["Speed(ego) = 6.", "Speed(ego) = 1. Distance(a, ego) = 2.", "Speed(ego) = 1.",
             "Speed(ego) = 1."]  # fmt: skip
    steps = [Facts.parse(text) for text in texts]
    episode = RewardFunction(kb).episode()
    found = [episode.step(facts).bounds["h"] for facts in steps]
    assert found == [(1, 1), None, (1, 1), None]
    naive = naive_episode(kb, steps)
    assert [step.get(("h", ("ego",))) for step in naive] == found


def test_conditions_of_entities():
    kb = program(
        "h(X) :- P(X).",
        entity_weights=[
            {"when": "below(Distance(X, ego), 5, margin=5)", "weight": 2, "at_least": 0.5},
            {"when": "Distance(X, ego) >= 5", "weight": 1},
        ],
    )
    facts = Facts.parse("Distance(a, ego) = 6. Distance(b, ego) = 9. Distance(c, b) = 1.")
    weights = RewardFunction(kb).entity_weights(facts, ["a", "b", "c"])
    assert weights == {"a": 2, "b": 1, "c": 0}


def test_a_predicate_may_be_called_like_a_comparison():
    kb = program("h(X) :- near(X, Y), below(Y).", predicates={"near(X, Y)": "", "below(X)": ""})
    assert_bounds(kb, "near(ego, a). below(a): 0.5.", (0.75, 0.75))
    assert str(kb.rules["r0"].clause) == "h(X) :- near(X, Y), below(Y)."


limits = st.floats(allow_nan=False, allow_infinity=False)


@given(limits, limits, st.sampled_from(["<", "<=", ">", ">="]))
def test_what_is_printed_is_read_again(value, limit, sign):
    for literal in (f"Speed(X) {sign} {limit!r}", f"near(Speed(X), {limit!r}, margin=1.5)"):
        clause = parse_clause(f"h(X) :- {literal}.", {"Speed"})
        assert parse_clause(str(clause), {"Speed"}) == clause
        (comparison,) = clause.body.comparisons
        assert 0.0 <= comparison.predicate.operator.truth(value) <= 1.0
    facts = Facts()
    facts.add("Speed", "a", value=value)
    assert Facts.parse(str(facts)) == facts


@given(st.lists(st.floats(-20, 20), min_size=2, max_size=2), st.sampled_from([*SHAPES]))
def test_nearer_to_the_limit_is_no_less_true(values, shape):
    kb = program(f"h(X) :- below(Speed(X), 0, margin=5, shape={shape}).")
    comparison = kb.comparisons[0].operator
    near, far = sorted(values)
    assert comparison.truth(near) >= comparison.truth(far)


# -- mistakes -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ("h(X) :- P(X), Speed(X).", "'Speed' is an attribute: it has a value"),
        ("h(X) :- P(X) < 0.5.", "'P' is a predicate, and has no value (a bound is asked of an atom "
         "as P(X) >= 0.5"),
        ("h(X) :- Sped(X) < 3.", "unknown attribute 'Sped' (did you mean 'Speed'?)"),
        ("h(X) :- Sped(X) >= 0.3.", "unknown predicate 'Sped' (did you mean 'Speed'?)"),
        ("h(X) :- Sped(X) >= 3.", "what has others is an attribute"),
        ("h(X) :- Distance(X) < 3.", "it is declared as Distance(P, X)"),
        ("h(X) :- Speed(X) < Distance(X, Y).", "a value is compared with a number"),
        ("h(X) :- Speed(X) < 1e999.", "the number 1e999 is too great"),
        ("h(X) :- P(X), Speed(Y) = 3.", "'Speed' is an attribute"),
        ("h(X) :- P(X) = 3.", "near(Speed(X), 10)"),
        ("h(X) :- below(Speed(X)).", "a comparison has no room for 'below' with 1 arguments"),
        ("h(X) :- below(Speed(X), 3, 2).", "write margin="),
        ("h(X) :- below(Speed(X), 3, margin=-1).", "a margin below 0"),
        ("h(X) :- below(Speed(X), 3, margn=1).", "did you mean 'margin'?"),
        ("h(X) :- below(Speed(X), 3, margin=1, shape=liner).", "did you mean 'linear'?"),
        ("h(X) :- belo(Speed(X), 3).", "did you mean 'below'?"),
        ("h(X) :- below(P(X), 3).", "'P' is a predicate, and has no value"),
        ("Speed(X) :- P(X).", "'Speed' is an attribute: it has a value"),
        ("h(X) <- P(X).", "a rule is written head(X) :- body(X)."),
    ],
)  # fmt: skip
def test_what_a_mistake_is_answered_with(rule, message):
    with pytest.raises(InvalidKnowledgeBase) as caught:
        program(rule)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"attributes": {"Speed(X)": "", "Speed(Y)": ""}}, "'Speed' is declared twice"),
        ({"attributes": {"P(X)": ""}}, "'P' is a predicate and an attribute"),
        ({"attributes": {"Speed(x)": ""}}, "different variables"),
        ({"background": ["Speed(ego)"]}, "'Speed' is an attribute"),
        ({"tests": [{"name": "t", "facts": "Speed(ego).", "expect": {}}]}, "is an attribute"),
        ({"tests": [{"name": "t", "facts": "P(a) = 3.", "expect": {}}]}, "has no value"),
        ({"tests": [{"name": "t", "facts": "Sped(a) = 3.", "expect": {}}]}, "did you mean 'Speed'"),
        (
            {"terms": {"t": {"weight": 1, "formula": "Speed"}}},
            "the formula reads 'Speed', which is no signal",
        ),
    ],
)
def test_mistakes_elsewhere(more, message):
    with pytest.raises(InvalidKnowledgeBase) as caught:
        program("h(X) :- P(X).", **more)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Speed(ego).", "facts give the attribute 'Speed' a bound"),
        ("P(ego) = 3.", "facts give the predicate 'P' a value"),
        ("Sped(ego) = 3.", "did you mean 'Speed'?"),
        ("Speed(ego, a) = 3.", "facts give 'Speed' 2 constants; it has 1"),
    ],
)
def test_facts_that_do_not_fit(text, message):
    reward = RewardFunction(program("h(X) :- Speed(X) > 1."))
    for evaluate in (reward.evaluate, lambda facts: reward.batch([facts])):
        with pytest.raises(FactError) as caught:
            evaluate(Facts.parse(text))
        assert message in str(caught.value)


# -- observations -------------------------------------------------------------------------------

SEEN = {
    "observation": {
        "people": {"key": "people", "fields": ["x", "y"], "present": "mask"},
        "car": {"key": "car", "fields": ["x", "y", "speed"]},
    },
    "entities": {"person": {"from": "people", "at_most": 3}},
    "facts": {
        "P(X in person)": "1",
        "Distance(X in person, ego)": "hypot(X.x - car.x, X.y - car.y)",
        "Speed(ego)": "car.speed",
    },
}
RULES = (
    "h(X) :- P(Y), below(Distance(Y, X), 4, margin=4), Speed(X) > 1.",
    "h(X) :- Distance(Y, X) >= 5, not Speed(X) >= 4.",
)


def observation(n, seed=0):
    random = np.random.default_rng(seed)
    return {
        "people": random.uniform(-4, 4, (n, 3, 2)),
        "mask": random.random((n, 3)) < 0.7,
        "car": random.uniform(0, 5, (n, 3)),
    }


@pytest.mark.parametrize("library", ["numpy", "torch"])
def test_observed_values(library):
    reward = RewardFunction(program(*RULES, **SEEN))
    many = observation(64)
    given = many
    if library == "torch":
        torch = pytest.importorskip("torch")
        given = {name: torch.as_tensor(part) for name, part in many.items()}
    for _ in range(3):  # the later ones are repeated from a tape
        found = reward.transition(given)
        for row in range(64):
            scene = {name: part[row] for name, part in many.items()}
            outcome = reward.transition(scene)
            assert float(found.reward[row]) == pytest.approx(outcome.reward)
            facts = reward.observe(scene)
            naive = naive_conclusions(reward.kb, facts).get(("h", ("ego",)))
            assert outcome.bounds["h"] == (naive and pytest.approx(naive))


def test_observations_become_values():
    reward = RewardFunction(program(*RULES, **SEEN))
    facts = reward.observe({"people": [[3, 4], [1, 1]], "mask": [1, 0], "car": [0, 0, 2]})
    assert facts == Facts.parse("P(person1). Distance(person1, ego) = 5. Speed(ego) = 2.")


def test_gradients_go_through_soft_comparisons():
    torch = pytest.importorskip("torch")
    reward = RewardFunction(program(RULES[0], **SEEN))
    car = torch.tensor([[0.0, 0.0, 2.0]], requires_grad=True)
    people = torch.tensor([[[3.0, 4.0]]])
    given = {"people": people, "mask": torch.tensor([[True]]), "car": car}
    reward.transitions(given).reward.sum().backward()
    assert car.grad[0, 0] > 0.0  # nearer is more


@pytest.mark.parametrize("wrong", [math.inf, math.nan])
def test_observed_values_are_finite(wrong):
    reward = RewardFunction(program(*RULES, **SEEN))
    one = {"people": [[wrong, 4.0]], "mask": [True], "car": [0.0, 0.0, 2.0]}
    many = {name: np.array([part]) for name, part in one.items()}
    for step in (one, many):
        with pytest.raises(FactError, match=r"Distance\(person1, ego\)|person1.x is NaN"):
            reward.transition(step)
    nobody = {**one, "mask": [False]}
    assert reward.transition(nobody).reward == 0.0
    assert reward.transition({n: np.array([p]) for n, p in nobody.items()}).reward[0] == 0.0


def test_observed_values_have_no_settings_of_confidences():
    facts = {**SEEN["facts"], "Speed(ego)": {"formula": "car.speed", "bounds": "exact"}}
    with pytest.raises(InvalidKnowledgeBase, match="whose value has no 'bounds'"):
        program(*RULES, **{**SEEN, "facts": facts})


# -- logs and tools -----------------------------------------------------------------------------


def test_logs_keep_values(tmp_path):
    pytest.importorskip("pyarrow")
    kb = program("h(X) :- Distance(_, X) < 5.")
    facts = Facts.parse("P(a): [0.1, 0.3]. Distance(a, ego) = 0.1. Heat = 300.")
    with LogWriter(tmp_path / "log.parquet", kb) as log:
        log.step(facts, 0.0)
        log.step(Facts(), 0.1)
        log.end_episode("success")
    log = read_log(tmp_path / "log.parquet")
    steps = log.episodes[0].steps
    assert [step.facts for step in steps] == [facts, Facts()]
    other = program("h(X) :- P(X).", attributes={"Heat": ""})
    assert unknown_names(log, other) == ("Distance",)
    assert known(steps[0], other)[0] == Facts.parse("P(a): [0.1, 0.3]. Heat = 300.")


def test_logs_without_attributes_are_as_before(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    kb = program("h(X) :- P(X).", attributes={})
    with LogWriter(tmp_path / "log.parquet", kb) as log:
        with pytest.raises(UsageError, match="has no attributes"):
            log.step(Facts.parse("Heat = 3."), 0.0)
        log.step(Facts.parse("P(a)."), 0.0)
    file = parquet.ParquetFile(tmp_path / "log.parquet")
    assert json.loads(file.metadata.metadata[b"sfol"])["version"] == 1
    assert "values" not in file.schema_arrow.names
    assert read_log(tmp_path / "log.parquet").episodes[0].steps[0].facts == Facts.parse("P(a).")


def test_explanations_show_the_value_and_the_limit():
    reward = RewardFunction(program("h(X) :- P(X), Speed(X) < 10."))
    held = str(reward.explain(Facts.parse("P(ego). Speed(ego) = 7.5.")))
    assert "Speed(ego) < 10 [1, 1]  Speed(ego) = 7.5" in held
    failed = str(reward.explain(Facts.parse("P(ego). Speed(ego) = 12.")))
    assert "lacks Speed(ego) < 10 (it is 12)" in failed
    denied = RewardFunction(program("h(X) :- P(X), not Speed(X) < 10."))
    assert "not Speed(ego) < 10 (it is 7.5)" in str(
        denied.explain(Facts.parse("P(ego). Speed(ego) = 7.5."))
    )


def test_a_file_says_the_same_again(tmp_path):
    kb = program(*RULES, **SEEN)
    (tmp_path / "road.yaml").write_text(to_yaml(kb))
    again = KnowledgeBase.load(tmp_path / "road.yaml")
    assert again.hash == kb.hash
    assert again.attributes == kb.attributes
    assert pickle.loads(pickle.dumps(kb)).comparisons == kb.comparisons


def test_overlays_replace_and_remove_attributes(tmp_path):
    (tmp_path / "road.yaml").write_text(to_yaml(program("h(X) :- Speed(X) > 1.")))
    (tmp_path / "more.yaml").write_text(
        "version: 2\nname: more\nextends: road\nremove: {attributes: [Heat]}\n"
        "attributes: {Speed(Y): in km/h}\n"
    )
    kb = KnowledgeBase.load(tmp_path / "more.yaml")
    assert {name: a.description for name, a in kb.attributes.items()} == {
        "Distance": DECLARED["Distance(P, X)"],
        "Speed": "in km/h",
    }


def test_the_hash_tells_a_value_from_a_bound():
    of_value = program("h(X) :- Speed(X) >= 0.5.")
    of_bound = program(
        "h(X) :- Speed(X) >= 0.5.", attributes={}, predicates={"Speed(X)": "", "P(X)": ""}
    )
    assert str(of_value.rules["r0"]) == str(of_bound.rules["r0"])
    assert of_value.hash != of_bound.hash


def messages(kb, code):
    return [finding.message for finding in lint(kb) if finding.code == code]


def test_tools_know_attributes():
    kb = program(*RULES, **SEEN)
    graph = dependency_graph(kb)
    speed = GraphNode("attribute", "Speed")
    assert graph.edges[speed, GraphNode("rule", "r1")]["negated"]
    assert not graph.edges[speed, GraphNode("rule", "r0")]["negated"]
    assert "nothing reads the attribute 'Heat'" in messages(kb, "SF003")
    less = {name: text for name, text in SEEN["facts"].items() if "Speed" not in name}
    (ungiven,) = messages(program(*RULES, **{**SEEN, "facts": less}), "SF016")
    assert ungiven.startswith("rules read the attribute 'Speed'")
    changes = compare(kb, program(*RULES, **SEEN, attributes={**DECLARED, "Heat": "in °C"}))
    assert [(change.section, change.name) for change in changes] == [("attributes", "Heat")]
    assert "attributes" in json_schema()["properties"]


def test_fmt_makes_blanks_regular():
    text = "h(X):-Speed(X)<-1,below( Distance(P,X) ,10 , margin = 5,shape=linear)."
    expected = "h(X) :- Speed(X) < -1, below(Distance(P, X), 10, margin=5, shape=linear)."
    assert format_clause(text) == expected
    assert format_clause("Speed(a)=1.Heat  =3 .") == "Speed(a) = 1. Heat = 3."
    file = "attributes:\n  Distance( P,X ) : m  # near\n"
    assert format_file(file) == "attributes:\n  Distance(P, X) : m  # near\n"
