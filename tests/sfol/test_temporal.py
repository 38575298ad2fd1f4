"""Operators over time: what each says of the steps of an episode, by hand, and what is refused."""

import pytest

import sfol
from sfol.clauses import parse_clause
from sfol.errors import ClauseError, InvalidKnowledgeBase
from sfol.temporal import MAXIMUM_DEPTH, OPERATORS, smoothed, steps_of
from tests.sfol.harbour import course, harbour


def near(*bounds):
    return ["" if b is None else f"Near(pilot): [{b[0]}, {b[1]}]." for b in bounds]


LOW, HIGH, NO = (0.2, 0.4), (0.6, 0.9), None


def test_previously_is_what_was_so_one_step_before():
    scenes = near(LOW, HIGH, NO, NO)
    assert course("previously(Near(X))", scenes) == [NO, LOW, HIGH, NO]


def test_once_is_the_greatest_within_its_duration():
    # Lower and upper bounds have a maximum of their own; two steps back are one second.
    scenes = near((0.5, 0.5), (0.2, 0.9), NO, NO, NO)
    expected = [(0.5, 0.5), (0.5, 0.9), (0.5, 0.9), (0.2, 0.9), NO]
    assert course("once[1](Near(X))", scenes) == expected


def test_held_is_the_least_once_its_duration_has_passed():
    scenes = near(HIGH, (0.5, 1.0), HIGH, HIGH, NO, HIGH, HIGH, HIGH)
    both = (0.5, 0.9)
    expected = [NO, NO, both, both, NO, NO, NO, HIGH]
    assert course("held[1](Near(X))", scenes) == expected


def test_since_lasts_while_its_first_argument_does():
    begun = "Warned(pilot): [0.5, 0.6]."
    scenes = [*near(HIGH), begun, *near(HIGH, LOW, HIGH, NO, HIGH)]
    expected = [NO, (0.5, 0.6), (0.5, 0.6), (0.2, 0.4), (0.2, 0.4), NO, NO]
    assert course("since(Near(X), Warned(X))", scenes) == expected


def test_since_begins_anew_with_what_is_better():
    scenes = ["Warned(pilot): 0.3.", "Near(pilot). Warned(pilot): 0.8.", "Near(pilot)."]
    expected = [(0.3, 0.3), (0.8, 0.8), (0.8, 0.8)]
    assert course("since(Near(X), Warned(X))", scenes) == expected


def test_latched_goes_on_and_off_at_confidences_of_its_own():
    scenes = [f"Near(pilot): {c}." for c in (0.5, 0.7, 0.5, 0.3, 0.29, 0.5)]
    on = (1.0, 1.0)
    expected = [NO, on, on, on, NO, NO]
    assert course("latched(Near(X), on=0.7, off=0.3)", scenes) == expected


def test_latched_goes_off_with_what_is_no_longer_known():
    scenes = near((1.0, 1.0), NO, (0.5, 0.5))
    assert course("latched(Near(X), on=0.7, off=0.3)", scenes) == [(1.0, 1.0), NO, NO]


def test_rose_and_fell_are_the_steps_of_a_change():
    # Not Near has [0.8, 0.9] where Near has [0.1, 0.2], and [1, 1] where it is unknown.
    scenes = near((0.1, 0.2), (0.7, 0.9), (0.7, 0.9), NO, NO)
    assert course("rose(Near(X))", scenes) == [(0.1, 0.2), (0.7, 0.9), NO, NO, NO]
    assert course("fell(Near(X))", scenes) == [NO, NO, NO, (0.7, 0.9), NO]


def test_fell_is_as_certain_as_what_is_left_lets_it_be():
    scenes = near((0.9, 1.0), (0.2, 0.4))
    assert course("fell(Near(X))", scenes) == [NO, (0.6, 0.8)]


def test_operators_stand_in_each_other():
    scenes = near(HIGH, NO, NO, NO, NO)
    assert course("once[1](previously(Near(X)))", scenes) == [NO, HIGH, HIGH, HIGH, NO]
    assert course("previously(once[1](Near(X)))", scenes) == [NO, HIGH, HIGH, HIGH, NO]


