"""Heads that depend on themselves: what they come to, what is refused, how they are explained."""

import itertools
import pickle
import re

import numpy as np
import pytest

from sfol import Bound, Facts, KnowledgeBase, RewardFunction
from sfol.engines.program import Program
from sfol.engines.tables import Tables
from sfol.errors import InvalidKnowledgeBase, UsageError, WorkLimitError
from sfol.facts import TRUE
from sfol.knowledge_base import KnowledgeBaseFile
from sfol.knowledge_base.printing import to_yaml
from sfol.knowledge_base.recursion import components
from sfol.syntax import Atom
from sfol.testing.laws import assert_same
from sfol.testing.naive import naive_conclusions, naive_episode
from sfol.tools.diff import compare
from sfol.tools.graph import dependency_graph, mermaid, svg
from sfol.tools.lint import lint
from tests.differential.dense import dense_conclusions
from tests.differential.programs import program
from tests.differential.recursive import recursive_scene
from tests.sfol.command_line import sfol
from tests.sfol.test_certainty import H, bounds_of

THERE, ONWARD = "h(X) :- P(X).", "h(X) :- R(X, Y), h(Y)."
FRIENDS = "h(X) :- h(Y), R(X, Y)."
CLOSURE = ("e(X, Y) :- R(X, Y).", "e(X, Z) :- e(X, Y), R(Y, Z).")
WAYS = "R(ego, a): 0.9. R(a, b): 0.7. R(b, a). R(b, c): 0.8. P(c)."


def recursive(*rules, **semantics):
    return program(*rules, **{"conjunction": "minimum", **semantics})


def rule(text, **more):
    return {"rule": text, **more}


@pytest.mark.parametrize(
    ("rules", "facts", "expected"),
    [
        ((THERE, ONWARD), WAYS, (0.7, 0.7)),
        ((THERE, ONWARD), "R(ego, a). R(a, ego). R(a, a).", None),
        ((THERE, ONWARD), "P(ego): [0.2, 0.9]. R(ego, a). R(a, ego).", (0.2, 0.9)),
        ((THERE, ONWARD), "R(ego, a): [0.5, 0.6]. P(a): [0.1, 0.8]. R(ego, b): [0.2, 0.9]. P(b).", (0.2, 0.9)),
        ((THERE, rule(ONWARD, certainty=0.5)), WAYS, (0.1, 0.1)),
        ((THERE, rule(ONWARD, certainty=[0.5, 1])), WAYS, (0.1, 0.7)),
        ((THERE, rule(ONWARD, threshold=0.7)), WAYS, (0.7, 0.7)),
        ((THERE, rule(ONWARD, threshold=0.75)), WAYS, None),
        ((THERE, "h(X) :- R(X, Y), h(Y) >= 0.75."), WAYS, None),
        ((FRIENDS,), "h(a): [0.3, 0.8]. R(b, a): 0.5. R(ego, b).", (0.3, 0.5)),
        ((FRIENDS,), "h(ego): [0.3, 0.8]. R(ego, ego).", (0.3, 0.8)),
        ((FRIENDS,), "R(ego, a). R(a, ego).", None),
        (("h(X) :- h(X).",), "P(ego).", None),
        (("h(X) :- g(Y), R(X, Y).", "g(X) :- h(Y), S(X, Y).", "g(X) :- Q(X)."),
         "Q(a): 0.4. R(b, a). S(c, b). R(ego, c): 0.9.", (0.4, 0.4)),
        ((*CLOSURE, "h(X) :- e(X, c)."), WAYS, (0.7, 0.7)),
        (("e(X, Y) :- R(X, Y).", "e(X, Z) :- e(X, Y), e(Y, Z), X != Z.", "h(X) :- e(X, c)."), WAYS, (0.7, 0.7)),
        ((*CLOSURE, "h(X) :- P(X), not e(X, X)."), "P(ego). R(ego, a): 0.4. R(a, ego): 0.3.", (0.7, 0.7)),
        ((*CLOSURE, "h(X) :- Q(X), count(Y: e(X, Y)) >= 3."), f"{WAYS} Q(ego).", (0.7, 0.7)),
        (("h(X) :- P(X), not Q(X).", "h(X) :- R(X, Y), h(Y), not T(X, Y)."),
         "P(b). R(ego, a). R(a, b). T(a, b): 0.2.", (0.8, 0.8)),
        (("h(X) :- P(X) or (R(X, Y), h(Y)).",), WAYS, (0.7, 0.7)),
        (("h(X) :- P(X), R(X, _).", "h(ego) :- h(c).", "h(c) :- h(a)."), "P(a): 0.3. R(a, b).", (0.3, 0.3)),
        ((rule(THERE, groundings="sum"), ONWARD, rule("V(X) :- h(X), R(X, Y).", groundings="sum")), WAYS, (0.7, 0.7)),
    ],
)  # fmt: skip
def test_rounds_lead_to_the_least_bounds(rules, facts, expected):
    for found in bounds_of(recursive(*rules), facts):
        assert found == (None if expected is None else pytest.approx(expected))


