"""The meaning of rules and rewards, with numbers worked out by hand."""

import copy
import math
import pickle

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from sfol import Atom, Facts, RewardFunction
from sfol.errors import FactError, FormulaError, InvalidKnowledgeBase, SignalError, UsageError
from sfol.operators import DISJUNCTIONS

ROAD = {"v": 6.0, "v_next": 5.5, "d": 9.0}


@pytest.fixture(scope="module")
def aeb():
    return RewardFunction("aeb")


def careful(kb, text, **signals):
    """The bound of the kitchen's head."""
    return RewardFunction(kb).evaluate(Facts.parse(text), speed=1.0, **signals).bounds["careful"]


# -- the paper's equations ------------------------------------------------------------------------


def test_the_head_is_the_average_of_its_body(aeb):
    facts = Facts.parse("Pedestrian(p1): [0.76, 0.84]. OnRoad(p1): [0.9, 1.0]. CenterOf(p1, ego).")
    outcome = aeb.evaluate(facts, **ROAD)
    # Vehicle(ego) and CenterOf have [1, 1]: (1 + .76 + .9 + 1) / 4 and (1 + .84 + 1 + 1) / 4
    assert outcome.bounds["safe1"] == pytest.approx((0.915, 0.96))
    assert outcome.confidences["safe1"] == pytest.approx((0.915 + 0.96) / 2)


def test_weights_and_the_final_reward(aeb):
    facts = Facts.parse("Pedestrian(p1): [0.76, 0.84]. OnRoad(p1): [0.9, 1.0]. CenterOf(p1, ego).")
    outcome = aeb.evaluate(facts, **ROAD)
    # w_saf = 1/3 (1·.9375 + 1·0 + 1·0); g_saf = −(.05·36/(9+1) + 200·0) = −.18
    assert outcome.weights == pytest.approx({"safety": 0.3125, "efficiency": 0.0})
    # g_smooth = −.05 (6 − 5.5)²
    assert outcome.terms == pytest.approx(
        {"safety": 0.3125 * -0.18, "efficiency": 0.0, "comfort": -0.0125}
    )
    assert outcome.reward == sum(outcome.terms.values())
    assert aeb(facts, **ROAD) == outcome.reward


def test_thirteen_bounds_are_pooled_for_four_pedestrians_ahead_of_ten(aeb):
    facts = Facts()
    for i in range(10):
        facts.add("Pedestrian", f"p{i}", bound=(0.1 * i, 0.1 * i))
        facts.add("OnRoad", f"p{i}", bound=(0.5, 0.9))
        facts.add("CenterOf" if i < 4 else "LeftOf", f"p{i}", "ego")
    # Vehicle(ego) once, and for each of p0 … p3 a Pedestrian, an OnRoad and a CenterOf. p0 is
    # known to be no pedestrian ([0, 0]) and supports nothing, so there are 1 + 3 + 3 + 3.
    expected = (1 + (0.1 + 0.2 + 0.3) + 3 * 0.5 + 3) / 10, (1 + 0.6 + 3 * 0.9 + 3) / 10
    assert aeb.evaluate(facts, **ROAD).bounds["safe1"] == pytest.approx(expected)
    facts.add("Pedestrian", "p0", bound=(0.4, 0.4), merge="replace")
    expected = (1 + 1.0 + 4 * 0.5 + 4) / 13, (1 + 1.0 + 4 * 0.9 + 4) / 13
    assert aeb.evaluate(facts, **ROAD).bounds["safe1"] == pytest.approx(expected)


def test_of_rules_with_one_head_the_greatest_counts(aeb):
    facts = Facts.parse(
        "Vehicle(v1): [0.5, 1]. Vehicle(v2): [0.6, 0.6]. Crosswalk(a1). RightOf(v1, ego)."
        "CenterOf(v2, ego). Occludes(v1, a1). Occludes(v2, a1)."
    )
    # right: (1 + .5 + 1 + 1 + 1) / 5 and 1; centre: (1 + .6 + 1 + 1 + 1) / 5 twice
    assert aeb.evaluate(facts, **ROAD).bounds["safe3"] == pytest.approx((0.92, 1.0))


def test_a_truck_is_a_vehicle_and_an_asserted_bound_is_one_more_disjunct(aeb):
    facts = Facts.parse("Truck(t1): [0.4, 0.6]. Vehicle(t1): [0.5, 0.5].")
    outcome = aeb.evaluate(facts, **ROAD)
    assert outcome.derived[Atom("Vehicle", ("t1",))] == (0.5, 0.6)


