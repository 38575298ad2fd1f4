"""What several substitutions of a rule come to, as the file or the rule itself says."""

import numpy as np
import pytest

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.errors import InvalidKnowledgeBase, KnowledgeBaseError
from sfol.knowledge_base.printing import to_yaml
from sfol.operators import GATHERINGS, nth_greatest
from sfol.testing.naive import naive_conclusions
from sfol.tools.diff import compare
from sfol.tools.lint import lint
from sfol.tools.subsumption import compared
from tests.differential.dense import dense_conclusions
from tests.differential.programs import program
from tests.sfol.command_line import sfol
from tests.sfol.test_certainty import H, bounds_of

NEAR = "h(X) :- P(Y), R(Y, X)."
ONE, FIVE = ("".join(f"P(p{i}): 0.6. R(p{i}, ego): 0.6. " for i in range(n)) for n in (1, 5))


def rule(groundings, text=NEAR, **more):
    return {"rule": text, "groundings": groundings, **more}


@pytest.mark.parametrize(
    ("groundings", "one", "five"),
    [
        ("pooled", 0.6, 0.6),
        ("best", 0.6, 0.6),
        ("sum", 0.6, 1.0),
        ("probabilistic_sum", 0.6, 1 - 0.4**5),
    ],
)
def test_five_may_say_more_than_one(groundings, one, five):
    for text, expected in ((ONE, one), (FIVE, five)):
        for kb in (program(rule(groundings)), program(NEAR, groundings=groundings)):
            for found in bounds_of(kb, text):
                assert found == pytest.approx((expected, expected)), (groundings, text)


def test_a_rule_overrides_the_file_and_others_keep_what_it_says():
    kb = program(rule("sum"), "g(X) :- P(Y), R(Y, X).", groundings="best")
    facts = Facts.parse("P(a): 0.2. R(a, ego): 0.2. P(b): 0.3. R(b, ego): 0.3.")
    bounds = RewardFunction(kb).evaluate(facts).bounds
    assert bounds["h"] == pytest.approx((0.5, 0.5))
    assert bounds["g"] == pytest.approx((0.3, 0.3))


def test_the_certainty_multiplies_the_sum():
    for found in bounds_of(program(rule("sum", certainty=[0.25, 0.5])), FIVE):
        assert found == pytest.approx((0.25, 0.5))


def test_lower_and_upper_bounds_are_added_apart():
    text = "P(a): [0.1, 0.9]. R(a, ego): [0.1, 0.9]. P(b): [0.3, 0.4]. R(b, ego): [0.3, 0.4]."
    for found in bounds_of(program(rule("sum")), text):
        assert found == pytest.approx((0.4, 1.0))
    for found in bounds_of(program(rule("probabilistic_sum")), text):
        assert found == pytest.approx((1 - 0.9 * 0.7, 1 - 0.1 * 0.6))


def test_every_substitution_counts_that_of_an_anonymous_variable_too():
    kb = program(rule("sum", "h(X) :- P(X), R(X, _).", certainty=1.0), conjunction="product")
    for found in bounds_of(kb, "P(ego): 0.5. R(ego, a): 0.5. R(ego, b): 0.25."):
        assert found == pytest.approx((0.375, 0.375))


def test_over_several_sorts_all_of_them_are_added():
    kb = program(rule("sum"), rule("probabilistic_sum", "e(X, Z) :- S(X, Y), R(Y, Z)."))
    facts = Facts.parse(
        "P(a): 0.2. R(a, ego): 0.2. P(b): 0.3. R(b, ego): 0.3. S(ego, b). S(ego, a)."
    )
    expected = naive_conclusions(kb, facts)
    for sorts in (1, 2, 3):
        found = dense_conclusions(kb, [facts, Facts()], sorts)[0]
        for atom, bound in expected.items():
            assert found[atom] == pytest.approx(tuple(bound))
    assert expected[H] == pytest.approx((0.5, 0.5))


