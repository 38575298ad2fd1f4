"""Defects planted in each engine, one after the other: the comparison notices every one.

The comparison is the one of `test_engines_agree`, on scenes that are the same on every run.
"""

import math
import sys
from dataclasses import replace
from itertools import islice

import pytest

from sfol.engines import compiled
from sfol.engines import program as engine_program
from sfol.engines import pyreason as translation
from sfol.engines.compiled import CompiledEngine
from sfol.engines.flat import Flat
from sfol.engines.rounds import Recursion
from sfol.engines.tables import Tables
from sfol.facts import TRUE
from sfol.literals import Negated, NotEqual, Positive, negated
from sfol.operators import CONJUNCTIONS, DISJUNCTIONS
from sfol.testing.laws import assert_same
from sfol.testing.naive import naive_conclusions
from tests.differential.programs import SMALL, drawn_scenes

SCENES = (*SMALL, *drawn_scenes(60))


def disagreements(engine, most):
    """Yield what an engine concludes otherwise than the naive reference, `most` times at most."""
    for kb, facts in SCENES:
        try:
            assert_same(naive_conclusions(kb, facts), engine(kb).conclude(facts).derived)
        except AssertionError as difference:
            yield str(difference)
            most -= 1
        if most == 0:
            return


class NothingAsserted(Tables):
    """Tables that forget what was asserted of a head."""

    __slots__ = ()

    def bound(self, atom):
        return None


# -- in both engines ------------------------------------------------------------------------------


def maximum_for_mean(monkeypatch):
    average = CONJUNCTIONS["average"]
    monkeypatch.setitem(CONJUNCTIONS, "average", replace(average, combine=max))


def minimum_for_product(monkeypatch):
    product = CONJUNCTIONS["product"]
    monkeypatch.setitem(CONJUNCTIONS, "product", replace(product, combine=min))


def minimum_of_several_rules(monkeypatch):
    maximum = DISJUNCTIONS["maximum"]
    monkeypatch.setitem(DISJUNCTIONS, "maximum", replace(maximum, combine=min))


def negation_dropped(monkeypatch):
    monkeypatch.setattr(negated, "negation", lambda bound: TRUE)


def raw_bounds_of_negated_atoms(monkeypatch):
    monkeypatch.setattr(negated, "negation", lambda bound: bound)


# -- in the compiled engine -----------------------------------------------------------------------


def less_for_at_most_at_the_threshold(monkeypatch):
    def holds(literal, rule):
        reading = right(literal, rule)
        return lambda known: None if known.lower == rule.threshold else reading(known)

    right = Positive.holds
    monkeypatch.setattr(Positive, "holds", holds)


def lost_grounding(monkeypatch):
    for gathering in (compiled._Pool, compiled._Best):
        right = gathering.add

        def first_only(self, search, right=right):
            if not self.__bool__():
                right(self, search)

        monkeypatch.setattr(gathering, "add", first_only)


def lost_value_of_a_flat_body(monkeypatch):
    right = Flat._of_each
    monkeypatch.setattr(Flat, "_of_each", lambda self, *scene: right(self, *scene)[:1])


def negated_literal_left_out(monkeypatch):
    monkeypatch.setattr(Negated, "step", lambda self, number, slots, criterion, then: then)


def guard_dropped(monkeypatch):
    monkeypatch.setattr(NotEqual, "step", lambda self, number, slots, criterion, then: then)


def asserted_bound_no_disjunct(monkeypatch):
    monkeypatch.setattr(engine_program, "Tables", NothingAsserted)


def atoms_known_to_be_false_count(monkeypatch):
    def holds(literal, rule):
        return lambda known: known if known.lower >= rule.threshold else None

    monkeypatch.setattr(Positive, "holds", holds)


def rounds_cut_short(monkeypatch):
    right = Recursion.rounds
    monkeypatch.setattr(Recursion, "rounds", lambda self, tables: islice(right(self, tables), 2))


def certainty_forgotten(monkeypatch):
    monkeypatch.setattr(compiled, "with_certainty", lambda conjunction, certainty: conjunction)


def upper_bounds_without_certainty(monkeypatch):
    right = compiled.with_certainty

    def lower_alone(conjunction, certainty):
        return right(conjunction, certainty._replace(upper=1.0))

    monkeypatch.setattr(compiled, "with_certainty", lower_alone)


