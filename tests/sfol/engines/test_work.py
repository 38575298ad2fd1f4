"""Every call ends: in work that grows with the scene, or in an error that names the rule.

Work is counted in calls of functions, Python's and C's, which is the same on every machine.
"""

import pytest

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.clauses import MAXIMUM_LITERALS
from sfol.errors import InvalidKnowledgeBase, UsageError, WorkLimitError
from tests.sfol.work import calls

CROWD = """\
version: 1
name: crowd
predicates: {{Person(X): p, "Near(X, Y)": n, "Sees(X, Y)": s, "Hears(X, Y)": h}}
rules: {{crowded: "{rule}"{more}}}
semantics: {{conjunction: {conjunction}}}
signals: {{v: {{unit: m/s}}}}
weights: {{care: {{normalizer: 1, coefficients: {{crowded: 1.0}}}}}}
terms: {{care: {{weight: care, formula: -v}}}}
entity_weights: [{{when: "Person(X), Near(A, B), Sees(C, D), Hears(E, F)", weight: 2.0}}]
"""
STAR = "crowded(X) :- Near(A, X), Sees(B, X), Hears(C, X)."
UNMET = "crowded(X) :- Near(A, X), Sees(B, X), Hears(C, X), Person(X)."
READ = "crowded(X) :- Person(X), busy(X)."
BUSY = ', busy: "busy(X) :- Near(A, X), Sees(B, X), Hears(C, X)."'
CYCLE = (
    "crowded(X) :- Person(X), Near(A, B), Sees(B, C), Near(C, D), Sees(D, A), Hears(A, C), "
    "Hears(B, D)."
)
FREE = "crowded(X) :- Person(X), Person(A), Person(B), Person(C), Person(D), Person(E)."


def crowd(tmp_path, rule, conjunction="average", more="", **settings):
    path = tmp_path / "crowd.yaml"
    path.write_text(CROWD.format(rule=rule, conjunction=conjunction, more=more))
    return RewardFunction(KnowledgeBase.load(path), **settings)


def arms(people):
    """Return a scene in which ego and one more have people on all sides, but are none."""
    facts = Facts()
    for number in range(people):
        for hub in ("ego", "other"):
            for arm in ("Near", "Sees", "Hears"):
                facts.add(arm, f"{arm.lower()}{number}", hub, confidence=0.5)
    facts.add("Person", "other")
    return facts


def pairs(people):
    """Return a scene in which everybody stands in every relation to nearly everybody."""
    facts = Facts.parse("Person(ego).")
    for i in range(people):
        facts.add("Person", f"p{i}")
        for j in range(people):
            if i != j:
                facts.add("Near", f"p{i}", f"p{j}")
                facts.add("Sees", f"p{i}", f"p{j}")
    # Never two the same way round, so that the search fails at its end.
    facts.add("Hears", "p0", "p0")
    return facts


CALLS = {
    "evaluate": lambda reward, facts: reward(facts, v=1.0),
    "derived": lambda reward, facts: dict(reward.evaluate(facts, v=1.0).derived),
    "fired": lambda reward, facts: reward.evaluate(facts, v=1.0).fired,
    "explain": lambda reward, facts: reward.explain(facts, v=1.0),
    "entity_weights": lambda reward, facts: reward.entity_weights(facts, ["other", "ego"]),
}


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize(("rule", "more"), [(STAR, ""), (UNMET, ""), (READ, BUSY)])
def test_work_grows_with_the_facts(tmp_path, call, rule, more):
    reward = crowd(tmp_path, rule, more=more)
    CALLS[call](reward, arms(2))  # what is made once
    few, many = (calls(lambda n=people: CALLS[call](reward, arms(n))) for people in (40, 80))
    assert many <= 2.5 * few


SEARCHES = {
    **CALLS,
    "batch": lambda reward, facts: reward.batch([facts]),
}


