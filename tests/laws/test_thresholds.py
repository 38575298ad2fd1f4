"""Thresholds are decimals, and decide as on paper: rounding takes nothing away from them."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.clauses import parse_clause, parse_condition
from sfol.knowledge_base import EntityCondition
from sfol.knowledge_base.format import Semantics
from sfol.operators import least
from sfol.testing.naive import naive_conclusions
from tests.sfol.conftest import KITCHEN

hundredths = st.integers(0, 100)
scales = st.sampled_from([Fraction(1), Fraction(1, 2), Fraction(1, 3), Fraction(1, 7)])
POSITIVE = "careful(X) :- Hot(X)."
NEGATED = "careful(X) :- Pot(X), not Hot(X)."


@pytest.fixture(scope="module")
def kitchen(tmp_path_factory):
    path = tmp_path_factory.mktemp("kitchen") / "kitchen.yaml"
    path.write_text(KITCHEN.replace("{SEMANTICS}", "{}"))
    return KnowledgeBase.load(path)


def decisions(kb, facts):
    """Return whether the head was concluded, in every way in which that can be found out."""
    reward = RewardFunction(kb)
    batch = reward.batch([facts])
    yield reward.evaluate(facts, speed=1.0).bounds["careful"] is not None
    yield bool(reward.evaluate(batch, speed=1.0).bounds["careful"].known[0])
    yield any(atom.predicate == "careful" for atom in naive_conclusions(kb, facts))
    torch = pytest.importorskip("torch")
    for dtype in (torch.float64, torch.float32):
        ends = [torch.tensor(end, dtype=dtype) for end in (batch.lower, batch.upper)]
        outcome = reward.evaluate(batch.with_bounds(*ends), speed=1.0)
        yield bool(outcome.bounds["careful"].known[0])


def of(kitchen, rule, **thresholds):
    (name,) = kitchen.rules
    changed = replace(kitchen.rules[name], clause=parse_clause(rule), **thresholds)
    return replace(kitchen, rules={name: changed})


@given(lower=hundredths, minimum=hundredths, threshold=hundredths)
def test_a_literal_that_asks_for_a_bound_decides_as_fractions_do(
    kitchen, lower, minimum, threshold
):
    rule = f"careful(X) :- Hot(X) >= {minimum / 100}."
    kb = of(kitchen, rule, threshold=threshold / 100)
    facts = Facts()
    facts.add("Hot", "cook", bound=(lower / 100, 1.0))
    assert set(decisions(kb, facts)) == {lower >= max(minimum, threshold)}


@given(lower=hundredths, threshold=hundredths, scale=scales)
def test_a_positive_literal_decides_as_fractions_do(kitchen, lower, threshold, scale):
    exact = scale * Fraction(lower, 100), scale * Fraction(threshold, 100)
    kb = of(kitchen, POSITIVE, threshold=float(exact[1]))
    facts = Facts()
    facts.add("Hot", "cook", bound=(float(exact[0]), 1.0))
    assert set(decisions(kb, facts)) == {exact[0] >= exact[1]}


@given(upper=hundredths, threshold=hundredths)
def test_a_negated_literal_decides_as_fractions_do(kitchen, upper, threshold):
    # 1 − 0.8 is a little less than 0.2.
    exact = 1 - Fraction(upper, 100), Fraction(threshold, 100)
    kb = of(kitchen, NEGATED, negation_threshold=float(exact[1]))
    facts = Facts.parse("Pot(cook).")
    facts.add("Hot", "cook", bound=(0.0, upper / 100))
    assert set(decisions(kb, facts)) == {exact[0] >= exact[1]}


@given(values=st.lists(hundredths, min_size=1, max_size=7), threshold=hundredths)
def test_a_mean_decides_as_fractions_do(kitchen, values, threshold):
    # The mean of three 0.7 is a little less than 0.7.
    mean = Fraction(sum(values), 100 * len(values))
    first = of(kitchen, "warm(X) :- Person(X), Hot(P).")
    (name,) = kitchen.rules
    second = replace(of(kitchen, "careful(X) :- warm(X).", threshold=threshold / 100).rules[name],
                     name="second")  # fmt: skip
    kb = replace(
        first,
        rules={**first.rules, "second": second},
        background=(),
        semantics=Semantics(conjunction="average", groundings="pooled"),
        predicates={**kitchen.predicates, "warm": replace(kitchen.predicates["Hot"], name="warm")},
    )
    facts = Facts()
    facts.add("Person", "cook", bound=(float(mean), 1.0))
    for number, value in enumerate(values):
        facts.add("Hot", f"p{number}", bound=(value / 100, 1.0))
    exact = (mean + sum(Fraction(v, 100) for v in values)) / (len(values) + 1)
    assert set(decisions(kb, facts)) == {exact >= Fraction(threshold, 100)}


@pytest.mark.parametrize(("when", "at_least"), [("Pot(X), not Hot(X)", 0.2), ("Hot(X)", 0.7)])
@given(midpoint=hundredths)
def test_an_entity_weights_condition_counts_from_its_confidence_on(
    kitchen, when, at_least, midpoint
):
    conditions = (EntityCondition(parse_condition(when), 1.0, at_least),)
    reward = RewardFunction(replace(kitchen, entity_weights=conditions))
    facts = Facts.parse("Pot(pan).")
    facts.add("Hot", "pan", bound=(midpoint / 100, midpoint / 100))
    confidence = Fraction(midpoint, 100)
    exact = confidence if when == "Hot(X)" else 1 - confidence
    assert reward.entity_weights(facts, ["pan"]) == {"pan": float(exact >= Fraction(str(at_least)))}


def test_the_tolerance_is_small():
    assert least(0.0) == 0.0
    assert np.all(np.array([least(t) for t in (0.1, 0.5, 1.0)]) >= np.array([0.1, 0.5, 1.0]) - 1e-8)