def test_gradients_go_through_sums():
    torch = pytest.importorskip("torch")
    for groundings, gradient in (("sum", 0.5), ("probabilistic_sum", 0.5 * 0.7)):
        reward = RewardFunction(program(rule(groundings)))
        batch = reward.batch([Facts.parse("P(a): 0.2. R(a, ego): 0.2. P(b): 0.3. R(b, ego): 0.3.")])
        lower = torch.tensor(np.asarray(batch.lower), requires_grad=True)
        upper = torch.tensor(np.asarray(batch.upper))
        reward.evaluate(batch.with_bounds(lower, upper)).bounds["h"].lower.sum().backward()
        row = [str(atom) for _, atom in batch.atoms].index("P(a)")
        assert float(lower.grad[row]) == pytest.approx(gradient)


@pytest.mark.parametrize("numbers", [[0.25, 0.5, 0.125], [0.1, 0.2, 0.3, 0.9, 0.4, 0.0]])
@pytest.mark.parametrize("gathering", [*GATHERINGS.values(), nth_greatest(2), nth_greatest(3)])
@pytest.mark.parametrize("kind", ["numpy", "torch"])
def test_arrays_come_to_what_numbers_come_to(kind, gathering, numbers):
    from sfol.arrays import backend_of  # noqa: PLC0415

    make = np.array if kind == "numpy" else pytest.importorskip("torch").tensor
    column = make([[[number, 0.5]] for number in numbers])
    found = gathering.along(backend_of([column]), column, 0)
    assert tuple(found.shape) == (1, 1, 2)
    assert float(found[0, 0, 0]) == pytest.approx(gathering.combine(numbers))


def test_pyreason_has_the_best_of_one_rule_and_no_sum():
    pytest.importorskip("pyreason")
    facts = Facts.parse("P(a): 0.2. R(a, ego): 0.4. P(b): 0.3. R(b, ego): 0.9.")
    kb = program(rule("best"), "g(X) :- P(Y), R(Y, X).")
    ours, theirs = (
        RewardFunction(kb, engine=engine).evaluate(facts).bounds
        for engine in ("compiled", "pyreason")
    )
    for head in ("h", "g"):
        assert theirs[head] == pytest.approx(ours[head])
    with pytest.raises(KnowledgeBaseError, match="the groundings 'sum' of the rule 'rule0'"):
        RewardFunction(program(rule("sum")), engine="pyreason")


def test_what_is_no_such_word_is_refused_and_pooled_is_for_averages(kitchen):
    with pytest.raises(InvalidKnowledgeBase, match="probabilistic_sum"):
        kitchen({"careful(X) :-": "\n    groundings: total\n    rule: careful(X) :-"})
    with pytest.raises(InvalidKnowledgeBase, match="'pooled' is defined for 'average'") as caught:
        program(rule("pooled"), conjunction="minimum")
    (error,) = caught.value.errors
    assert error.suggestion == "write groundings: best"


def test_printed_shown_and_compared_it_is_there(tmp_path):
    path, plain = tmp_path / "sums.yaml", tmp_path / "plain.yaml"
    path.write_text(to_yaml(program(rule("sum"))), encoding="utf-8")
    plain.write_text(to_yaml(program(NEAR)), encoding="utf-8")
    old, new = KnowledgeBase.load(plain), KnowledgeBase.load(path)
    assert new.rules["rule0"].groundings == "sum"
    assert new.hash == program(rule("sum")).hash != old.hash
    (change,) = compare(old, new)
    assert "groundings" in str(change)
    assert "groundings sum" in sfol("show", path).out


def test_lint_speaks_of_the_rules_that_are_pooled():
    codes = {finding.code: finding for finding in lint(program(rule("sum"), NEAR))}
    assert "rule1:" in codes["SF006"].message
    assert "rule0" not in codes["SF006"].message
    assert "SF006" not in {finding.code for finding in lint(program(rule("best")))}


def test_rules_that_gather_otherwise_do_not_cover_each_other():
    assert not compared(program(NEAR, rule("sum")).rules.values()).covered
    assert compared(program(rule("sum"), rule("sum")).rules.values()).covered
