"""Cases worked out by hand, on every engine and on the naive reference."""

import pytest

from sfol import Atom, Facts, KnowledgeBase
from sfol.engines.compiled import CompiledEngine
from sfol.testing.naive import naive_conclusions
from tests.differential.programs import program


@pytest.fixture(params=["naive", "compiled", "pyreason"])
def derived(request):
    """Return a function: knowledge base and text of facts to conclusions, by one reading."""
    if request.param == "naive":
        return lambda kb, text: naive_conclusions(kb, Facts.parse(text, margin=0.05))
    engine = CompiledEngine
    if request.param == "pyreason":
        engine = request.getfixturevalue("pyreason")
    return lambda kb, text: engine(kb).conclude(Facts.parse(text, margin=0.05)).derived


@pytest.fixture
def bound(derived):
    """Return a function: knowledge base and text of facts to the subject's h."""
    return lambda kb, text: derived(kb, text).get(Atom("h", ("ego",)))


# -- the paper's rules ----------------------------------------------------------------------------


def test_thirteen_bounds_are_pooled_for_four_pedestrians_ahead_of_ten(derived):
    text = "".join(
        f"Pedestrian(p{i}): [{(i + 1) / 10}, {(i + 1) / 10}]. OnRoad(p{i}): [0.5, 0.9]."
        + (f"CenterOf(p{i}, ego)." if i < 4 else f"LeftOf(p{i}, ego).")
        for i in range(10)
    )
    # Vehicle(ego) once; of p0 … p3 a Pedestrian (.1 + .2 + .3 + .4), an OnRoad and a CenterOf
    expected = (1 + 1.0 + 4 * 0.5 + 4) / 13, (1 + 1.0 + 4 * 0.9 + 4) / 13
    found = derived(KnowledgeBase.load("aeb"), text)
    assert found[Atom("safe1", ("ego",))] == pytest.approx(expected)


def test_of_the_three_rules_for_safe3_the_greatest_counts(derived):
    text = (
        "Vehicle(v1): [0.5, 1]. Vehicle(v2): [0.6, 0.6]. Crosswalk(a1). RightOf(v1, ego)."
        "CenterOf(v2, ego). Occludes(v1, a1). Occludes(v2, a1)."
    )
    # right: (1 + .5 + 1 + 1 + 1)/5 = .9 and 1; centre: (1 + .6 + 1 + 1 + 1)/5 = .92 twice
    found = derived(KnowledgeBase.load("aeb"), text)
    assert found[Atom("safe3", ("ego",))] == pytest.approx((0.92, 1.0))


def test_a_truck_next_to_an_asserted_vehicle(derived):
    found = derived(
        KnowledgeBase.load("aeb"),
        "Truck(t1): [0.4, 0.6]. Vehicle(t1): [0.5, 0.5]. Crosswalk(a1). LeftOf(t1, ego)."
        "Occludes(t1, a1).",
    )
    assert found[Atom("Vehicle", ("t1",))] == pytest.approx((0.5, 0.6))
    assert found[Atom("safe3", ("ego",))] == pytest.approx(((4 + 0.5) / 5, (4 + 0.6) / 5))


# -- literals -------------------------------------------------------------------------------------


def test_an_unknown_atom_satisfies_nothing(bound):
    assert bound(program("h(X) :- P(X), Q(X)."), "P(ego).") is None


def test_an_atom_of_which_anything_may_be_true_satisfies(bound):
    assert bound(program("h(X) :- P(X)."), "P(ego): [0, 1].") == (0.0, 1.0)


def test_an_atom_known_to_be_false_satisfies_nothing(bound):
    assert bound(program("h(X) :- P(X), Q(X)."), "P(ego). Q(ego): [0, 0].") is None


def test_a_threshold_is_met_at_its_very_value(bound):
    kb = program({"rule": "h(X) :- P(X), Q(X).", "threshold": 0.3})
    assert bound(kb, "P(ego): [0.3, 0.7]. Q(ego).") == pytest.approx((0.65, 0.85))
    assert bound(kb, "P(ego): [0.2999, 0.7]. Q(ego).") is None