# -- literals -------------------------------------------------------------------------------------


def test_nothing_known_concludes_nothing(aeb):
    outcome = aeb.evaluate(Facts(), **ROAD)
    assert set(outcome.confidences) >= {"safe1", "efficiency1"}
    assert outcome.bounds["safe1"] is None
    assert outcome.confidences["safe1"] == 0.0
    assert outcome.terms["safety"] == 0.0


def test_an_atom_known_to_be_false_supports_nothing(kitchen):
    known = "Pot(p). Near(p, cook). Hot(p): "
    assert careful(kitchen(), known + "[0, 0].") is None
    assert careful(kitchen(), known + "[0, 0.1].") == pytest.approx((0.75, 0.775))


def test_the_threshold_is_reached_at_its_very_value(kitchen):
    rule = "care: careful(X) :- Person(X), Pot(P), Hot(P), Near(P, X)."
    strict = kitchen({rule: "care: {rule: 'careful(X) :- Person(X), Hot(X).', threshold: 0.5}"})
    assert careful(strict, "Hot(cook): [0.5, 0.7].") == pytest.approx((0.75, 0.85))
    assert careful(strict, "Hot(cook): [0.49, 0.7].") is None


def test_negation_of_unknown_false_and_true_atoms(kitchen):
    kb = kitchen({"Hot(P), Near(P, X)": "Near(P, X), not Lid(P)"})
    known = "Pot(p): [0.2, 0.75]. Near(p, cook)."
    # unknown: [1, 1]; else [1 − u, 1 − l] if 1 − u ≥ 0.5
    assert careful(kb, known) == pytest.approx((3.2 / 4, 3.75 / 4))
    known_lid = known + "Lid(p): [0.1, 0.2]."
    assert careful(kb, known_lid) == pytest.approx(((1 + 0.2 + 1 + 0.8) / 4, (3.65) / 4))
    assert careful(kb, known + "Lid(p): [0.1, 0.5].") == pytest.approx((2.7 / 4, 3.65 / 4))
    assert careful(kb, known + "Lid(p): [0.1, 0.6].") is None


def test_guards_and_constants(kitchen):
    rule = "careful(X) :- Person(X), Pot(P), Hot(P), Near(P, X)."
    two = kitchen({rule: "careful(X) :- Near(P, X), Near(Q, X), P != Q."})
    assert careful(two, "Near(p, cook).") is None
    assert careful(two, "Near(p, cook). Near(q, cook).") == (1, 1)
    stove = kitchen({rule: "careful(cook) :- Hot(stove)."})
    assert careful(stove, "Hot(stove): [0.3, 0.4].") == (0.3, 0.4)
    assert careful(stove, "Hot(oven).") is None


def test_a_variable_twice_in_one_literal_is_one_entity(kitchen):
    rule = "careful(X) :- Person(X), Pot(P), Hot(P), Near(P, X)."
    kb = kitchen({rule: "careful(X) :- Near(X, X)."})
    assert careful(kb, "Near(p, cook).") is None
    assert careful(kb, "Near(cook, cook): 1.0.") == (1.0, 1.0)


def test_strata_are_evaluated_in_order(kitchen):
    kb = kitchen(
        {
            "  care: careful(X)": "  last: careful(X) :- Person(X), alarm(X).\n"
            "  middle: alarm(X) :- Near(P, X), boils(P).\n"
            "  first: boils(P) :- Pot(P), Hot(P).\n"
            "  care: unused(X)",
            "{careful: 1.0}": "{careful: 1.0, unused: 0.0}",
        }
    )
    # boils .6; alarm (1 + .6)/2 = .8; careful (1 + .8)/2
    text = "Near(p, cook). Pot(p): [0.4, 0.4]. Hot(p): [0.8, 0.8]."
    assert careful(kb, text) == pytest.approx((0.9, 0.9))


# -- operators ------------------------------------------------------------------------------------

TWO_POTS = "Near(p, cook). Near(q, cook). Hot(p). Hot(q). Pot(p): [0.8, 0.9]. Pot(q): [0.2, 0.3]."


