"""The public laws on drawn knowledge bases, facts and overlays, and that the laws notice defects."""

import importlib
import math
import random
import sys

import pytest
import yaml
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from sfol import Bound, Facts, KnowledgeBase, RewardFunction
from sfol.errors import MissingExtraError
from sfol.knowledge_base import KnowledgeBaseFile
from sfol.testing.laws import LAWS
from sfol.testing.strategies import knowledge_base_files, overlays, scenes

SLOW = [HealthCheck.too_slow, HealthCheck.data_too_large]
settings.register_profile("laws", max_examples=25, deadline=None, suppress_health_check=SLOW)
# Each example is one of every law: 100,000 in all.
settings.register_profile(
    "laws-long", max_examples=100_000 // len(LAWS), deadline=None, suppress_health_check=SLOW
)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
@settings(settings.get_profile("laws"))
@given(scene=scenes(), source=st.randoms())
def test_a_law_holds(law, scene, source):
    kb, facts = scene
    law(RewardFunction(kb), facts, source)


@pytest.mark.long
@settings(settings.get_profile("laws-long"))
@given(scene=scenes(), source=st.randoms())
def test_all_laws_hold_on_many(scene, source):
    kb, facts = scene
    reward = RewardFunction(kb)
    for law in LAWS:
        law(reward, facts, source)


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_a_law_holds_for_the_papers_rules(law):
    facts = Facts.parse(
        "Pedestrian(p1): 0.8. OnRoad(p1). CenterOf(p1, ego). Truck(t1): 0.6.", margin=0.05
    )
    for seed in range(20):
        law(RewardFunction("aeb"), facts, random.Random(seed))


@settings(settings.get_profile("laws"))
@given(data=st.data())
def test_an_overlay_changes_what_it_names_and_nothing_else(tmp_path_factory, data):
    base = data.draw(knowledge_base_files())
    overlay = data.draw(overlays(base))
    folder = tmp_path_factory.mktemp("overlay")
    content = base.model_dump(exclude_defaults=True) | {"version": 1}
    (folder / f"{base.name}.yaml").write_text(yaml.safe_dump(content))
    (folder / "overlay.yaml").write_text(yaml.safe_dump(overlay))
    before = KnowledgeBase.of(base).written_rules
    after = KnowledgeBase.load(folder / "overlay.yaml").written_rules
    removed = set(overlay["remove"]["rules"])
    assert set(after) == (set(before) - removed) | set(overlay["rules"])
    written = {name: parts[0].part_of or parts[0].clause for name, parts in after.items()}
    assert all(str(written[name]) == text for name, text in overlay["rules"].items())
    assert all(after[name] == before[name] for name in after if name not in overlay["rules"])


def test_without_hypothesis_the_error_names_the_extra(monkeypatch):
    monkeypatch.delitem(sys.modules, "sfol.testing.strategies")
    monkeypatch.setitem(sys.modules, "hypothesis", None)
    with pytest.raises(MissingExtraError, match=r"sfol\[testing\]"):
        importlib.import_module("sfol.testing.strategies")


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_a_law_has_nothing_against_a_knowledge_base_without_rules(law):
    kb = KnowledgeBase.of(KnowledgeBaseFile(version=1, name="empty"))
    law(RewardFunction(kb), Facts(), random.Random(0))


def inside(random):
    """A bound off the edges of [0, 1] and off every threshold, where there are derivatives."""
    lower, upper = sorted(0.06 + 0.88 * random.random() for _ in range(2))
    return Bound(lower, upper)


@settings(settings.get_profile("laws"))
@given(scene=scenes(), seed=st.integers(0, 2**32))
def test_gradients_are_finite_differences(scene, seed):
    torch = pytest.importorskip("torch")
    kb, facts = scene
    source = random.Random(seed)
    smooth = Facts()
    for atom, _ in facts.items():
        smooth.add(atom.predicate, *atom.arguments, bound=inside(source))
    reward = RewardFunction(kb)
    batch = reward.batch([smooth])
    ends = [torch.tensor(end, requires_grad=True) for end in (batch.lower, batch.upper)]
    generator = torch.Generator().manual_seed(seed)
    # The background stays true: a step across a threshold of 1 would not be a small change.
    moves = [torch.rand(e.shape, generator=generator, dtype=e.dtype) - 0.5 for e in ends]
    steps = [move * (end < 1.0) for move, end in zip(moves, ends, strict=True)]

    def total(step):
        moved = [end + step * direction for end, direction in zip(ends, steps, strict=True)]
        return reward.evaluate(batch.with_bounds(*moved), v=torch.ones(1), d=torch.ones(1)).reward

    value = total(0.0).sum()
    assume(value.requires_grad)
    gradients = torch.autograd.grad(value, ends, allow_unused=True, materialize_grads=True)
    slope = sum(float((g * d).sum()) for g, d in zip(gradients, steps, strict=True))
    step = 1e-7
    with torch.no_grad():
        difference = float((total(step) - total(-step)).sum()) / (2 * step)
    assert math.isclose(slope, difference, rel_tol=1e-4, abs_tol=1e-4)
