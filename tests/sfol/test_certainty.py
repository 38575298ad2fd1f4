"""Rules with a certainty: what they conclude is multiplied by it."""

import io

import numpy as np
import pytest
from rich.console import Console

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.errors import InvalidKnowledgeBase
from sfol.knowledge_base import KnowledgeBaseFile
from sfol.knowledge_base.printing import to_yaml
from sfol.knowledge_base.tables_view import summary_table
from sfol.syntax import Atom
from sfol.testing.naive import naive_conclusions
from sfol.tools.diff import compare
from sfol.tools.subsumption import compared
from tests.differential.dense import dense_conclusions
from tests.differential.programs import program
from tests.sfol.command_line import sfol

H = Atom("h", ("ego",))


def rule(certainty, text="h(X) :- P(X), R(X, Y)."):
    return {"rule": text, "certainty": certainty}


def bounds_of(kb, text):
    """The subject's h, in every way in which it can be concluded."""
    facts, reward = Facts.parse(text), RewardFunction(kb)
    batch = reward.batch([facts])
    found = reward.evaluate(batch).bounds["h"]
    yield reward.evaluate(facts).bounds["h"]
    yield naive_conclusions(kb, facts).get(H)
    yield dense_conclusions(kb, [facts])[0].get(H)
    yield (float(found.lower[0]), float(found.upper[0])) if found.known[0] else None


TEXT = "P(ego): [0.5, 1]. R(ego, a): [0.9, 1]. R(ego, b): [0.1, 0.2]."


@pytest.mark.parametrize(
    ("certainty", "semantics", "expected"),
    [
        (0.8, {}, (0.5 * 0.8, 2.2 / 3 * 0.8)),
        ([0.8, 1], {}, (0.5 * 0.8, 2.2 / 3)),
        ([0, 0.5], {}, (0.0, 2.2 / 6)),
        (0.5, {"groundings": "best"}, (0.35, 0.5)),
        (0.5, {"conjunction": "product"}, (0.225, 0.5)),
        (1, {}, (0.5, 2.2 / 3)),
    ],
)
def test_the_bound_of_the_body_is_multiplied(certainty, semantics, expected):
    for found in bounds_of(program(rule(certainty), **semantics), TEXT):
        assert found == pytest.approx(expected)


def test_what_is_asserted_and_what_others_conclude_is_not_multiplied():
    kb = program(rule(0.5, "h(X) :- P(X)."), "h(X) :- Q(X).")
    for found in bounds_of(kb, "P(ego). Q(ego): [0.1, 0.6]. h(ego): [0.3, 0.4]."):
        assert found == pytest.approx((0.5, 0.6))
    kb = program(
        rule(0.5, "h(X) :- P(X)."), rule(0.2, "h(X) :- Q(X)."), disjunction="probabilistic_sum"
    )
    for found in bounds_of(kb, "P(ego). Q(ego)."):
        assert found == pytest.approx((0.6, 0.6))


def test_thresholds_of_later_rules_see_what_is_left():
    kb = program(rule(0.5, "g(X) :- P(X)."), {"rule": "h(X) :- g(X).", "threshold": 0.5})
    for found in bounds_of(kb, "P(ego)."):
        assert found == pytest.approx((0.5, 0.5))
    for found in bounds_of(kb, "P(ego): [0.9, 1]."):
        assert found is None


def test_gradients_go_through_it():
    torch = pytest.importorskip("torch")
    kb = program(rule([0.5, 1.0], "h(X) :- P(X)."))
    reward = RewardFunction(kb)
    batch = reward.batch([Facts.parse("P(ego): [0.4, 0.8].")])
    ends = [torch.tensor(np.asarray(end), requires_grad=True) for end in (batch.lower, batch.upper)]
    reward.evaluate(batch.with_bounds(*ends)).confidences["h"].sum().backward()
    row = [atom for _, atom in batch.atoms].index(Atom("P", ("ego",)))
    assert [float(end.grad[row]) for end in ends] == [0.25, 0.5]