def test_operators_speak_of_heads():
    more = "  close: close(X) :- Near(X), Warned(X).\n"
    scenes = ["Near(pilot). Warned(pilot): 0.5.", "Near(pilot)."]
    expected = [(0.75, 0.75), (0.75, 0.75)]
    assert course("once[1](close(X))", scenes, more=more) == expected
    assert course("previously(close(X))", scenes, more=more) == [NO, (0.75, 0.75)]


def test_a_head_may_depend_on_its_own_past():
    # Once warned, warned for ever: what was concluded one step before is concluded again.
    body = "previously(said(X))"
    more = "  first: said(X) :- Warned(X).\n"
    assert course(body, ["", "Warned(pilot).", "", ""], more=more) == [NO, *[(1.0, 1.0)] * 3]


def test_a_head_may_not_depend_on_its_own_present():
    with pytest.raises(InvalidKnowledgeBase, match="depend on each other in a circle"):
        harbour("once[1](said(X)), Near(X)")


def test_who_is_no_longer_there_is_remembered():
    scenes = ["Behind(v1, pilot).", "", "Near(v1)."]
    assert course("once[1](Behind(Y, X)), Near(Y)", scenes) == [NO, NO, (1.0, 1.0)]


def test_negation_and_anonymous_variables():
    scenes = ["Near(pilot). Behind(v1, pilot).", "Near(pilot).", "Near(pilot).", "Near(pilot)."]
    body = "Near(X), not once[1](Behind(_, X))"
    assert course(body, scenes) == [NO, NO, NO, (1.0, 1.0)]
    assert course("once[1](Behind(_, X))", scenes) == [(1.0, 1.0)] * 3 + [NO]


def test_constants_and_connectives():
    body = "Near(X), (previously(Behind(v1, X)) or previously(Behind(X, X)))"
    assert course(body, ["Behind(v1, pilot).", "Near(pilot)."]) == [NO, (1.0, 1.0)]
    body = "Near(X), (previously(Near(X)) implies Warned(X))"
    scenes = ["Near(pilot).", "Near(pilot).", "Near(pilot). Warned(pilot)."]
    assert course(body, scenes) == [(1.0, 1.0), NO, (1.0, 1.0)]


def test_operators_stand_in_counts():
    warned = "Warned(pilot)."
    scenes = ["Near(a1).", warned, f"Near(a2). {warned}", warned, warned]
    body = "Warned(X), count(P : once[1](Near(P))) >= 2"
    assert [b is not None for b in course(body, scenes)] == [
        False, False, True, False, False,
    ]  # fmt: skip


def test_operators_stand_in_foralls():
    scenes = ["Near(a1).", "", "Near(a2).", "Near(a2). Warned(a2).", ""]
    body = "Warned(X), forall(P: once[1](Near(P)))(once[1](Warned(P)))"
    scenes = [f"Warned(pilot). {scene}" for scene in scenes]
    assert [b is not None for b in course(body, scenes)] == [
        False, False, False, True, True,
    ]  # fmt: skip


def test_conditions_of_entity_weights():
    more = "entity_weights:\n  - {when: 'once[0.5](Near(X))', weight: 0.75}\n"
    reward = sfol.RewardFunction(harbour("Near(X)", more=more))
    episode = reward.episode()
    for scene, expected in (("Near(b1).", 0.75), ("", 0.75), ("", 0.0)):
        conclusions = episode.conclude(sfol.Facts.parse(scene))
        assert reward.entity_weights(conclusions, ["b1"]) == {"b1": expected}


@pytest.mark.parametrize(
    ("duration", "step", "expected"),
    [(1.5, 0.1, 15), (0.3, 0.1, 3), (0.29, 0.1, 2), (0.05, 0.1, 0), (1e308, 1e-308, 2**53)],
)
def test_durations_are_whole_steps_up_to_rounding(duration, step, expected):
    assert steps_of(duration, step) == expected


