"""Proof trees: everything that a reward rests on, and nothing else."""

import json

import pytest

from sfol import Facts, RewardFunction

FACTS = Facts.parse(
    "Pedestrian(p1): [0.76, 0.84]. Pedestrian(p2). OnRoad(p1). OnRoad(p2). CenterOf(p1, ego)."
    "CenterOf(p2, ego). Truck(t1): [0.9, 0.9]. Crosswalk(a1). RightOf(t1, ego). Occludes(t1, a1)."
)
SIGNALS = {"v": 6.0, "v_next": 5.5, "d": 9.0}


@pytest.fixture(scope="module")
def explanation():
    return RewardFunction("aeb").explain(FACTS, **SIGNALS)


def nodes(tree, kind):
    found = [tree] if tree["kind"] == kind else []
    return found + [node for child in tree["children"] for node in nodes(child, kind)]


def test_it_reads_from_the_reward_down_to_the_facts(explanation):
    text = str(explanation)
    for part in (
        "reward -",
        "safety -",
        "d = 9 m",
        "weight safety",
        "safe1(ego)",
        "rule safe1 with X = ego, P = p1; X = ego, P = p2",
        "Pedestrian(p1) [0.76, 0.84]  asserted",
        "Vehicle(ego) [1, 1]  background",
        "Vehicle(t1) [0.9, 0.9]  derived",
        "Truck(t1) [0.9, 0.9]  asserted",
        "safe2(ego): nothing concluded",
    ):
        assert part in text
    assert max(map(len, text.splitlines())) <= 110


def test_the_tree_agrees_with_the_outcome(explanation):
    outcome = RewardFunction("aeb").evaluate(FACTS, **SIGNALS)
    tree = explanation.to_dict()
    assert tree["value"] == outcome.reward
    assert {n["name"]: n["value"] for n in nodes(tree, "term")} == outcome.terms
    assert {n["name"]: n["value"] for n in nodes(tree, "weight")} == outcome.weights
    heads = {n["atom"]: tuple(n["bound"]) for n in nodes(tree, "head")}
    assert heads == {"safe1(ego)": outcome.bounds["safe1"], "safe3(ego)": outcome.bounds["safe3"]}
    assert sum(n["share"] for n in nodes(tree, "term")) == pytest.approx(1)
    rules = {n["name"]: n for n in nodes(tree, "rule")}
    assert set(rules) == {"safe1", "safe3_right", "truck_is_vehicle"}
    assert rules["safe1"]["substitutions"] == [{"X": "ego", "P": "p1"}, {"X": "ego", "P": "p2"}]


def test_it_is_json(explanation):
    assert json.loads(json.dumps(explanation.to_dict())) == explanation.to_dict()


def test_a_depth_limit_cuts_and_says_so():
    reward = RewardFunction("aeb")
    shallow = str(reward.explain(FACTS, **SIGNALS).cut(1))
    assert "safety -" in shallow
    assert "safe1" not in shallow
    assert "…" in shallow
    assert len(str(reward.explain(FACTS, **SIGNALS).cut(0)).splitlines()) == 2
    deep = reward.explain(FACTS, **SIGNALS).cut(50)
    assert deep.to_dict() == reward.explain(FACTS, **SIGNALS).to_dict()


def test_a_negated_literal_of_an_unknown_atom(kitchen):
    kb = kitchen({"Pot(P), Hot(P), Near(P, X)": "not Lid(X)"})
    assert "not Lid(cook) [1, 1]  unknown" in str(RewardFunction(kb).explain(Facts(), speed=1.0))


@pytest.mark.parametrize(
    ("facts", "line"),
    [
        ("Pedestrian(p1). OnRoad(p1). LeftOf(p1, ego).", "rule safe1 lacks CenterOf(p1, ego), with X = ego, P = p1"),
        ("Pedestrian(p1). OnRoad(p1): [0, 0]. CenterOf(p1, ego).", "rule safe1 lacks OnRoad(p1) (known to be false)"),
        ("Pedestrian(p1). OnRoad(p2). CenterOf(p1, ego).", "rule safe1 lacks OnRoad(p1), with"),
        ("", "rule efficiency1 lacks NoCrosswalk(ego) and EmptyLane(ego), with X = ego"),
        ("Crosswalk(a). Vehicle(v).", "rule safe3_left lacks LeftOf(v, ego) and Occludes(v, a)"),
        ("", "rule safe1 lacks Pedestrian(P) and OnRoad(P) and CenterOf(P, ego), with X = ego"),
    ],
)  # fmt: skip
def test_why_a_rule_did_not_fire(facts, line):
    text = str(RewardFunction("aeb").explain(Facts.parse(facts), **SIGNALS))
    assert line in " ".join(text.replace("│", " ").split())


@pytest.mark.parametrize(
    ("body", "facts", "reason"),
    [
        ("Near(P, X), not Lid(P)", "Near(p, cook). Lid(p): [0.1, 0.9].", "lacks not Lid(p) (it is [0.1, 0.9])"),
        ("Near(P, X), Near(Q, X), P != Q", "Near(p, cook).", "lacks p != p"),
        ("not Lid(X)", "Lid(cook).", "lacks not Lid(cook) (it is [1, 1])"),
    ],
)  # fmt: skip
def test_why_negation_and_guards_did_not_hold(kitchen, body, facts, reason):
    kb = kitchen({"Pot(P), Hot(P), Near(P, X)": body})
    assert reason in str(RewardFunction(kb).explain(Facts.parse(facts), speed=1.0))


def test_a_threshold_that_was_not_reached(kitchen):
    rule = "care: careful(X) :- Person(X), Pot(P), Hot(P), Near(P, X)."
    kb = kitchen({rule: "care: {rule: 'careful(X) :- Person(X), Hot(X).', threshold: 0.5}"})
    text = str(RewardFunction(kb).explain(Facts.parse("Hot(cook): [0.4, 0.9]."), speed=1.0))
    assert "lacks Hot(cook) (its [0.4, 0.9] is below the threshold 0.5)" in text


def test_the_tree_as_a_graph(explanation):
    graph = explanation.to_networkx()
    assert len(graph) == str(explanation.to_dict()).count("'kind'")
    assert graph.nodes[0]["kind"] == "reward"
    assert [graph.nodes[n]["name"] for n in graph.successors(0)] == [
        "safety",
        "efficiency",
        "comfort",
    ]
    assert all(degree == 1 for node, degree in graph.in_degree() if node)