COMPILED = [
    maximum_for_mean,
    minimum_for_product,
    minimum_of_several_rules,
    less_for_at_most_at_the_threshold,
    lost_grounding,
    lost_value_of_a_flat_body,
    negation_dropped,
    raw_bounds_of_negated_atoms,
    negated_literal_left_out,
    guard_dropped,
    asserted_bound_no_disjunct,
    atoms_known_to_be_false_count,
    rounds_cut_short,
    certainty_forgotten,
    upper_bounds_without_certainty,
]


# -- in the PyReason engine -----------------------------------------------------------------------


def less_for_at_most_in_clauses(monkeypatch):
    def text(clause):
        above = min(math.nextafter(clause.threshold, 2.0), 1.0)
        return right(clause._replace(threshold=above))

    right = translation.QueryClause.__str__
    monkeypatch.setattr(translation.QueryClause, "__str__", text)


def lost_pooled_bound(monkeypatch):
    runtime = sys.modules["sfol.engines.pyreason_runtime"]
    right = runtime._pooled
    monkeypatch.setattr(
        runtime, "_pooled", lambda lowers, uppers: right(lowers[:-1], uppers[:-1]) or (0.0, 0.0)
    )


def lost_ground_rule(monkeypatch):
    right = translation.PyReasonEngine._grounded
    monkeypatch.setattr(
        translation.PyReasonEngine, "_grounded", lambda *given, pools: right(*given, pools=pools)[1:]
    )  # fmt: skip


def lost_head(monkeypatch):
    right = translation._possible_values
    monkeypatch.setattr(translation, "_possible_values", lambda *arguments: right(*arguments)[1:])


def guards_count_as_literals(monkeypatch):
    right = translation._query_body
    monkeypatch.setattr(
        translation, "_query_body", lambda rule: [c._replace(counts=True) for c in right(rule)]
    )


def asserted_bound_no_disjunct_of_queries(monkeypatch):
    monkeypatch.setattr(engine_program, "Tables", NothingAsserted)


def heads_left_untied(monkeypatch):
    monkeypatch.setattr(translation, "_is_tied", lambda head, body: len(head.arguments) == 1)


def cycles_left_to_pyreason(monkeypatch):
    monkeypatch.setattr(translation, "_is_cyclic", lambda rule: False)
    monkeypatch.setattr(translation, "_without_cycles", translation._singles_first)


def all_strata_at_once(monkeypatch):
    right = translation._levels
    monkeypatch.setattr(
        translation,
        "_levels",
        lambda program: [([r for level, _ in right(program) for r in level], False)],
    )


def one_round_alone(monkeypatch):
    right = translation._levels
    monkeypatch.setattr(
        translation, "_levels", lambda program: [(level, False) for level, _ in right(program)]
    )


def constants_left_in_cycles(monkeypatch):
    monkeypatch.setattr(translation, "_without_cycles", translation._singles_first)


def certainty_left_out(monkeypatch):
    monkeypatch.setattr(translation, "times", lambda bound, certainty: bound)


PYREASON = [
    maximum_for_mean,
    minimum_for_product,
    minimum_of_several_rules,
    negation_dropped,
    raw_bounds_of_negated_atoms,
    less_for_at_most_in_clauses,
    lost_pooled_bound,
    lost_ground_rule,
    lost_head,
    guards_count_as_literals,
    asserted_bound_no_disjunct_of_queries,
    heads_left_untied,
    cycles_left_to_pyreason,
    all_strata_at_once,
    one_round_alone,
    constants_left_in_cycles,
    certainty_left_out,
]


@pytest.mark.parametrize("defect", COMPILED, ids=lambda defect: defect.__name__)
def test_a_defect_in_the_compiled_engine_is_noticed(monkeypatch, defect):
    defect(monkeypatch)
    assert list(disagreements(CompiledEngine, most=1))


@pytest.mark.parametrize("defect", PYREASON, ids=lambda defect: defect.__name__)
def test_a_defect_in_the_pyreason_engine_is_noticed(monkeypatch, pyreason, defect):
    defect(monkeypatch)
    assert list(disagreements(pyreason, most=1))


def test_without_a_defect_there_is_nothing_to_notice(pyreason):
    assert not list(disagreements(CompiledEngine, most=1))
    assert not list(disagreements(pyreason, most=1))
