"""The bundled knowledge bases: their tests, and that these tests would notice a change."""

from pathlib import Path

import pytest

from sfol import KnowledgeBase
from sfol.errors import InvalidKnowledgeBase
from sfol.knowledge_base.loading import bundled_folder, bundled_names
from sfol.literals import Negated
from sfol.testing.cases import run_tests

AEB = KnowledgeBase.load("aeb")
FILE = bundled_folder() / "aeb.yaml"


def changed_bodies():
    """Every rule with one literal removed, or replaced by its negation."""
    for rule in AEB.rules.values():
        literals = rule.clause.body.atom_literals
        for i, literal in enumerate(literals):
            others = [*literals[:i], *literals[i + 1 :]]
            negated = [*literals[:i], Negated(literal.atom), *literals[i + 1 :]]
            yield pytest.param(rule, others, id=f"{rule.name} without {literal}")
            yield pytest.param(rule, negated, id=f"{rule.name} with not {literal}")


@pytest.mark.parametrize("name", bundled_names())
def test_their_tests_pass(name):
    report = run_tests(KnowledgeBase.load(name))
    assert report.passed, report
    if name == "aeb":
        assert report.covered == len(AEB.rules)


@pytest.mark.parametrize(("rule", "literals"), list(changed_bodies()))
def test_every_literal_of_every_rule_is_tested(rule, literals, tmp_path):
    body = ", ".join(map(str, literals))
    text = FILE.read_text()
    assert str(rule.clause) in text
    copy = tmp_path / "aeb.yaml"
    copy.write_text(text.replace(str(rule.clause), f"{rule.clause.head} :- {body}."))
    try:
        report = run_tests(KnowledgeBase.load(copy))
    except InvalidKnowledgeBase:
        return  # a head without its literal, or an unsafe rule: it does not even load
    assert not report.passed
    differences = [line for result in report.results for line in result.differences]
    head = rule.clause.head.predicate
    assert any("expected" in line and "found" in line for line in differences)
    assert head == "Vehicle" or any(f"bound of {head}" in line for line in differences)


@pytest.mark.parametrize(
    ("name", "removed"),
    [
        ("ablations/pe_cs", {"efficiency2", "efficiency3"}),
        ("ablations/ce_ps", {"safe2", "safe3_right", "safe3_center", "safe3_left"}),
        ("ablations/pe_ps", {"efficiency2", "efficiency3", "safe2", "safe3_right",
                             "safe3_center", "safe3_left"}),
    ],
)  # fmt: skip
def test_ablations_remove_the_subtle_rules_and_nothing_else(name, removed):
    ablation = KnowledgeBase.load(name)
    assert set(AEB.rules) - set(ablation.rules) == removed
    assert ablation.weights == AEB.weights  # the normalizer stays 3
    assert ablation.terms.keys() == AEB.terms.keys()


def test_the_street_and_an_ablation_together():
    kb = KnowledgeBase.load("crossing", "ablations/pe_cs")
    assert "efficiency2" not in kb.rules
    assert kb.grounding == KnowledgeBase.load("crossing").grounding
    assert [Path(file).stem for file in kb.files] == ["aeb", "crossing", "pe_cs"]