@pytest.mark.parametrize(
    ("semantics", "expected"),
    [
        ("", ((1 + 0.8 + 0.2 + 4) / 7, (1 + 0.9 + 0.3 + 4) / 7)),
        ("groundings: best", ((1 + 0.8 + 2) / 4, (1 + 0.9 + 2) / 4)),
        ("conjunction: minimum", (0.8, 0.9)),
        ("conjunction: product", (0.8, 0.9)),
        ("conjunction: lukasiewicz", (0.8, 0.9)),
    ],
)
def test_pooled_against_best(kitchen, semantics, expected):
    assert careful(kitchen(semantics=semantics), TWO_POTS) == pytest.approx(expected)


def test_the_conjunctions_on_two_soft_literals(kitchen):
    text = "Near(p, cook). Hot(p): [0.5, 0.6]. Pot(p): [0.7, 0.8]."
    found = {
        name: careful(kitchen(semantics=f"conjunction: {name}"), text)
        for name in ("average", "minimum", "product", "lukasiewicz")
    }
    assert found["average"] == pytest.approx((0.8, 0.85))
    assert found["minimum"] == pytest.approx((0.5, 0.6))
    assert found["product"] == pytest.approx((0.35, 0.48))
    assert found["lukasiewicz"] == pytest.approx((0.2, 0.4))


def test_probabilistic_sum(kitchen):
    changes = {"  care: careful": "  other: careful(X) :- Hot(X).\n  care: careful"}
    kb = kitchen(changes, semantics="disjunction: probabilistic_sum, conjunction: product")
    text = "Near(p, cook). Hot(p). Pot(p): [0.5, 0.6]. Hot(cook): [0.2, 0.3]."
    assert careful(kb, text) == pytest.approx((1 - 0.5 * 0.8, 1 - 0.4 * 0.7))


@example([1e-300])
@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=5))
def test_a_probabilistic_sum_is_a_truth_value_above_zero_if_one_of_its_values_is(values):
    combined = DISJUNCTIONS["probabilistic_sum"].combine(values)
    assert combined == pytest.approx(1.0 - math.prod(1.0 - value for value in values), abs=1e-12)
    assert combined <= 1.0
    assert (combined > 0.0) == (max(values) > 0.0)  # however small, where 1 - (1 - x) is 0
    assert combined == DISJUNCTIONS["probabilistic_sum"].combine([*values, 0.0])


@pytest.mark.parametrize(("kind", "expected"), [("midpoint", 0.85), ("lower", 0.8), ("upper", 0.9)])
def test_confidence_from_a_bound(kitchen, kind, expected):
    reward = RewardFunction(kitchen(semantics=f"confidence: {kind}, conjunction: minimum"))
    outcome = reward.evaluate(Facts.parse(TWO_POTS), speed=1.0)
    assert outcome.confidences["careful"] == pytest.approx(expected)


def test_pooling_is_not_defined_for_other_conjunctions(kitchen):
    with pytest.raises(InvalidKnowledgeBase, match="groundings: best"):
        kitchen(semantics="conjunction: minimum, groundings: pooled")


# -- signals, terms, entity weights ---------------------------------------------------------------


def test_a_missing_signal_is_named_with_its_unit(aeb):
    with pytest.raises(SignalError, match=r"v_next=… \(m/s\)"):
        aeb(Facts(), v=1.0)


def test_an_unknown_signal_has_a_suggestion(aeb):
    with pytest.raises(SignalError, match="did you mean 'v_next'"):
        aeb(Facts(), v=1.0, v_nxt=1.0)


def test_nan_is_refused(aeb):
    with pytest.raises(SignalError, match="'v' is NaN"):
        aeb(Facts(), v=math.nan, v_next=1.0)


def test_a_term_without_a_value_is_named(kitchen):
    reward = RewardFunction(kitchen({"-k * speed": "k / speed"}))
    with pytest.raises(FormulaError, match="'haste' has no value"):
        reward(Facts(), speed=0.0)
    with pytest.raises(FormulaError, match="'haste' has no value"):
        RewardFunction(kitchen())(Facts(), speed=math.inf)


def test_a_distance_left_out_is_infinite(aeb):
    facts = Facts.parse("Pedestrian(p1). OnCrosswalk(p1).")
    assert aeb.evaluate(facts, v=6.0, v_next=6.0).terms["safety"] == 0.0


