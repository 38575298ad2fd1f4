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
Edges = list[tuple[str, str, str]]  # of a graph: what it says, from whom, to whom
Spans = dict[str, tuple[int, int]]  # atoms of nodes: the first and the last step of each
Steps = list[set[str]]  # of whom something holds, at each step


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


# Who knows somebody that heard it the step before, and is awake, has heard it now.
RUMOUR = knowledge_base(
    ["heard(X)", "Knows(X, Y)", "Awake(X)"],
    {"spread": "heard(X) :- previously(heard(Y)), Knows(X, Y), Awake(X)."},
)
RUMOUR_RULE = "heard(x) <-1 heard(y), Knows(x,y), Awake(x)"

# Something is signed if all who are asked to sign it have: nobody who is asked has not.
SIGNED = knowledge_base(
    ["Asked(X, Y)", "Signs(X)", "signed(Y)"],
    {
        "open": "open(Y) :- Asked(X, Y), not Signs(X).",
        "signed": "signed(Y) :- Asked(_, Y), not open(Y).",
    },
)
SIGNED_RULE = "signed(y) <- Asked(x,y), Signs(x)"


def by_pyreason(
    library, runtime, head: str, rule: str, edges: Edges, facts: Spans, thresholds=None
) -> Steps:
    """Return of whom the head certainly holds.

    The runtime has the functions without which PyReason would compile itself once more.
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
    # It ends as soon as nothing more can change, and then nothing is known any more.
    return [
        {node for node, bounds in answer.get(t, {}).items() if bounds[head] == (1, 1)}
        for t in range(4)
    ]


def by_rules(kb, head: str, edges: Edges, facts: Spans, engine="compiled") -> Steps:
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
    """Yield graphs and facts: some by hand, and some that are drawn."""
    knows = [("Knows", "bob", "ann"), ("Knows", "cleo", "bob"), ("Knows", "dan", "bob")]
    yield knows, {"heard(ann)": (0, 2), **{f"Awake({x})": (0, 3) for x in ("ann", "bob", "cleo")}}
    for seed in range(6):
        draw = random.Random(seed)
        pairs = [("Knows", x, y) for x, y in product(PEOPLE, PEOPLE) if x != y]
        first = draw.choice([0, 0, 1])
        yield (
            [pair for pair in pairs if draw.random() < 0.5] or pairs,
            {
                "heard(ann)": (first, draw.randint(first, 3)),
                **{f"Awake({x})": (draw.randint(0, 1), 3) for x in PEOPLE if draw.random() < 0.7},
            },
        )


@pytest.mark.parametrize(("edges", "facts"), list(rumours()))
def test_a_rule_with_a_delay_is_a_rule_about_the_step_before(
    pyreason, library, runtime, edges, facts
):
    expected = by_pyreason(library, runtime, "heard", RUMOUR_RULE, edges, facts)
    assert by_rules(RUMOUR, "heard", edges, facts) == expected
    assert by_rules(RUMOUR, "heard", edges, facts, engine="pyreason") == expected


def test_a_rumour_by_hand():
    edges, facts = next(rumours())
    steps = [{"ann"}, {"ann", "bob"}, {"ann", "bob", "cleo"}, {"bob", "cleo"}]
    assert by_rules(RUMOUR, "heard", edges, facts) == steps


def signatures():
    """Yield who is asked to sign a letter, and when they do; a share is one of all who are asked.

    With a second letter PyReason would count those who are asked for either of them together.
    """
    for seed in range(6):
        draw = random.Random(seed)
        asked = draw.sample(PEOPLE, draw.randint(1, 4))
        edges = [("Asked", x, "letter") for x in asked]
        yield edges, {f"Signs({x})": (draw.randint(0, 2), draw.randint(2, 3)) for x in asked}


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
    edges = [("Asked", x, "letter") for x in ("ann", "bob")] + [("Asked", "ann", "card")]
    facts = {"Signs(ann)": (0, 3), "Signs(bob)": (2, 3)}
    assert by_rules(SIGNED, "signed", edges, facts) == [
        {"card"}, {"card"}, {"card", "letter"}, {"card", "letter"}
    ]  # fmt: skip
