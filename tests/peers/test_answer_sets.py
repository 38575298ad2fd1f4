"""Classics of answer set programming: what a candidate comes to, as clingo says.

A knowledge base chooses nothing; it judges what there is. So each program here gets a candidate as
facts, and has the part of the classic that tests it. Where clingo is installed, random candidates
are given to it as well.
"""

from dataclasses import dataclass
from itertools import product
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfol import Atom, Facts, KnowledgeBase, RewardFunction
from sfol.knowledge_base import KnowledgeBaseFile


@dataclass(frozen=True)
class Classic:
    """A program in both languages.

    Attributes:
        predicates: what facts give; in clingo they are written with small letters.
        rules: the program; the last one says whether the candidate is a solution.
        clingo: the same for clingo.
        facts: predicates and what their arguments are drawn from.
        examples: candidates, and all that follows from each, by hand.
    """

    predicates: tuple[str, ...]
    rules: tuple[str, ...]
    clingo: str
    facts: dict[str, tuple[tuple[str, ...], ...]]
    examples: dict[str, str]

    @property
    def heads(self) -> list[str]:
        return [rule.partition(" :-")[0].partition("(")[0] for rule in self.rules]


NODES = ("a", "b", "c", "d")
NUMBERS = ("1", "2", "3", "4")
GRAPH = {"Node": (NODES,), "Edge": (NODES, NODES)}