def test_a_threshold_may_be_met_long_after_the_upper_bound_has_arrived():
    kb = recursive(rule("h(X) :- R(X, Y), h(Y).", threshold=0.5), THERE, "P(X) :- S(X, Y), P(Y).")
    facts = "P(d): [0.6, 0.6]. S(c, d). S(b, c). S(a, b). R(ego, a). P(a): [0.1, 0.9]."
    for found in bounds_of(kb, facts):
        assert found == pytest.approx((0.6, 0.9))


def test_two_dimensions_of_a_long_chain():
    names = [f"n{i}" for i in range(60)]
    facts = Facts()
    for one, two in itertools.pairwise(names):
        facts.add("R", one, two, bound=(0.5, 1.0))
    derived = RewardFunction(recursive(*CLOSURE)).conclude(facts).derived
    assert len(derived) == 60 * 59 / 2
    assert set(derived.values()) == {(0.5, 1.0)}


def test_a_search_without_end_names_the_rule():
    kb = recursive("e(X, Y) :- R(X, Y).", "e(X, Z) :- e(X, Y), e(Y, Z).")
    facts = Facts.parse(" ".join(f"R(n{i}, n{i + 1})." for i in range(40)))
    with pytest.raises(WorkLimitError, match="rule1"):
        RewardFunction(kb, work_limit=500).conclude(facts)


def test_tensors_have_gradients_through_all_rounds():
    torch = pytest.importorskip("torch")
    reward = RewardFunction(recursive(THERE, rule(ONWARD, certainty=0.5)))
    batch = reward.batch([Facts.parse(WAYS), Facts()])
    lower = torch.tensor(batch.lower, requires_grad=True)
    found = reward.evaluate(batch.with_bounds(lower, torch.tensor(batch.upper))).bounds["h"]
    assert found.lower.tolist() == pytest.approx([0.1, 0.0])
    found.lower.sum().backward()
    slopes = dict(
        zip(map(str, (atom for _, atom in batch.atoms)), lower.grad.tolist(), strict=True)
    )
    assert slopes.pop("R(b, c)") == pytest.approx(0.125)
    assert not any(slopes.values())