@pytest.mark.parametrize(
    ("certainty", "message"),
    [
        (1.5, "the certainty of 'rule0' has the bound [1.5, 1.5]"),
        ([0.9, 0.3], "the certainty of 'rule0' has the bound [0.9, 0.3]"),
        (float("nan"), "the certainty of 'rule0' has the bound [nan, nan]"),
        (0, "the certainty of 'rule0' is 0: the rule concludes nothing"),
        ([0, 0], "the certainty of 'rule0' is 0: the rule concludes nothing"),
    ],
)
def test_what_is_no_certainty_is_refused(certainty, message):
    with pytest.raises(InvalidKnowledgeBase) as caught:
        program(rule(certainty))
    (error,) = caught.value.errors
    assert message in str(error)


@pytest.mark.parametrize("text", ["'0.8'", "[0.8]", "[0.1, 0.2, 0.3]", "likely", "true", "{a: 1}"])
def test_of_another_shape_it_is_refused_with_its_place(kitchen, text):
    with pytest.raises(InvalidKnowledgeBase) as caught:
        kitchen({"careful(X) :-": f"\n    certainty: {text}\n    rule: careful(X) :-"})
    (error,) = caught.value.errors
    assert "rules.care.certainty" in str(error)
    assert error.place.line == 13


def test_printed_it_is_the_same_and_has_another_hash(tmp_path):
    hashes = {program(rule(1.0)).hash, program("h(X) :- P(X), R(X, Y).").hash}
    assert len(hashes) == 1
    for certainty in (0.8, [0.8, 1]):
        kb = program(rule(certainty))
        path = tmp_path / "printed.yaml"
        path.write_text(to_yaml(kb))
        assert f"certainty: {certainty}" in path.read_text().replace("1.0", "1")
        assert KnowledgeBase.load(path).hash == kb.hash
        hashes.add(kb.hash)
    assert len(hashes) == 3


def test_a_difference_names_it():
    (change,) = compare(program(rule(1.0)), program(rule([0.8, 1])))
    assert (change.before, change.after) == ({"certainty": "1.0"}, {"certainty": "[0.8, 1.0]"})


def test_explanations_say_it():
    kb = KnowledgeBase.of(
        KnowledgeBaseFile.model_validate(
            {
                "version": 1,
                "name": "likely",
                "predicates": {"P(X)": ""},
                "rules": {"likely": rule([0.8, 1], "h(X) :- P(X).")},
                "weights": {"w": {"normalizer": 1, "coefficients": {"h": 1}}},
                "terms": {"t": {"weight": "w", "formula": "1"}},
            }
        )
    )
    explained = RewardFunction(kb).explain(Facts.parse("P(ego): [0.5, 0.5]."))
    assert "h(X) :- P(X).  [0.4, 0.5] with certainty [0.8, 1.0]" in str(explained)
    assert "certainty [0.8, 1.0]" in _text(summary_table(kb))


def _text(table):
    console = Console(width=200, file=io.StringIO())
    console.print(table)
    return console.file.getvalue()


def test_only_a_rule_that_is_as_certain_covers_another():
    kb = program(
        rule(0.4, "h(X) :- P(X)."),
        rule(0.9, "h(X) :- P(X), Q(X)."),
        rule([0.1, 0.5], "h(X) :- P(X), V(X)."),
        rule([0.1, 0.4], "h(X) :- P(X), R(X, Y)."),
    )
    covered = [(a.name, b.name) for a, b in compared(kb.rules.values()).covered]
    assert covered == [("rule0", "rule3")]


def test_the_command_line_checks_a_file_that_has_it(kitchen, tmp_path):
    kitchen({"careful(X) :-": "\n    certainty: [0.5, 1]\n    rule: careful(X) :-"})
    assert "certainty: [0.5, 1.0]" in sfol("show", tmp_path / "kitchen.yaml", "--yaml").out