CLASSICS = {
    "colouring": Classic(
        predicates=("Node(X)", "Edge(X, Y)", "Colour(X, C)"),
        rules=(
            "clash(X, Y) :- Edge(X, Y), Colour(X, C), Colour(Y, C).",
            "bare(X) :- Node(X), not Colour(X, _).",
            "gaudy(X) :- Node(X), count(C: Colour(X, C)) >= 2.",
            "bad :- clash(_, _) or bare(_) or gaudy(_).",
            "proper :- Node(_), not bad.",
        ),
        clingo="""
            clash(X, Y) :- edge(X, Y), colour(X, C), colour(Y, C).
            bare(X) :- node(X), not colour(X, _).
            gaudy(X) :- node(X), #count{C : colour(X, C)} >= 2.
            bad :- clash(_, _).  bad :- bare(_).  bad :- gaudy(_).
            proper :- node(_), not bad.
        """,
        facts={**GRAPH, "Colour": (NODES, ("red", "green", "blue"))},
        examples={
            "Node(a). Node(b). Node(c). Node(d). Edge(a, b). Edge(b, c). Edge(c, d)."
            "Colour(a, red). Colour(b, red). Colour(c, green). Colour(c, blue).": (
                "clash(a, b). bare(d). gaudy(c). bad."
            ),
            "Node(a). Node(b). Edge(a, b). Colour(a, red). Colour(b, blue).": "proper.",
        },
    ),
    "queens": Classic(
        predicates=("Line(N)", "Queen(R, C)", "Rising(R, C, D)", "Falling(R, C, D)"),
        rules=(
            "row(R) :- Line(R), count(C: Queen(R, C)) >= 2.",
            "column(C) :- Line(C), count(R: Queen(R, C)) >= 2.",
            "rising(D) :- Rising(_, _, D), count(R, C: Queen(R, C), Rising(R, C, D)) >= 2.",
            "falling(D) :- Falling(_, _, D), count(R, C: Queen(R, C), Falling(R, C, D)) >= 2.",
            "attacked :- row(_) or column(_) or rising(_) or falling(_).",
            "solved :- count(R, C: Queen(R, C)) >= 4, not attacked.",
        ),
        clingo="""
            line(1..4).
            row(R) :- line(R), #count{C : queen(R, C)} >= 2.
            column(C) :- line(C), #count{R : queen(R, C)} >= 2.
            rising(D) :- D = -3..3, #count{R, C : queen(R, C), R - C = D} >= 2.
            falling(D) :- D = 2..8, #count{R, C : queen(R, C), R + C = D} >= 2.
            attacked :- row(_).  attacked :- column(_).
            attacked :- rising(_).  attacked :- falling(_).
            solved :- #count{R, C : queen(R, C)} >= 4, not attacked.
        """,
        facts={"Queen": (NUMBERS, NUMBERS)},
        examples={
            "Queen(1, 1). Queen(2, 2). Queen(2, 4). Queen(3, 1).": (
                "row(2). column(1). rising(0). falling(4). attacked."
            ),
            "Queen(1, 2). Queen(2, 4). Queen(3, 1). Queen(4, 3).": "solved.",
            "Queen(1, 2). Queen(2, 4). Queen(3, 1).": "",
        },
    ),
    "dominating set": Classic(
        predicates=("Node(X)", "Edge(X, Y)", "Chosen(X)"),
        rules=(
            "dominated(X) :- Node(X), (Chosen(X) or (Edge(Y, X), Chosen(Y))).",
            "open :- Node(X), not dominated(X).",
            "large :- count(X: Chosen(X)) >= 3.",
            "answer :- Node(_), not open, not large.",
        ),
        clingo="""
            dominated(X) :- node(X), chosen(X).
            dominated(X) :- node(X), edge(Y, X), chosen(Y).
            open :- node(X), not dominated(X).
            large :- #count{X : chosen(X)} >= 3.
            answer :- node(_), not open, not large.
        """,
        facts={**GRAPH, "Chosen": (NODES,)},
        examples={
            "Node(a). Node(b). Node(c). Edge(a, b). Edge(c, a). Chosen(a). Chosen(c).": (
                "dominated(a). dominated(b). dominated(c). answer."
            ),
            "Node(a). Node(b). Edge(b, a). Chosen(a).": "dominated(a). open.",
        },
    ),
    "reachability": Classic(
        predicates=("Node(X)", "Edge(X, Y)", "Start(X)"),
        rules=(
            "reached(X) :- Start(X) or (reached(Y), Edge(Y, X)).",
            "apart(X) :- Node(X), not reached(X).",
            "connected :- Node(_), not apart(_).",
        ),
        clingo="""
            reached(X) :- start(X).
            reached(X) :- reached(Y), edge(Y, X).
            apart(X) :- node(X), not reached(X).
            connected :- node(_), not apart(_).
        """,
        facts={**GRAPH, "Start": (NODES,)},
        examples={
            "Node(a). Node(b). Node(c). Node(d). Start(a). Edge(a, b). Edge(b, a). Edge(c, b).": (
                "reached(a). reached(b). apart(c). apart(d)."
            ),
            "Node(a). Node(b). Node(c). Start(a). Edge(a, c). Edge(c, b).": (
                "reached(a). reached(b). reached(c). connected."
            ),
        },
    ),
    "round trip": Classic(
        predicates=("Node(X)", "Edge(X, Y)", "In(X, Y)", "Start(X)"),
        rules=(
            "wrong :- In(X, Y), not Edge(X, Y).",
            "forks(X) :- Node(X), count(Y: In(X, Y)) >= 2.",
            "joins(X) :- Node(X), count(Y: In(Y, X)) >= 2.",
            "reached(Y) :- In(X, Y), (Start(X) or reached(X)).",
            "missed(X) :- Node(X), not reached(X).",
            "tour :- Node(_), not wrong, not forks(_), not joins(_), not missed(_).",
        ),
        clingo="""
            wrong :- in(X, Y), not edge(X, Y).
            forks(X) :- node(X), #count{Y : in(X, Y)} >= 2.
            joins(X) :- node(X), #count{Y : in(Y, X)} >= 2.
            reached(Y) :- start(X), in(X, Y).
            reached(Y) :- reached(X), in(X, Y).
            missed(X) :- node(X), not reached(X).
            tour :- node(_), not wrong, not forks(_), not joins(_), not missed(_).
        """,
        facts={**GRAPH, "In": (NODES, NODES), "Start": (NODES,)},
        examples={
            "Node(a). Node(b). Node(c). Start(a). Edge(a, b). Edge(b, c). Edge(c, a). Edge(a, c)."
            "In(a, b). In(b, c). In(c, a).": "reached(a). reached(b). reached(c). tour.",
            # Two round trips are none.
            "Node(a). Node(b). Start(a). Edge(a, a). Edge(b, b). In(a, a). In(b, b).": (
                "reached(a). missed(b)."
            ),
        },
    ),
    "schedule": Classic(
        predicates=(
            *("Task(T)", "At(T, S)", "Needs(T, M)", "After(T, U)"),
            *("Slot(S)", "Machine(M)", "Later(S, Z)"),
        ),
        rules=(
            "busy(M, S) :- Machine(M), Slot(S), count(T: At(T, S), Needs(T, M)) >= 2.",
            "early(T, U) :- After(T, U), At(T, S), At(U, Z), not Later(S, Z).",
            "idle(T) :- Task(T), not At(T, _).",
            "possible :- Task(_), not busy(_, _), not early(_, _), not idle(_).",
        ),
        clingo="""
            slot(1..4).  machine(saw).  machine(drill).
            busy(M, S) :- machine(M), slot(S), #count{T : at(T, S), needs(T, M)} >= 2.
            early(T, U) :- after(T, U), at(T, S), at(U, Z), S <= Z.
            idle(T) :- task(T), not at(T, _).
            possible :- task(_), not busy(_, _), not early(_, _), not idle(_).
        """,
        facts={
            "Task": (NODES,),
            "At": (NODES, NUMBERS),
            "Needs": (NODES, ("saw", "drill")),
            "After": (NODES, NODES),
        },
        examples={
            "Task(a). Task(b). Task(c). Needs(a, saw). Needs(b, saw)."
            "At(a, 2). At(b, 2). After(b, a). After(c, a).": "busy(saw, 2). early(b, a). idle(c).",
            "Task(a). Task(b). Needs(a, saw). Needs(b, saw). At(a, 1). At(b, 3). After(b, a).": (
                "possible."
            ),
        },
    ),
}