# -- what is refused ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rules", "semantics", "circle", "why", "instead"),
    [
        ((THERE, ONWARD), {"conjunction": "average"}, "h → h", "no meaning with conjunction: average", "conjunction: minimum"),
        ((THERE, ONWARD), {"conjunction": "product"}, "h → h", "conjunction: product", "leave 'h(Y)' out of the rule 'rule1'"),
        ((THERE, ONWARD), {"conjunction": "lukasiewicz"}, "h → h", "conjunction: lukasiewicz", "conjunction: minimum"),
        ((THERE, ONWARD), {"disjunction": "probabilistic_sum"}, "h → h", "disjunction: probabilistic_sum", "{disjunction: maximum}"),
        ((THERE, ONWARD), {"conjunction": "product", "disjunction": "probabilistic_sum"}, "h → h",
         "conjunction: product and disjunction: probabilistic_sum", "{conjunction: minimum, disjunction: maximum}"),
        ((THERE, rule(ONWARD, groundings="sum")), {}, "h → h", "groundings: sum", "write groundings: best, or leave"),
        ((THERE, ONWARD), {"groundings": "probabilistic_sum"}, "h → h", "groundings: probabilistic_sum", "groundings: best"),
        (("h(X) :- P(X), not h(X).",), {}, "h → h", "'not h(X)' would deny", "leave 'not h(X)' out of the rule 'rule0'"),
        (("h(X) :- P(X), not g(X).", "g(X) :- h(X)."), {}, "h → g → h", "'not g(X)' would deny", "'not g(X)'"),
        (("h(X) :- P(X), (h(X) implies Q(X)).",), {}, "h → h", "'not h(X)' would deny", "out of the rule 'rule0'"),
        (("h(X) :- P(X), count(Y: h(Y)) >= 2.",), {}, "h → h", "would speak of all", "'count(Y: h(Y)) >= 2'"),
        (("h(X) :- P(X), exists(Y: h(Y), not g(Y)).", "g(X) :- h(X)."), {}, "h → h", "would speak of all", "'exists(Y: h(Y), not g(Y))'"),
        (("h(X) :- P(X), forall(Y: R(X, Y))(h(Y)).",), {}, "h → h", "would speak of all", "'forall(Y: R(X, Y))(h(Y))'"),
        (("h(X) :- P(X), rose(h(X)).",), {}, "h → h", "'rose(h(X))' would look back at what follows", "'rose(h(X))'"),
        (("e(X, Y) :- g(X), R(X, Y).", "g(X) :- h(X).", "h(X) :- e(X, Y), V(Y)."), {"conjunction": "average"},
         "e → h → g → e", "conjunction: average", "leave 'g(X)' out of the rule 'rule0'"),
    ],
)  # fmt: skip
def test_any_other_circle_is_refused(rules, semantics, circle, why, instead):
    with pytest.raises(InvalidKnowledgeBase) as caught:
        recursive(*rules, **semantics)
    (error, *_) = caught.value.errors
    assert f"rules depend on each other in a circle: {circle}; " in error.message
    assert why in error.message
    assert instead in error.suggestion


def test_every_circle_is_reported_where_it_stands(tmp_path):
    path = tmp_path / "circles.yaml"
    path.write_text(
        "version: 1\nname: circles\npredicates: {P(X): p}\nrules:\n"
        "  one: a(X) :- P(X), a(X).\n  two: b(X) :- P(X), not b(X).\n"
        "  three: c(X) :- P(X), not d(X).\n  four: d(X) :- P(X), not c(X).\n"
    )
    with pytest.raises(InvalidKnowledgeBase) as caught:
        KnowledgeBase.load(path)
    circles = [e for e in caught.value.errors if "in a circle" in e.message]
    assert sorted(error.place.line for error in circles) == [5, 6, 7, 8]


def test_an_overlay_can_close_a_circle_and_is_told_so(tmp_path):
    base = to_yaml(recursive(THERE))
    (tmp_path / "program.yaml").write_text(base)
    overlay = tmp_path / "more.yaml"
    overlay.write_text(f"version: 1\nname: more\nextends: program\nrules:\n  on: {ONWARD}\n")
    assert set(KnowledgeBase.load(overlay).rules) == {"rule0", "on"}
    overlay.write_text(overlay.read_text() + "semantics: {conjunction: product}\n")
    with pytest.raises(InvalidKnowledgeBase, match=r"more\.yaml:5:\d+: .* in a circle: h → h"):
        KnowledgeBase.load(overlay)


def test_a_long_circle_is_shown_in_part():
    count = 30
    rules = [f"e{i}(X) :- e{(i + 1) % count}(X)." for i in range(count)]
    with pytest.raises(InvalidKnowledgeBase) as caught:
        recursive(*rules, conjunction="average")
    assert "e0 → e29 → e28 → e27 → e26 → e25 → e24 → e23 → … → e0; a bound" in str(caught.value)