def test_negation(bound):
    kb = program("h(X) :- P(X), not Q(X).")
    assert bound(kb, "P(ego): [0.2, 0.75].") == pytest.approx((0.6, 0.875))
    # [1 − .2, 1 − .1] = [.8, .9]
    known = "P(ego): [0.2, 0.75]. Q(ego): [0.1, 0.2]."
    assert bound(kb, known) == pytest.approx(((0.2 + 0.8) / 2, (0.75 + 0.9) / 2))
    assert bound(kb, "P(ego). Q(ego): [0.1, 0.5].") == pytest.approx((0.75, 0.95))
    assert bound(kb, "P(ego). Q(ego): [0.1, 0.6].") is None


def test_negation_of_a_pair(bound):
    kb = program("h(X) :- P(X), Q(Y), not R(X, Y).")
    text = "P(ego). Q(a): 0.5. Q(b): 0.8. R(ego, a)."
    # only b is left: (1 + [.76, .84] + 1) / 3
    assert bound(kb, text) == pytest.approx((2.76 / 3, 2.84 / 3))


def test_a_body_of_nothing_but_negation(bound):
    kb = program("h(ego) :- not Q(nobody).")
    assert bound(kb, "") == (1.0, 1.0)
    assert bound(kb, "Q(nobody): [0.1, 0.3].") == pytest.approx((0.7, 0.9))
    assert bound(kb, "Q(nobody).") is None


# -- bodies ---------------------------------------------------------------------------------------


def test_a_bodys_variables_are_tied_to_the_head(derived):
    kb = program("h(X) :- V(X), P(Y), R(Y, X).")
    text = "V(a). V(b). P(p1): [0.2, 0.2]. P(p2): [0.8, 0.8]. R(p1, a). R(p2, b)."
    found = derived(kb, text)
    # PyReason alone averages over both P and gives .75
    assert found[Atom("h", ("a",))] == pytest.approx((2.2 / 3, 2.2 / 3))
    assert found[Atom("h", ("b",))] == pytest.approx((2.8 / 3, 2.8 / 3))


def test_two_literals_need_one_substitution(derived):
    kb = program("h(X) :- R(Y, X), S(X, Y).")
    assert derived(kb, "R(a, b). S(b, c). R(c, d). S(d, a).") == {}
    assert derived(kb, "R(a, b). S(b, a): [0.5, 0.5].") == {
        Atom("h", ("b",)): pytest.approx((0.75, 0.75))
    }


def test_a_body_whose_variables_form_a_cycle(bound):
    kb = program("h(X) :- P(X), R(Y, Z), S(Z, W), T(W, Y).")
    triangle = "P(ego). R(a, b): [0.4, 0.4]. S(b, c). T(c, a)."
    assert bound(kb, triangle) == pytest.approx((3.4 / 4, 3.4 / 4))
    # a way around six entities has every pair, and no three that close
    assert bound(kb, "P(ego). R(a, b). S(b, c). T(c, d). R(d, e). S(e, f). T(f, a).") is None


def test_a_guard_between_two_neighbours_of_the_subject(bound):
    kb = program("h(X) :- R(Y, X), R(Z, X), Y != Z.")
    assert bound(kb, "R(a, ego).") is None
    found = bound(kb, "R(a, ego): [0.4, 0.4]. R(b, ego): [0.8, 0.8].")
    assert found == pytest.approx((0.6, 0.6))  # both, once for each literal


def test_a_variable_twice_in_one_literal(bound):
    kb = program("h(X) :- P(X), R(Y, Y).")
    assert bound(kb, "P(ego). R(a, b).") is None
    assert bound(kb, "P(ego). R(a, a): [0.5, 0.6].") == pytest.approx((0.75, 0.8))


def test_a_constant_that_closes_a_cycle(bound):
    kb = program("h(X) :- P(X), R(Y, stone), S(stone, Z), T(Y, Z).")
    text = "P(ego). R(a, stone). R(b, stone). S(stone, c). S(stone, d). T(a, c): [0.5, 0.5]."
    assert bound(kb, text) == pytest.approx((3.5 / 4, 3.5 / 4))


def test_a_head_of_two_arguments(derived):
    kb = program("e(X, Y) :- R(X, Z), S(Z, Y).")
    found = derived(kb, "R(a, m): [0.5, 0.5]. S(m, b). R(c, n). S(n, d): [0.2, 0.4].")
    assert found == {
        Atom("e", ("a", "b")): pytest.approx((0.75, 0.75)),
        Atom("e", ("c", "d")): pytest.approx((0.6, 0.7)),
    }


# -- operators ------------------------------------------------------------------------------------

