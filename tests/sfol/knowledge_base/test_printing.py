"""A knowledge base printed back as a file, and as tables."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfol import KnowledgeBase
from sfol.knowledge_base import Semantics, Signal
from sfol.knowledge_base.loading import bundled_names
from sfol.knowledge_base.printing import to_yaml
from sfol.testing.cases import run_tests
from sfol.tools.diff import compare
from tests.sfol.command_line import sfol


def again(folder, kb):
    path = folder / "again.yaml"
    path.write_text(to_yaml(kb))
    return KnowledgeBase.load(path)


def with_rules_only(kb):
    """Without the coefficients of heads whose rules were all removed, which add 0."""
    weights = {
        name: weight.model_copy(
            update={"coefficients": {h: c for h, c in weight.coefficients.items() if h in kb.heads}}
        )
        for name, weight in kb.weights.items()
    }
    return replace(kb, weights=weights)


@pytest.mark.parametrize("name", bundled_names())
def test_every_bundled_knowledge_base_comes_back(tmp_path, name):
    kb = KnowledgeBase.load(name)
    printed = again(tmp_path, kb)
    assert printed.hash == with_rules_only(kb).hash
    assert compare(with_rules_only(kb), printed) == ()
    assert (printed.name, printed.description.strip()) == (kb.name, kb.description.strip())
    assert printed.predicates == kb.predicates
    assert len(printed.tests) == len(kb.tests)
    assert run_tests(printed).passed
    assert to_yaml(printed) == to_yaml(kb)


numbers = st.floats(allow_nan=False, allow_infinity=False)
shares = st.floats(0, 1)
texts = st.text(st.characters(codec="utf-8", exclude_categories=["Cs", "Cc"]), max_size=40)


@settings(max_examples=25)
@given(numbers, shares, shares, numbers, texts, st.sampled_from(["average", "product"]), st.data())
def test_what_was_changed_as_objects_comes_back(
    tmp_path_factory, coefficient, threshold, at_least, parameter, text, conjunction, data
):
    kb = KnowledgeBase.load("aeb")
    rule = data.draw(st.sampled_from(list(kb.rules)))
    term = kb.terms["comfort"]
    weight = kb.weights["safety"]
    changed = replace(
        kb,
        description=text,
        semantics=Semantics(conjunction=conjunction, groundings=None),
        rules={**kb.rules, rule: replace(kb.rules[rule], threshold=threshold, description=text)},
        signals={**kb.signals, "t": Signal(unit=text or "1", default=parameter)},
        weights={
            **kb.weights,
            "safety": weight.model_copy(update={"coefficients": {"safe1": coefficient}}),
        },
        terms={
            **kb.terms,
            "comfort": replace(term, weight=coefficient, parameters={"xi": parameter}),
        },
        entity_weights=tuple(replace(e, at_least=at_least) for e in kb.entity_weights),
        tests=(),
    )
    assert again(tmp_path_factory.mktemp("kb"), changed).hash == changed.hash


def test_heads_are_declared_only_if_they_were(kitchen, tmp_path):
    assert "careful(X)" not in to_yaml(kitchen()).partition("rules:")[0]
    kb = kitchen({"  Lid(X)": "  careful(Y): Y is careful.\n  Lid(X)"})
    assert "careful(Y): Y is careful." in to_yaml(kb)
    constant = kitchen(
        {
            "care: careful(X) :- Person(X), Pot(P)": "a: careful(cook) :- Pot(P)",
            "Near(P, X)": "Near(P, cook)",
        }
    )
    assert again(tmp_path, constant).hash == constant.hash
    unread = kitchen({"semantics": "  hot: Hot(X) :- Pot(X), Lid(X).\nsemantics"})
    assert again(tmp_path, unread).hash == unread.hash


def test_a_predicate_knows_whether_it_was_declared(kitchen):
    kb = kitchen()
    assert set(kb.predicates) - set(kb.declared) == {"careful"}
    # Written just as the rule would introduce it, it is declared all the same.
    kb = kitchen({"  Lid(X)": '  careful(X): ""\n  Lid(X)'})
    assert set(kb.predicates) == set(kb.declared)
    assert "careful(X): ''" in to_yaml(kb)


def test_a_head_that_lost_its_rules_is_declared_in_the_file(kitchen, tmp_path):
    kb = kitchen({"semantics": "  calm: calm(X) :- careful(X), Lid(X).\nsemantics",
                  "{careful: 1.0}": "{calm: 1.0}"})  # fmt: skip
    without = replace(kb, rules={"calm": kb.rules["calm"]})
    assert again(tmp_path, without).hash == without.hash


def test_show_prints_tables_or_one_file():
    done = sfol("show", "crossing")
    assert "1/3 × (1 safe1 + 1 safe2 + 1 safe3)" in done.out
    assert all(
        part in done.out for part in ("truck_is_vehicle", "zeta = 0.05", "groundings pooled")
    )
    assert sfol("show", "crossing", "--yaml").out == to_yaml(KnowledgeBase.load("crossing"))
    assert sfol("show", "crosing").code == 2


def test_the_printed_file_is_formatted_and_valid(tmp_path):
    path = tmp_path / "flat.yaml"
    path.write_text(sfol("show", "crossing", "--yaml").out)
    assert sfol("check", path).code == 0
    assert sfol("fmt", "--check", path).code == 0
    assert sfol("diff", "crossing", path).code == 0