def test_a_thousand_heads_that_depend_on_each_other_take_no_time_to_tell():
    count = 1_000
    rules = {f"r{i}": f"h{i}(X) :- h{(i + 1) % count}(X)." for i in range(count)}
    rules |= {f"s{i}": f"h{i}(X) :- h{i - 1}(X)." for i in range(1, count)}
    content = {"version": 1, "name": "ring", "rules": {**rules, "base": "h7(X) :- P(X)."},
               "predicates": {"P(X)": ""}, "semantics": {"conjunction": "minimum"}}  # fmt: skip
    kb = KnowledgeBase.of(KnowledgeBaseFile.model_validate(content))
    read, ring = components(kb.rules.values())
    assert (read.predicates, read.recursive) == (("P",), False)
    assert (len(ring.predicates), ring.recursive) == (count, True)


def test_components_come_after_what_they_depend_on():
    kb = recursive("h(X) :- g(X), e(X, Y).", "g(X) :- h(X).", *CLOSURE, "V(X) :- h(X).")
    order = [name for component in components(kb.rules.values()) for name in component.predicates]
    assert order.index("R") < order.index("e") < order.index("h") < order.index("V")
    assert [c.predicates for c in components(kb.rules.values()) if c.recursive] == [
        ("e",),
        tuple(name for name in order if name in ("g", "h")),
    ]


# -- time ---------------------------------------------------------------------------------------


def test_a_head_may_lead_to_itself_and_to_its_own_past():
    rules = (THERE, ONWARD, "V(X) :- previously(h(X)), not h(X).", "g(X) :- once[1](h(X)).",
             "h(X) :- previously(g(X)), Q(X).")  # fmt: skip
    content = {
        "version": 1,
        "name": "past",
        "predicates": dict.fromkeys(["P(X)", "Q(X)", "R(X, Y)", "V(X)", "g(X)"], ""),
        "rules": {f"rule{number}": rule for number, rule in enumerate(rules)},
        "semantics": {"conjunction": "minimum"},
        "time": {"step": 1, "unit": "s"},
    }
    kb = KnowledgeBase.of(KnowledgeBaseFile.model_validate(content))
    steps = [Facts.parse(text) for text in (WAYS, "Q(a). R(ego, a): 0.6.", "", "Q(ego).")]
    episode = RewardFunction(kb).episode()
    expected = naive_episode(kb, steps)
    for facts, derived in zip(steps, expected, strict=True):
        assert_same(derived, episode.conclude(facts).derived)
    assert expected[1][H] == pytest.approx((0.6, 0.6))


# -- explanations -------------------------------------------------------------------------------


def atoms_below(node, path=()):
    """Yield the path of literals with their bounds to every one of a proof."""
    if node.kind in ("fact", "head") and node.values.get("bound"):
        atom = node.values.get("atom") or node.values["literal"]
        path = (*path, (atom, tuple(node.values["bound"])))
        yield path
    for child in node.children:
        yield from atoms_below(child, path)


def weighed(kb):
    content = {
        "version": 1, "name": "weighed", "predicates": {p.signature: "" for p in kb.declared.values()},
        "rules": {n: {"rule": str(r.clause), "certainty": r.certainty, "threshold": r.threshold}
                  for n, r in kb.rules.items()},
        "semantics": kb.semantics.model_dump(),
        "weights": {"w": {"normalizer": 1, "coefficients": {"h": 1}}},
        "terms": {"t": {"weight": "w", "formula": "1"}},
    }  # fmt: skip
    return KnowledgeBase.of(KnowledgeBaseFile.model_validate(content))


def test_a_proof_goes_back_to_what_is_asserted():
    reward = RewardFunction(weighed(recursive(THERE, ONWARD)))
    text = str(reward.explain(Facts.parse(WAYS)))
    assert re.findall(r"h\((\w+)\) \[0\.\d+, 0\.\d+\]  derived", text) == ["a", "b"]
    assert "h(c) [1, 1]  derived" in text
    assert text.rstrip().endswith("P(c) [1, 1]  asserted")


