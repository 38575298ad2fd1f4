"""What the PyReason engine says, refuses, hands out and leaves as it found it."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import networkx
import pytest

from sfol import Atom, Facts, KnowledgeBase, RewardFunction
from sfol.engines.compiled import CompiledEngine
from sfol.errors import FactError, KnowledgeBaseError, MissingExtraError, UsageError
from sfol.knowledge_base import KnowledgeBaseFile
from sfol.operators import CONJUNCTIONS
from sfol.testing.laws import assert_same
from tests.differential.programs import program

SCENE = (
    "Pedestrian(p1): [0.76, 0.84]. OnRoad(p1): [0.9, 1.0]. CenterOf(p1, ego). Truck(t1): [0.665, 0.735]."
    "Crosswalk(a1). Occludes(t1, a1). RightOf(t1, ego)."
)


def test_a_reward_function_with_pyreason(pyreason):
    facts, signals = Facts.parse(SCENE), {"v": 6.0, "v_next": 5.5, "d": 9.0}
    outcome = RewardFunction("aeb", engine="pyreason").evaluate(facts, **signals)
    expected = RewardFunction("aeb").evaluate(facts, **signals)
    assert outcome.reward == pytest.approx(expected.reward, abs=1e-9)
    assert outcome.bounds == {
        head: None if b is None else pytest.approx(b) for head, b in expected.bounds.items()
    }
    explained = RewardFunction("aeb", engine="pyreason").explain(facts, **signals)
    assert str(explained) == str(RewardFunction("aeb").explain(facts, **signals))


def test_rules_with_a_cycle_are_named(pyreason):
    kb = program("h(X) :- P(X).", "h(X) :- R(Y, Z), S(Z, Y), P(X).", "h(X) :- R(X, Y), S(Y, X).")
    assert pyreason(kb).grounded_for_pyreason == {"rule1"}


def test_a_name_that_pyreason_reads_as_a_quantifier_is_refused(pyreason):
    kb = KnowledgeBase.load("aeb")
    kb = program("h(X) :- P(X).").__class__(
        **{**vars(kb), "predicates": {**kb.predicates, "forall": kb.predicates["Truck"]}}
    )
    with pytest.raises(KnowledgeBaseError, match="the predicate 'forall'") as caught:
        pyreason(kb)
    assert caught.value.name == "forall"


@pytest.mark.parametrize(
    ("signature", "rule", "count"),
    [
        ("Raining", "h(X) :- P(X), Raining.", 0),
        ("Raining", "h(X) :- P(X), not Raining.", 0),
        ("Raining", "Raining :- P(X).", 0),
        ("Between(X, Y, Z)", "h(X) :- Between(X, X, Y).", 3),
        ("Gives(X, Y, Z, W)", "h(X) :- P(X), not Gives(X, _, _, _).", 4),
    ],
)
def test_predicates_that_are_neither_of_a_node_nor_of_an_edge_are_refused(
    pyreason, signature, rule, count
):
    content = {
        "version": 1,
        "name": "program",
        "predicates": dict.fromkeys(["P(X)", "h(X)", signature], ""),
        "rules": {"rule": rule},
    }
    kb = KnowledgeBase.of(KnowledgeBaseFile.model_validate(content))
    name = signature.partition("(")[0]
    message = f"can't express the predicate '{name}' with {count} arguments"
    with pytest.raises(KnowledgeBaseError, match=message) as caught:
        pyreason(kb)
    assert caught.value.name == name
    # What no rule reads or concludes is nothing that PyReason has to express.
    without = KnowledgeBase.of(
        KnowledgeBaseFile.model_validate({**content, "rules": {"rule": "h(X) :- P(X)."}})
    )
    facts = Facts.parse("P(ego).")
    assert_same(
        CompiledEngine(without).conclude(facts).derived, pyreason(without).conclude(facts).derived
    )


def test_a_program_names_integers_and_texts_so_that_pyreason_can_read_them(library, runtime):
    kb = program('h(X) :- R(X, "Mary Ann"), S(X, 7).')
    graph, rules, _ = kb.to_pyreason(Facts.parse('R(ego, "Mary Ann"). S(ego, 7).'))
    assert set(graph.nodes) == {"ego", "integer.7", "text.4d61727920416e6e"}
    assert len(rules) == 1


def test_the_trace_has_the_constants_of_the_knowledge_base(pyreason):
    (row,) = pyreason(program("h(X) :- P(X), R(X, Y).")).trace(
        Facts.parse('P(ego). R(ego, "A, b").')
    )
    assert {found for _, found in row.clauses} == {
        (Atom("P", ("ego",)),),
        (Atom("R", ("ego", '"A, b"')),),
    }


def test_facts_that_do_not_fit(pyreason):
    with pytest.raises(FactError, match="unknown predicate 'Nonsense'"):
        pyreason(KnowledgeBase.load("aeb")).conclude(Facts.parse("Nonsense(ego)."))


def test_the_trace_tells_which_atoms_satisfied_which_clause(pyreason):
    rows = pyreason(KnowledgeBase.load("aeb")).trace(Facts.parse(SCENE))
    by_rule = {row.rule: row for row in rows}
    assert set(by_rule) == {"truck_is_vehicle", "safe1", "safe3_right"}
    safe3 = by_rule["safe3_right"]
    assert safe3.head == Atom("safe3", ("ego",))
    assert safe3.bound == pytest.approx(((4 + 0.665) / 5, (4 + 0.735) / 5))
    atoms = {atom for _, found in safe3.clauses for atom in found}
    assert Atom("Vehicle", ("t1",)) in atoms
    assert Atom("Occludes", ("t1", "a1")) in atoms
    assert "safe3_right: safe3(ego) [0.933, 0.947] from" in str(safe3)


def test_the_trace_of_a_head_of_two_arguments(pyreason):
    (row,) = pyreason(program("e(X, Y) :- R(X, Z), S(Z, Y).")).trace(
        Facts.parse("R(a, m): [0.5, 0.5]. S(m, b).")
    )
    assert row.head == Atom("e", ("a", "b"))
    assert {found for _, found in row.clauses} == {
        (Atom("R", ("a", "m")),),
        (Atom("S", ("m", "b")),),
    }


def test_the_program_of_a_scene_runs_on_its_own(library, runtime):
    graph, rules, facts = KnowledgeBase.load("aeb").to_pyreason(Facts.parse(SCENE))
    assert isinstance(graph, networkx.DiGraph)
    assert set(graph.nodes) == {"ego", "p1", "t1", "a1"}
    assert ("t1", "a1") in graph.edges
    library.reset()
    library.settings.allow_ground_rules = True
    library.load_graph(graph)
    for function in runtime.annotation_functions():
        library.add_annotation_function(function)
    for rule in rules:
        library.add_rule(rule)
    for fact in facts:
        library.add_fact(fact)
    concluded = library.reason(timesteps=0)
    bounds = {
        (label.get_value(), node): (world.world[label].lower, world.world[label].upper)
        for node, world in concluded.interpretations_node.items()
        for label in world.world
    }
    assert bounds["safe1.4", "ego"] == pytest.approx((0.915, 0.96))


def test_settings_of_others_do_not_matter(pyreason, library, capsys):
    kb = KnowledgeBase.load("aeb")
    library.settings.verbose = True
    library.settings.update_mode = "override"
    library.settings.inconsistency_check = False
    library.settings.allow_ground_rules = False
    library.settings.graph_attribute_parsing = True
    facts = Facts.parse(SCENE)
    assert_same(CompiledEngine(kb).conclude(facts).derived, pyreason(kb).conclude(facts).derived)
    assert capsys.readouterr().out == ""


def test_threads_share_it(pyreason):
    kb = KnowledgeBase.load("aeb")
    engine, compiled = pyreason(kb), CompiledEngine(kb)
    scenes = [
        Facts.parse(f"Pedestrian(p1): {i / 10}. OnRoad(p1). CenterOf(p1, ego).") for i in range(8)
    ]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(engine.conclude, scenes))
    for facts, conclusions in zip(scenes, found, strict=True):
        assert_same(compiled.conclude(facts).derived, conclusions.derived)


def test_every_function_has_a_fixed_identity(runtime):
    functions = runtime.annotation_functions()
    names = [function.__name__ for function in functions]
    assert names == ["average", *(f"best_{name}" for name in CONJUNCTIONS)]
    assert [function._uuid for function in functions] == [f"sfol-{name}" for name in names]


def test_where_numba_has_no_identity_to_set_the_function_is_taken_as_it_is(runtime, monkeypatch):
    numba = SimpleNamespace(njit=lambda cache: lambda function: function)
    monkeypatch.setattr(runtime, "_numba", numba)
    assert runtime._with_identity(len) is len


def test_the_environment_is_left_as_it_was(runtime, monkeypatch):
    code = "import os, sfol.engines.pyreason_runtime; print(os.environ['NUMBA_CACHE_DIR'])"
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/nowhere/of/mine")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "/nowhere/of/mine\n"
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    with runtime._kept_environment("NUMBA_CACHE_DIR"):
        os.environ["NUMBA_CACHE_DIR"] = "/of/theirs"
    assert "NUMBA_CACHE_DIR" not in os.environ


def test_without_pyreason_the_error_names_the_extra(monkeypatch):
    monkeypatch.delitem(sys.modules, "sfol.engines.pyreason_runtime", raising=False)
    monkeypatch.setitem(sys.modules, "pyreason", None)
    with pytest.raises(MissingExtraError, match=r"sfol\[pyreason\]"):
        RewardFunction("aeb", engine="pyreason")
    with pytest.raises(MissingExtraError):
        KnowledgeBase.load("aeb").to_pyreason(Facts())


def test_a_folder_that_cannot_be_written_is_an_error_that_says_so(runtime, monkeypatch):
    def refuse(name):
        raise PermissionError(f"[Errno 13] Permission denied: {name}")

    monkeypatch.setattr(runtime.importlib, "import_module", refuse)
    with pytest.raises(UsageError, match="can't write into its own folder"):
        runtime._import_pyreason()


def test_import_sfol_imports_nothing_of_pyreason():
    names = ("pyreason", "numba", "hypothesis", "networkx")
    code = f"import sfol, sys; print([m for m in {names!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.long
def test_a_second_process_finds_everything_in_the_cache(library):
    cache = Path(library.__file__).parent / "cache"
    code = (
        "from sfol import *; r = RewardFunction('aeb', engine='pyreason');"
        "r(Facts.parse('Pedestrian(p1). OnCrosswalk(p1).'), v=1, v_next=1, d=1)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)  # a first one may still add to it
    before = sorted((path, path.stat().st_size) for path in cache.rglob("*"))
    subprocess.run([sys.executable, "-c", code], check=True)
    assert before == sorted((path, path.stat().st_size) for path in cache.rglob("*"))
    assert before
