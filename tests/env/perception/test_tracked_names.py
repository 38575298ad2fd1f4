"""Tracked names are the same entities' for longer, and change nothing else on the street."""

from itertools import islice

import pytest

import sfol
from env.driving.drivers import Cautious
from env.driving.rollout import rollout
from env.street.crossing import OccludedCrossing


@pytest.fixture(scope="module")
def tracked(tmp_path_factory):
    overlay = tmp_path_factory.mktemp("rules") / "tracked.yaml"
    overlay.write_text("grounding: {segmentation: {tracking: {}}}\n")
    return sfol.KnowledgeBase.load("crossing", overlay)


def drive(rules, perception, steps):
    """Return what came of the steps of an episode, after some of another one."""
    with OccludedCrossing(
        traffic="high", perception=perception, observation="none", rules=rules
    ) as street:
        list(islice(rollout(street, Cautious(), seed=5), steps // 4))
        return list(islice(rollout(street, Cautious(), seed=6), steps))


def renamed(fact, names):
    return fact.predicate, tuple(names.get(name, name) for name in fact.arguments)


@pytest.mark.parametrize(("perception", "steps"), [("simulator", 150), ("truth", 200), ("unet", 8)])
def test_only_names_differ(tracked, perception, steps):
    plain, other = drive("crossing", perception, steps), drive(tracked, perception, steps)
    assert len(plain) == len(other)
    differ = 0
    for one, two in zip(plain, other, strict=True):
        counted, stable = one.scene.entities, two.scene.entities
        assert [(e.kind, e.box, e.confidence) for e in counted] == [
            (e.kind, e.box, e.confidence) for e in stable
        ]
        names = {b.name: a.name for a, b in zip(counted, stable, strict=True)}
        assert len(names) == len(stable)
        differ += any(old != new for new, old in names.items())
        facts = {renamed(fact, names): bound for fact, bound in two.scene.facts.items()}
        assert facts == {renamed(fact, {}): bound for fact, bound in one.scene.facts.items()}
        assert two.outcome.reward == one.outcome.reward
        assert two.outcome.confidences == one.outcome.confidences
        assert two.info == one.info
    # An episode begins as if none had been before.
    assert {e.name for e in plain[0].scene.entities} == {e.name for e in other[0].scene.entities}
    assert differ > 0 or perception == "unet"