def test_a_proof_says_what_a_bound_grew_to():
    kb = weighed(recursive(THERE, ONWARD))
    facts = Facts.parse("R(ego, a): 0.3. R(a, b): 0.4. P(b). R(a, c). R(c, d). P(d).")
    text = str(RewardFunction(kb).explain(facts))
    assert "h(a) [0.4, 0.4]  derived, and in the end [1, 1]" in text
    assert "R(c, d)" not in text


def test_what_is_asserted_needs_no_proof():
    kb = weighed(recursive(THERE, FRIENDS))
    text = str(RewardFunction(kb).explain(Facts.parse("h(a). R(ego, a). R(a, ego).")))
    assert "h(a) [1, 1]  asserted" in text
    assert text.count("h(X) :- h(Y), R(X, Y).") == 1


def test_tables_forget_and_learn_with_their_indices():
    tables = Tables.of(Facts.parse("R(a, b). R(a, c): 0.5. P(a)."))
    assert len(tables.rows_with("R", 0, "a")) == 2
    assert not tables.without(("R",)).rows_with("R", 0, "a")
    more = tables.extended({Atom("R", ("a", "d")): Bound(0.1, 0.2), Atom("R", ("a", "c")): TRUE})
    assert [bound for _, bound in more.rows_with("R", 0, "a")] == [TRUE, TRUE, (0.1, 0.2)]
    assert [bound for _, bound in tables.rows_with("R", 0, "a")] == [TRUE, (0.5, 0.5)]
    assert more.rows("P") == tables.without(("R",)).rows("P") == {("a",): TRUE}


def test_what_is_asserted_is_not_proved_by_a_rule_that_says_no_more():
    kb = weighed(recursive("h(ego) :- not Q(ego).", FRIENDS))
    text = str(RewardFunction(kb).explain(Facts.parse("h(ego). Q(ego). R(ego, ego).")))
    assert "h(ego) [1, 1]" in text
    assert "not Q(ego)" not in text


@pytest.mark.filterwarnings("ignore::sfol.errors.SilentZeroWarning")
def test_no_proof_rests_on_what_it_proves():
    proved = 0
    for number in range(150):
        kb, facts = recursive_scene(number)
        if "h" not in kb.heads or any(rule.part_of for rule in kb.rules.values()):
            continue
        explanation = RewardFunction(weighed(kb)).explain(facts)
        for path in atoms_below(explanation.root):
            proved += len(path) > 2
            derived = [one for one in path if one[0].split("(")[0] in ("h", "g", "e")]
            # The head is the first of its own proof, under the weight and nowhere else.
            assert len(set(derived)) == len(derived), path
    assert proved > 20


def test_conclusions_that_were_kept_are_explained_alike():
    reward = RewardFunction(weighed(recursive(THERE, FRIENDS)))
    facts = Facts.parse("h(a): 0.5. R(b, a). R(ego, b): 0.4. R(a, ego).")
    kept = pickle.loads(pickle.dumps(reward.conclude(facts)))
    assert str(reward.explain(kept)) == str(reward.explain(facts))
    assert reward.evaluate(kept).reward == reward(facts) == pytest.approx(0.4)


# -- the rest -----------------------------------------------------------------------------------


def test_what_is_read_off_observations_is_concluded_for_many_scenes(tmp_path):
    path = tmp_path / "row.yaml"
    path.write_text(
        "version: 1\nname: row\npredicates: {'Next(X, Y)': n, Base(X): b}\n"
        "observation: {stones: {key: stones, fields: [x, base]}}\n"
        "entities: {stone: {from: stones, at_most: 5}}\n"
        "facts:\n  Base(S in stone): S.base\n"
        "  Next(ego, S in stone): below(S.x, 1, margin=1)\n"
        "  Next(S in stone, Q in stone): below(abs(S.x - Q.x), 1, margin=1)\n"
        "rules:\n  base: firm(X) :- Base(X).\n  next: firm(X) :- Next(X, Y), firm(Y).\n"
        "semantics: {conjunction: minimum}\n"
        "weights: {w: {normalizer: 1, coefficients: {firm: 1}}}\nterms: {t: {weight: w, formula: '1'}}\n"
    )
    reward = RewardFunction(KnowledgeBase.load(path))
    chance = np.random.default_rng(0)
    stones = np.stack([chance.random((50, 5)) * 4, chance.random((50, 5))], axis=-1)
    many = reward.transitions({"stones": stones}).reward
    again = reward.transitions({"stones": stones}).reward
    single = [reward.transition({"stones": one}).reward for one in stones]
    assert many == pytest.approx(single)
    assert again == pytest.approx(single)
    assert len(set(many.tolist())) > 20
    pytest.importorskip("torch")
    with pytest.raises(UsageError, match="'firm' depends on itself"):
        reward.on_tensors({"stones": stones})


