"""Formulas of terms that read heads: their confidences for the subject."""

import networkx as nx
import numpy as np
import pytest
import yaml

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.errors import InvalidKnowledgeBase
from sfol.knowledge_base import KnowledgeBaseFile
from sfol.tools.graph import GraphNode, dependency_graph
from sfol.tools.lint import lint

HINGE = {
    "haste: {weight: care, formula: -k * speed, parameters: {k: 2.0}}": (
        "haste: {weight: -1, formula: k * (1 - careful)**2 * speed, parameters: {k: 2.0}}"
    )
}
FACTS = "Pot(p). Near(p, cook). Hot(p): 0.5."


def changed(formula, **more):
    return {HINGE_FROM: f"haste: {{weight: 1, formula: {formula}, parameters: {{k: 2.0}}}}", **more}


(HINGE_FROM,) = HINGE


def test_a_formula_reads_a_confidence(kitchen):
    reward = RewardFunction(kitchen(HINGE))
    outcome = reward.evaluate(Facts.parse(FACTS), speed=3.0)
    confidence = outcome.confidences["careful"]
    assert 0 < confidence < 1
    assert outcome.reward == pytest.approx(-2.0 * (1 - confidence) ** 2 * 3.0)
    assert reward(Facts(), speed=3.0) == -6.0  # nothing was concluded


def test_batches_and_their_gradients(kitchen):
    torch = pytest.importorskip("torch")
    reward = RewardFunction(kitchen(HINGE))
    scenes = [Facts.parse(FACTS), Facts()]
    batch = reward.batch(scenes)
    found = reward.evaluate(batch, speed=np.array([3.0, 1.0])).reward
    np.testing.assert_allclose(found, [reward(scenes[0], speed=3.0), reward(scenes[1], speed=1.0)])
    upper = torch.tensor(batch.upper, requires_grad=True)
    outcome = reward.evaluate(batch.with_bounds(torch.tensor(batch.lower), upper), speed=3.0)
    outcome.reward.sum().backward()
    slopes = {str(atom): float(g) for (_, atom), g in zip(batch.atoms, upper.grad, strict=True)}
    # 2 k (1 − τ̂) speed, times the share of Hot(p)'s upper bound in τ̂: one of four atoms, halved.
    confidence = float(outcome.confidences["careful"][0])
    assert slopes["Hot(p)"] == pytest.approx(2 * 2.0 * (1 - confidence) * 3.0 / 8)


def test_observations_of_many_scenes_and_their_gradients():
    torch = pytest.importorskip("torch")
    content = """
version: 1
name: lane
subject: ego
predicates: {Slow(X): X is slow.}
observation: {ego: {fields: [speed]}}
facts: {Slow(ego): {formula: 1 - ego.speed / 10, bounds: exact}}
rules: {calm: "calm(X) :- Slow(X)."}
terms: {calm: {weight: 1, formula: -(1 - calm)**2}}
"""
    reward = RewardFunction(
        KnowledgeBase.of(KnowledgeBaseFile.model_validate(yaml.safe_load(content)))
    )
    speed = torch.tensor([[2.0], [5.0]], dtype=torch.float64, requires_grad=True)
    outcome = reward.transition(speed)
    outcome.reward.sum().backward()
    np.testing.assert_allclose(outcome.reward.detach(), [-0.04, -0.25])
    np.testing.assert_allclose(speed.grad[:, 0], [-0.04, -0.1])


def test_an_explanation_shows_the_proof_of_what_was_read(kitchen):
    text = str(RewardFunction(kitchen(HINGE)).explain(Facts.parse(FACTS), speed=3.0))
    assert "careful = 0." in text
    assert "careful(cook) [" in text
    assert "Hot(p) [0.475, 0.525]  asserted" in text or "Hot(p) [0.5, 0.5]  asserted" in text
    nothing = str(RewardFunction(kitchen(HINGE)).explain(Facts(), speed=3.0))
    assert "careful(cook): nothing concluded" in nothing


def test_the_graph_leads_from_the_head_to_the_term(kitchen):
    graph = dependency_graph(kitchen(HINGE))
    assert nx.has_path(graph, GraphNode("head", "careful"), GraphNode("term", "haste"))


def test_a_head_that_only_a_formula_reads_need_not_be_declared(kitchen):
    kb = kitchen({**HINGE, "  care: {normalizer: 1, coefficients: {careful: 1.0}}": "  {}"})
    assert kb.terms["haste"].heads == ("careful",)
    assert not [finding for finding in lint(kb) if "careful" in finding.message]


def test_a_head_that_an_overlay_removed_is_zero(kitchen, tmp_path):
    base = kitchen({**HINGE, "rules:": "rules:\n  calm: calm(X) :- Person(X).",
                    "{careful: 1.0}": "{careful: 1.0, calm: 1.0}"})  # fmt: skip
    path = tmp_path / "over.yaml"
    path.write_text("version: 1\nname: over\nextends: kitchen\nremove: {rules: [care]}\n")
    kb = KnowledgeBase.load(path)
    assert base.terms["haste"].heads == kb.terms["haste"].heads == ("careful",)
    assert RewardFunction(kb)(Facts.parse(FACTS), speed=3.0) == -6.0
    assert "SF004" in {finding.code for finding in lint(kb) if finding.path[0] == "terms"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (changed("k * speed", **{"speed: {unit: m/s}": "careful: {unit: m/s}"}), "no signal"),
        (changed("k * careful", **{"speed: {unit: m/s}": "careful: {unit: m/s}"}),
         "'careful' is a signal and a head"),
        ({HINGE_FROM: "haste: {weight: 1, formula: careful, parameters: {careful: 2.0}}"},
         "'careful' is a parameter and a head"),
        (changed("k * carefull"), "Did you mean 'careful'"),
        (changed("k * Hot"), "'Hot', which is no signal, parameter or head of the subject"),
        (changed("k * beside", **{"rules:": "rules:\n  beside: beside(X, Y) :- Near(X, Y), Hot(X)."}),
         "'beside', which is no signal, parameter or head of the subject"),
    ],
)  # fmt: skip
def test_names_that_could_mean_two_things_or_none_are_refused(kitchen, changes, message):
    with pytest.raises(InvalidKnowledgeBase) as caught:
        kitchen({**changes, "version: 1": "version: 2"})
    assert message.lower() in str(caught.value).lower()
