"""Programs as PyReason's users write them: with delays and thresholds, and PyReason's own answers.

The other tests of this folder hand PyReason queries that were made for it; here it runs the rule
as it stands, by its own steps, beside a knowledge base that says the same.
"""

import random
from itertools import product

import networkx
import pytest

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.knowledge_base import KnowledgeBaseFile

PEOPLE = ("ann", "bob", "cleo", "dan")
ROOMS = ("hall", "attic")
Steps = list[set[str]]


def knowledge_base(predicates, rules):
    content = {
        "version": 1,
        "name": "example",
        "time": {"step": 1, "unit": "steps"},
        "predicates": dict.fromkeys(predicates, ""),
        "rules": rules,
        "terms": {"nothing": {"weight": 1, "formula": "0"}},
    }
    return KnowledgeBase.of(KnowledgeBaseFile.model_validate(content))


# Who knows somebody in the same room who heard it before has heard it now.
RUMOUR = knowledge_base(
    ["heard(X)", "Knows(X, Y)", "In(X, R)"],
    {"spread": "heard(X) :- previously(heard(Y)), Knows(X, Y), In(Y, R), In(X, R)."},
)
RUMOUR_RULE = "heard(x) <-1 heard(y), Knows(x,y), In(y,r), In(x,r)"

# Something is signed if all who are asked to sign it have: nobody who is asked has not.
SIGNED = knowledge_base(
    ["Asked(X, Y)", "Signs(X)", "signed(Y)"],
    {
        "open": "open(Y) :- Asked(X, Y), not Signs(X).",
        "signed": "signed(Y) :- Asked(_, Y), not open(Y).",
    },
)
SIGNED_RULE = "signed(y) <- Asked(x,y), Signs(x)"


def by_pyreason(library, runtime, head, rule, edges, facts, *, thresholds=None) -> Steps:
    """Return of whom the head certainly holds at each step.

    Args:
        library: PyReason.
        runtime: has the functions without which it would compile itself once more.
        head: the predicate.
        rule: of PyReason.
        edges: of the graph, with predicates as their attributes.
        facts: for each atom of a node its first and its last step.
        thresholds: how PyReason quantifies each clause.
    """
    library.reset()
    library.reset_rules()
    library.reset_settings()
    library.settings.verbose = False
    graph = networkx.DiGraph()
    for predicate, x, y in edges:
        graph.add_edge(x, y, **{predicate: 1})
    library.load_graph(graph)
    for function in runtime.annotation_functions():
        library.add_annotation_function(function)
    library.add_rule(library.Rule(rule, "rule", custom_thresholds=thresholds))
    for atom, (first, last) in facts.items():
        library.add_fact(library.Fact(atom, atom, first, last))
    answer = library.reason(timesteps=3).get_dict()
    return [
        {node for node, bounds in answer[t].items() if bounds.get(head) == (1, 1)} for t in range(4)
    ]


def by_rules(kb, head, edges, facts, engine="compiled") -> Steps:
    """Return the same of a knowledge base."""
    episode = RewardFunction(kb, engine=engine).episode()
    found = []
    for t in range(4):
        now = [atom for atom, (first, last) in facts.items() if first <= t <= last]
        scene = Facts.parse("".join(f"{atom}. " for atom in now))
        for edge in edges:
            scene.add(*edge)
        conclusions = episode.conclude(scene)
        known = {*conclusions.derived, *scene}
        found.append({atom.arguments[0] for atom in known if atom.predicate == head})
    return found


def rumours():
    """Return graphs and facts: one by hand, and some that are drawn."""
    knows = [("Knows", "bob", "ann"), ("Knows", "cleo", "bob"), ("Knows", "cleo", "ann")]
    rooms = [("In", "ann", "hall"), ("In", "bob", "hall"), ("In", "bob", "attic")]
    yield [*knows, *rooms, ("In", "cleo", "attic")], {"heard(ann)": (0, 3)}
    for seed in range(6):
        draw = random.Random(seed)
        pairs = [("Knows", x, y) for x, y in product(PEOPLE, PEOPLE) if x != y]
        places = [("In", x, room) for x, room in product(PEOPLE, ROOMS)]
        edges = [edge for edge in [*pairs, *places] if draw.random() < 0.5]
        first = draw.choice([0, 0, 1])
        yield [*edges, ("In", "ann", "hall")], {"heard(ann)": (first, draw.randint(first, 3))}


@pytest.mark.parametrize(("edges", "facts"), list(rumours()))
def test_a_rule_with_a_delay_is_a_rule_about_the_step_before(
    pyreason, library, runtime, edges, facts
):
    expected = by_pyreason(library, runtime, "heard", RUMOUR_RULE, edges, facts)
    assert by_rules(RUMOUR, "heard", edges, facts) == expected
    assert by_rules(RUMOUR, "heard", edges, facts, engine="pyreason") == expected


def test_a_rumour_by_hand():
    edges, facts = next(rumours())
    steps = [{"ann"}, {"ann", "bob"}, {"ann", "bob", "cleo"}, {"ann", "bob", "cleo"}]
    assert by_rules(RUMOUR, "heard", edges, facts) == steps


def signatures():
    yield (
        [("Asked", x, "letter") for x in PEOPLE],
        {f"Signs({x})": (t, 3) for t, x in enumerate(PEOPLE)},
    )
    for seed in range(6):
        draw = random.Random(seed)
        pairs = [("Asked", x, y) for x, y in product(PEOPLE, ("letter", "card"))]
        edges = [edge for edge in pairs if draw.random() < 0.5] or pairs
        facts = {f"Signs({x})": (draw.randint(0, 2), 3) for x in {x for _, x, _ in edges}}
        yield edges, facts


@pytest.mark.parametrize(("edges", "facts"), list(signatures()))
def test_a_threshold_of_all_is_nobody_who_does_not(pyreason, library, runtime, edges, facts):
    thresholds = [
        library.Threshold("greater_equal", ("number", "total"), 1),
        library.Threshold("greater_equal", ("percent", "total"), 100),
    ]
    expected = by_pyreason(
        library, runtime, "signed", SIGNED_RULE, edges, facts, thresholds=thresholds
    )
    assert by_rules(SIGNED, "signed", edges, facts) == expected
    assert by_rules(SIGNED, "signed", edges, facts, engine="pyreason") == expected


def test_signatures_by_hand():
    edges, facts = next(signatures())
    assert by_rules(SIGNED, "signed", edges, facts) == [set(), set(), set(), {"letter"}]