def test_smoothing_follows_as_a_first_order_lag():
    assert smoothed(1.0, 0.0, 0.0, 0.1) == 0.0
    assert smoothed(1.0, 0.0, 2.0, 2.0) == pytest.approx(0.36787944117144233)
    # In ten steps as far as in one step ten times as long.
    value = 1.0
    for _ in range(10):
        value = smoothed(value, 0.0, 2.0, 0.2)
    assert value == pytest.approx(smoothed(1.0, 0.0, 2.0, 2.0))


# -- text ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "body",
    [
        "previously(P(X))",
        "once[1.5](P(X, Y)), not held[2](Q(Y))",
        "since(P(X), Q(X, Y)), latched(P(Y), on=0.7, off=0.3)",
        "rose(P(X)), fell(once[3](previously(P(X, _))))",
        "once[0.25](P(X)) >= 0.5",
        'once[1](P(X, "a{0}", 7)), Raining, previously(Raining)',
    ],
)
def test_what_is_printed_is_read_as_the_same(body):
    clause = parse_clause(f"h(X) :- {body}.")
    assert str(clause) == f"h(X) :- {body}."
    assert parse_clause(str(clause)) == clause


def test_a_number_is_printed_in_one_way_only():
    assert parse_clause("h(X) :- once[1.0](P(X)).") == parse_clause("h(X) :- once[1](P(X)).")


@pytest.mark.parametrize(
    ("body", "message", "suggestion"),
    [
        ("onec[1](P(X))", "there is no operator over time 'onec'", "did you mean 'once'?"),
        ("previosly(P(X))", "there is no operator over time 'previosly'", "'previously'"),
        ("until(P(X), Q(X))", "there is no operator over time 'until'", "known: above, below"),
        ("once(P(X))", "'[' is expected", "say how far back: once[1.5](P(X))"),
        ("once[-1](P(X))", "'once' can't look back -1", "a finite duration above 0"),
        ("held[0](P(X))", "'held' can't look back 0", "a finite duration above 0"),
        ("once[1e999](P(X))", "'once' can't look back inf", "a finite duration above 0"),
        ("previously P(X)", "'(' is expected", "previously(P(X))"),
        ("previously(P(X), Q(X))", "')' is expected", "what 'previously' speaks of ends there"),
        ("previously(not P(X))", "speaks of atoms", "write not before the operator"),
        ("since(P(X))", "',' is expected", "'since' speaks of 2 atoms"),
        ("since(P(Y), Q(X))", "'Y' stands in P(Y), but not in Q(X)", "let a rule conclude P"),
        ("latched(P(X), on=0.2, off=0.4)", "goes on at 0.2 and off below 0.4", "0 < off ≤ on"),
        ("latched(P(X), 0.4)", "'on' is expected", "latched(P(X), on=0.7, off=0.3)"),
        ("latched(P(X), on=2, off=0.4)", "a bound can't be 2", "from 0 to 1"),
    ],
)
def test_errors_say_what_is_wrong_and_what_to_write(body, message, suggestion):
    with pytest.raises(ClauseError) as caught:
        parse_clause(f"h(X) :- {body}.")
    assert message in caught.value.message
    assert suggestion in caught.value.suggestion
    assert caught.value.offset is not None


def test_depth_is_limited():
    body = "P(X)"
    for _ in range(MAXIMUM_DEPTH):
        body = f"previously({body})"
    parse_clause(f"h(X) :- {body}.")
    with pytest.raises(ClauseError, match=f"more than {MAXIMUM_DEPTH} deep"):
        parse_clause(f"h(X) :- previously({body}).")


@pytest.mark.parametrize("name", OPERATORS)
def test_no_predicate_is_called_like_an_operator(name):
    for text in (f"{name}(X) :- P(X).", f"h :- {name}."):
        with pytest.raises(ClauseError, match=name):
            parse_clause(text)
    with pytest.raises(ClauseError, match="operator over time and no predicate"):
        sfol.Facts.parse(f"{name}(p1).")