def test_tools_take_a_knowledge_base_with_a_circle(tmp_path):
    kb = weighed(recursive(THERE, ONWARD))
    path = tmp_path / "weighed.yaml"
    path.write_text(to_yaml(kb))
    assert KnowledgeBase.load(path).rules == kb.rules
    for arguments in (["check"], ["show"], ["fmt", "--check"], ["graph"]):
        assert sfol(*arguments, path).code == 0, arguments
    assert {finding.code for finding in lint(kb)} == {"SF003"}
    assert not compare(kb, KnowledgeBase.load(path))
    nodes = {node.name for node in dependency_graph(kb)}
    assert {"h", "rule0", "rule1"} <= nodes
    assert mermaid(kb).count("-->") == svg(kb).count("<path")


def test_lint_finds_a_circle_that_nothing_begins():
    kb = recursive("h(X) :- R(X, Y), g(Y).", "g(X) :- h(X).", "V(X) :- h(X).")
    undeclared = {"version": 1, "name": "idle", "predicates": {"R(X, Y)": ""}, "rules": {
        "one": "h(X) :- R(X, Y), g(Y).", "two": "g(X) :- h(X).", "three": "V(X) :- h(X).",
        "four": "k(X) :- R(X, Y), k(Y).", "five": "k(X) :- R(X, X).", "six": "l(X) :- k(X), l(X)."},
        "semantics": {"conjunction": "minimum"},
        "weights": {"w": {"normalizer": 1, "coefficients": {"V": 1, "k": 1, "l": 1}}},
        "terms": {"t": {"weight": "w", "formula": "1"}}}  # fmt: skip
    idle = KnowledgeBase.of(KnowledgeBaseFile.model_validate(undeclared))
    found = {f.path[1] for f in lint(idle) if f.code == "SF001"}
    assert found == {"one", "two", "three", "six"}
    assert not [f for f in lint(kb) if f.code == "SF001"]  # declared heads may be asserted


def test_a_knowledge_base_without_recursion_has_none():
    program = Program.of(KnowledgeBase.load("aeb"))
    assert not program.recursive
    assert {s.predicates for s in program.strata} == {(head,) for head in program.heads}


def test_conclusions_say_what_was_asserted():
    kb = recursive(THERE, FRIENDS)
    facts = Facts.parse("h(a): [0.5, 0.5]. R(ego, a). R(a, ego). P(a).")
    conclusions = RewardFunction(kb).conclude(facts)
    assert conclusions.asserted == ((Atom("h", ("a",)), (0.5, 0.5)),)
    assert conclusions.tables.bound(Atom("h", ("a",))) == (1.0, 1.0)
    assert dict(conclusions.derived) == naive_conclusions(kb, facts)


def test_sorts_are_followed_around_a_circle():
    kb = recursive("e(X, Z) :- e(X, Y), R(Y, Z).", "e(X, Y) :- S(X, Y).", "h(X) :- e(X, _).")
    facts = Facts.parse("S(ego, a): 0.8. R(a, b). R(b, c): 0.5. R(c, a).")
    expected = naive_conclusions(kb, facts)
    for sorts in (1, 2, 3):
        found = dense_conclusions(kb, [facts, Facts()], sorts)[0]
        for atom, bound in expected.items():
            assert found[atom] == pytest.approx(tuple(bound)), atom