@pytest.mark.parametrize("call", ["evaluate", "derived", "explain", "batch"])
@pytest.mark.parametrize(
    ("rule", "conjunction"), [(CYCLE, "average"), (CYCLE, "minimum"), (FREE, "minimum")]
)
def test_what_would_not_end_is_an_error_that_names_rule_and_entities(
    tmp_path, call, rule, conjunction
):
    reward = crowd(tmp_path, rule, conjunction, work_limit=50_000)
    with pytest.raises(WorkLimitError, match=r"rule 'crowded' .* among 61 entities \(ego, p0"):
        SEARCHES[call](reward, pairs(60))


def test_the_limit_can_be_set(tmp_path):
    small = crowd(tmp_path, FREE, "minimum", work_limit=100)
    large = crowd(tmp_path, FREE, "minimum", work_limit=10_000)
    facts = pairs(3)
    assert large(facts, v=1.0) == -1.0
    with pytest.raises(WorkLimitError, match="work_limit"):
        small(facts, v=1.0)
    for wrong in (0, -1, 0.5, "many", None):
        with pytest.raises(UsageError, match="work limit"):
            RewardFunction(small.kb, work_limit=wrong)


def test_one_loop_is_counted_too(tmp_path):
    rule = "crowded(X) :- Person(X), Person(A), Near(A, X)."
    facts = pairs(20)
    facts.add("Near", "p0", "ego")
    assert crowd(tmp_path, rule, work_limit=21)(facts, v=1.0) == -1.0
    with pytest.raises(WorkLimitError, match=r"rule 'crowded' .* among 21 entities"):
        crowd(tmp_path, rule, work_limit=20)(facts, v=1.0)


def test_an_entity_weights_condition_that_falls_apart_is_only_looked_up(tmp_path):
    reward = crowd(tmp_path, STAR)
    weights = reward.entity_weights(arms(300), ["other", "near0"])  # 27 million substitutions
    assert weights == {"other": 2.0, "near0": 0.0}


def test_a_star_is_explained_by_examples_and_all_atoms(tmp_path):
    reward = crowd(tmp_path, STAR)
    text = str(reward.explain(arms(40), v=1.0))  # 64,000 substitutions
    assert "Near(A, X): 40 atoms" in text
    assert "and more" in text
    few = str(reward.explain(arms(2), v=1.0))
    assert "and 4 more" in few


@pytest.mark.parametrize("literals", [6, 20, MAXIMUM_LITERALS])
def test_what_a_long_body_lacks_is_found_without_trying_all_subsets(tmp_path, literals):
    body = ", ".join(f"{'Near' if i % 2 else 'Sees'}(X, v{i})" for i in range(literals))
    reward = crowd(tmp_path, f"crowded(X) :- {body}.")
    facts = Facts()
    for i in range(0, literals, 2):
        facts.add("Sees", "ego", f"v{i}")
    text = str(reward.explain(facts, v=1.0))
    assert [f"Near(ego, v{i})" in text for i in range(1, literals, 2)] == [True] * (literals // 2)
    assert "Sees(ego" not in text.partition("lacks")[2]
    assert calls(lambda: CALLS["explain"](reward, facts)) < 3_000_000


def test_longer_bodies_are_refused_where_they_stand(tmp_path):
    chain = ", ".join(f"Near(X{i}, X{i + 1})" for i in range(MAXIMUM_LITERALS))
    reward = crowd(tmp_path, f"crowded(X0) :- {chain}.")
    facts = Facts()
    facts.add("Near", "ego", "ego")
    assert reward(facts, v=1.0) == -1.0
    with pytest.raises(InvalidKnowledgeBase, match=f"more than {MAXIMUM_LITERALS} literals"):
        crowd(tmp_path, f"crowded(X0) :- {chain}, Person(X0).")


@pytest.mark.parametrize("levels", [5, 24, 900])
def test_conclusions_on_conclusions_are_explained_to_a_depth(tmp_path, levels):
    rules = "".join(f', r{i}: "h{i + 1}(X) :- h{i}(X), h{i}(X)."' for i in range(levels))
    more = f', r: "h0(X) :- Person(X)."{rules}'
    reward = crowd(tmp_path, f"crowded(X) :- h{levels}(X).", more=more)
    text = str(reward.explain(Facts.parse("Person(ego)."), v=1.0))
    assert ("left out" in text) == (levels > 5)
    assert len(text) < 3_000_000