def test_unknown_predicates_and_arities_in_facts(aeb):
    with pytest.raises(FactError, match="did you mean 'Pedestrian'"):
        aeb(Facts.parse("Pedestrain(p1)."), **ROAD)
    with pytest.raises(FactError, match="'OnRoad' 2 constants"):
        aeb(Facts.parse("OnRoad(p1, ego)."), **ROAD)


def test_the_background_always_holds(aeb):
    facts = Facts.parse("NoCrosswalk(ego). EmptyLane(ego). Vehicle(ego).")
    assert aeb.evaluate(facts, **ROAD).bounds["efficiency1"] == (1, 1)
    with pytest.raises(FactError, match=r"Vehicle\(ego\) the bound \[0.5, 0.5\]"):
        aeb(Facts.parse("Vehicle(ego): [0.5, 0.5]."), **ROAD)


def test_the_papers_entity_weights(aeb):
    facts = Facts.parse(
        "Pedestrian(p1). OnRoad(p1). Pedestrian(p2). OnCrosswalk(p2): 0.6. Pedestrian(p3)."
        "Pedestrian(p4). OnRoad(p4): 0.4. Truck(t1). Vehicle(v1). Crosswalk(a1)."
    )
    weights = aeb.entity_weights(facts, ["p1", "p2", "p3", "p4", "t1", "v1", "a1", "nobody"])
    assert weights == {
        "p1": 1.0, "p2": 1.0, "p3": 0.5, "p4": 0.5, "t1": 0.75, "v1": 0.5, "a1": 0.0, "nobody": 0.0
    }  # fmt: skip


def test_conclusions_stand_for_the_facts_that_they_were_drawn_from(aeb):
    facts = Facts.parse("Pedestrian(p1): 0.8. OnRoad(p1). CenterOf(p1, ego). EmptyLane(ego).")
    conclusions = aeb.conclude(facts)
    outcome = aeb.evaluate(conclusions, **ROAD)
    assert outcome == aeb.evaluate(facts, **ROAD)
    assert outcome.conclusions is conclusions
    assert aeb.entity_weights(conclusions, ["p1"]) == aeb.entity_weights(facts, ["p1"])
    assert str(aeb.explain(conclusions, **ROAD)) == str(aeb.explain(facts, **ROAD))


def test_an_outcome_knows_the_rules_that_fired_for_whichever_entity(aeb):
    def fired(text):
        return aeb.evaluate(Facts.parse(text), **ROAD).fired

    assert fired("") == set()
    assert fired("Pedestrian(p1): 0.1. OnRoad(p1). CenterOf(p1, ego).") == {"safe1"}
    assert fired("Vehicle(v1). Pedestrian(p1). OnRoad(p1). CenterOf(p1, v1).") == {"safe1"}


def test_coefficients_and_parameters_can_be_set_and_only_those_there_are():
    reward = RewardFunction("aeb")
    facts = Facts.parse("Pedestrian(p1). OnCrosswalk(p1).")
    reward.coefficients["safety"]["safe2"] = 0.5
    reward.parameters["safety"]["zeta"] = 0.1
    outcome = reward.evaluate(facts, **ROAD)
    assert outcome.weights["safety"] == pytest.approx(0.5 / 3)
    assert outcome.terms["safety"] == pytest.approx(-0.36 * 0.5 / 3)
    with pytest.raises(UsageError, match="did you mean 'safe2'"):
        reward.coefficients["safety"]["saef2"] = 1.0
    with pytest.raises(UsageError, match="can't be nan"):
        reward.parameters["safety"]["zeta"] = math.nan
    for twin in (pickle.loads(pickle.dumps(reward)), copy.deepcopy(reward)):
        assert twin.evaluate(facts, **ROAD) == outcome


def test_an_unknown_engine():
    with pytest.raises(UsageError, match="did you mean 'compiled'"):
        RewardFunction("aeb", engine="compild")


def test_the_hash_of_a_reward_includes_what_was_set():
    reward = RewardFunction("aeb")
    assert reward.hash == reward.kb.hash
    reward.coefficients["safety"]["safe2"] = 0.5
    assert reward.hash != reward.kb.hash
    assert reward.current().weights["safety"].coefficients["safe2"] == 0.5
    reward.coefficients["safety"]["safe2"] = 1.0
    assert reward.hash == reward.kb.hash
    reward.parameters["comfort"]["xi"] = 0.1
    assert RewardFunction(reward.current()).hash == reward.hash != reward.kb.hash