# Numbers are names here, so what clingo computes of them are facts.
ARITHMETIC = {
    "queens": [
        *(f"Line({n})" for n in range(1, 5)),
        *(f"Rising({r}, {c}, {r - c})" for r in range(1, 5) for c in range(1, 5)),
        *(f"Falling({r}, {c}, {r + c})" for r in range(1, 5) for c in range(1, 5)),
    ],
    "schedule": [
        *(f"Slot({n})" for n in range(1, 5)),
        *(f"Machine({name})" for name in ("saw", "drill")),
        *(f"Later({s}, {z})" for s in range(1, 5) for z in range(1, s)),
    ],
}


def reward_of(name):
    classic = CLASSICS[name]
    content = {
        "version": 1,
        "name": "classic",
        "background": ARITHMETIC.get(name, []),
        "semantics": {"conjunction": "minimum"},
        "predicates": dict.fromkeys(classic.predicates, ""),
        "rules": {f"rule{number}": rule for number, rule in enumerate(classic.rules)},
        "terms": {"verdict": {"weight": 1, "formula": classic.heads[-1]}},
    }
    return RewardFunction(KnowledgeBase.of(KnowledgeBaseFile.model_validate(content)))


def concluded(reward, facts):
    """Return the atoms that follow, as texts; all facts are certain, and so is what follows."""
    derived = reward.evaluate(facts).derived
    assert all(bound == (1.0, 1.0) for bound in derived.values())
    return {str(atom) for atom in derived}


@pytest.mark.parametrize(
    ("name", "candidate", "answer"),
    [
        pytest.param(name, candidate, answer, id=f"{name}-{number}")
        for name, classic in CLASSICS.items()
        for number, (candidate, answer) in enumerate(classic.examples.items())
    ],
)
def test_an_example_by_hand(name, candidate, answer):
    expected = {str(atom) for atom in Facts.parse(answer)}
    assert concluded(reward_of(name), Facts.parse(candidate)) == expected


def candidates(classic):
    """Return any set of atoms that a program may be given."""
    atoms = [
        Atom(predicate, arguments)
        for predicate, places in classic.facts.items()
        for arguments in product(*places)
    ]
    return st.sets(st.sampled_from(atoms))


def answer_of_clingo(program, heads):
    """Return the atoms of some heads in the only answer set, as texts."""
    clingo = pytest.importorskip("clingo", reason="clingo is not installed")
    control = clingo.Control(["--warn=none"])
    control.add("base", [], program)
    control.ground([("base", [])])
    with control.solve(yield_=True) as models:
        (symbols,) = [model.symbols(atoms=True) for model in models]
    return {
        str(Atom(symbol.name, tuple(map(str, symbol.arguments))))
        for symbol in symbols
        if symbol.name in heads
    }


@pytest.mark.parametrize("name", CLASSICS)
def test_clingo_agrees(name):
    classic, reward = CLASSICS[name], reward_of(name)

    @given(candidates(classic))
    def agree(candidate):
        facts = Facts.parse("".join(f"{atom}. " for atom in candidate))
        given = "".join(f"{atom}. ".lower() for atom in candidate)
        assert concluded(reward, facts) == answer_of_clingo(classic.clingo + given, classic.heads)

    agree()


# A sum that feeds itself has no meaning within a step, so each step is a round of the recursion.

CONTROLS = RewardFunction(Path(__file__).with_name("company_controls.yaml"))
BY_CLINGO = """
    controls(X, X) :- company(X).
    controls(X, Y) :- company(X), company(Y), #sum{S, Z : controls(X, Z), owns(Z, Y, S)} > 50.
"""


def controlled(percents):
    """Return who controls whom after as many steps as there are companies.

    Args:
        percents: the share of the second company that the first one owns.
    """
    facts = Facts.parse("".join(f"Company({name}). " for name in NODES))
    for (owner, owned), percent in percents.items():
        facts.add("Owns", owner, owned, confidence=percent / 100)
    episode = CONTROLS.episode()
    *_, last = [episode.conclude(facts) for _ in NODES]
    return {str(atom) for atom in last.derived if atom.predicate == "controls"}


def test_companies_by_hand():
    # Of c, a owns 30 percent and by way of b another 21; of d it controls half, not more.
    percents = {("a", "b"): 51, ("a", "c"): 30, ("b", "c"): 21, ("c", "d"): 30, ("a", "d"): 20}
    others = {"controls(a, b)", "controls(a, c)"}
    assert controlled(percents) == others | {f"controls({name}, {name})" for name in NODES}


@given(st.dictionaries(st.tuples(*2 * [st.sampled_from(NODES)]), st.integers(1, 99)))
def test_clingo_agrees_about_companies(percents):
    given_facts = "".join(f"company({name}). " for name in NODES)
    given_facts += "".join(f"owns({x}, {y}, {n}). " for (x, y), n in percents.items())
    assert controlled(percents) == answer_of_clingo(BY_CLINGO + given_facts, ["controls"])