TWO = "P(ego). R(ego, a): [0.1, 0.9]. R(ego, b): [0.4, 0.5]."


@pytest.mark.parametrize(
    ("semantics", "expected"),
    [
        ({}, (1.5 / 3, 2.4 / 3)),
        ({"groundings": "best"}, (0.7, 0.95)),  # the lower end of b, the upper end of a
        ({"conjunction": "minimum"}, (0.4, 0.9)),
        ({"conjunction": "product"}, (0.4, 0.9)),
        ({"conjunction": "lukasiewicz"}, (0.4, 0.9)),
    ],
)
def test_pooled_against_best(bound, semantics, expected):
    assert bound(program("h(X) :- P(X), R(X, Y).", **semantics), TWO) == pytest.approx(expected)


def test_best_keeps_together_what_belongs_together(bound):
    kb = program("h(X) :- P(Y), R(Y, X).", conjunction="product")
    text = "P(a): [0.9, 0.9]. R(a, ego): [0.2, 0.2]. P(b): [0.3, 0.3]. R(b, ego): [0.8, 0.8]."
    assert bound(kb, text) == pytest.approx((0.24, 0.24))  # not .9 · .8


def test_probabilistic_sum_of_two_rules_and_an_assertion(bound):
    kb = program("h(X) :- P(X).", "h(X) :- Q(X).", disjunction="probabilistic_sum")
    text = "P(ego): [0.5, 0.5]. Q(ego): [0.2, 0.4]. h(ego): [0, 0.1]."
    assert bound(kb, text) == pytest.approx((1 - 0.5 * 0.8, 1 - 0.5 * 0.6 * 0.9))


def test_an_atom_asserted_and_derived_with_disjoint_bounds(bound):
    kb = program("h(X) :- P(X).")
    assert bound(kb, "P(ego): [0.1, 0.2]. h(ego): [0.7, 0.8].") == pytest.approx((0.7, 0.8))


def test_strata(bound):
    kb = program("h(X) :- g(X), P(X).", "g(X) :- V(X), not Q(X).", "V(X) :- P(X).")
    # V .4; g (.4 + 1)/2 = .7; h (.7 + .4)/2 = .55
    assert bound(kb, "P(ego): [0.4, 0.4].") == pytest.approx((0.55, 0.55))


# -- certainty, or and implies, names -------------------------------------------------------------


def test_certainties_of_two_rules(bound):
    kb = program(
        {"rule": "h(X) :- P(X).", "certainty": 0.5},
        {"rule": "h(X) :- Q(X).", "certainty": [0.25, 1]},
        {"rule": "h(X) :- R(Y, Z), S(Z, Y), P(X).", "certainty": 0.1},
        disjunction="probabilistic_sum",
    )
    assert bound(kb, "P(ego): [0.4, 0.8].") == pytest.approx((0.2, 0.4))
    both = bound(kb, "P(ego): [0.4, 0.8]. Q(ego): [0.4, 0.8].")
    assert both == pytest.approx((1 - 0.8 * 0.9, 1 - 0.6 * 0.2))
    cyclic = bound(kb, "P(ego): [1, 1]. R(a, b). S(b, a).")
    assert cyclic == pytest.approx((1 - 0.5 * 0.9, 1 - 0.5 * 0.9))


def test_or_and_implies(bound):
    kb = program("h(X) :- P(X), (Q(X) or R(X, Y)).")
    assert bound(kb, "P(ego). R(ego, a): [0.4, 0.6].") == pytest.approx((0.7, 0.8))
    assert bound(kb, "P(ego).") is None
    kb = program("h(X) :- P(X), (Q(X) implies V(X)).")
    assert bound(kb, "P(ego).") == (1.0, 1.0)
    assert bound(kb, "P(ego). Q(ego).") is None
    assert bound(kb, "P(ego). Q(ego). V(ego): [0.2, 0.4].") == pytest.approx((0.6, 0.7))


def test_integers_and_quoted_texts(derived):
    kb = program('h(X) :- R(X, "Mary (Ann), 1"), X != 7.', "e(-1, X) :- P(X), not Q(X).")
    found = derived(kb, "R(7, 'Mary (Ann), 1'). R(\"X\", 'Mary (Ann), 1'): [0.5, 0.6]. P(8).")
    assert found == {
        Atom("h", ('"X"',)): pytest.approx((0.5, 0.6)),
        Atom("e", ("-1", "8")): (1.0, 1.0),
    }
