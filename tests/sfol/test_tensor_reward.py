"""Rewards as operations of torch alone: the same numbers, one graph, and no question to the host."""

import numpy as np
import pytest

import sfol
from sfol.errors import FactError, SfolError, UsageError
from tests.sfol.hall import HALL

torch = pytest.importorskip("torch")


def lander(batch, seed=0):
    """Return steps of LunarLander, tensors."""
    chance = np.random.default_rng(seed)
    before, after = chance.normal(0.0, 0.5, (2, batch, 8))
    before[:, 6:] = after[:, 6:] = chance.integers(0, 2, (batch, 2))
    native, ended = chance.normal(0.0, 1.0, batch), chance.random(batch) < 0.5
    return tuple(map(torch.tensor, (before, np.zeros(batch), after, native, ended, ~ended)))


def pole(batch, seed=0):
    """Return steps of CartPole, tensors."""
    before, after = np.random.default_rng(seed).normal(0.0, 0.5, (2, batch, 4))
    return torch.tensor(before), None, torch.tensor(after)


def hall(batch, seed=0):
    """Return steps in the hall, where four people are or are not there."""
    chance = np.random.default_rng(seed)

    def observation():
        return {
            "people": torch.tensor(chance.normal(0.0, 3.0, (batch, 4, 2))),
            "mask": torch.tensor(chance.random((batch, 4)) < 0.7),
            "body": {"state": torch.tensor(chance.normal(0.0, 1.0, (batch, 5)))},
            "light": torch.tensor(chance.random(batch)),
        }

    return observation(), torch.tensor(chance.normal(0.0, 1.0, (batch, 1))), observation()


WORLDS = {"cartpole": pole, "lunarlander": lander, "hall": hall}


@pytest.fixture(params=WORLDS)
def world(request, tmp_path):
    """Return a reward function, and what makes steps for it."""
    (tmp_path / "hall.yaml").write_text(HALL)
    rules = tmp_path / "hall.yaml" if request.param == "hall" else request.param
    return sfol.RewardFunction(rules), WORLDS[request.param]


def mapped(function, value):
    """Return nested tensors, each of which a function is applied to."""
    if isinstance(value, dict):
        return {key: mapped(function, part) for key, part in value.items()}
    if isinstance(value, tuple):
        return tuple(mapped(function, part) for part in value)
    return None if value is None else function(value)


def test_it_says_what_transitions_says(world):
    reward, make = world
    on_tensors = reward.on_tensors(*make(3, seed=1))
    steps = make(300)
    found, expected = on_tensors(*steps), reward.transitions(*steps)
    assert torch.allclose(found.reward, expected.reward, atol=1e-12, rtol=1e-12)
    for name in ("terms", "weights", "confidences"):
        ours, theirs = getattr(found, name), getattr(expected, name)
        assert list(ours) == list(theirs)
        for key, values in theirs.items():
            assert torch.allclose(ours[key], values, atol=1e-12, rtol=1e-12), key
    assert len(set(expected.reward.tolist())) > 30


def test_steps_may_have_any_leading_axes(world):
    reward, make = world
    on_tensors = reward.on_tensors(*make(1))
    steps = make(6)
    expected = on_tensors(*steps).reward
    grid = mapped(lambda tensor: tensor.reshape(2, 3, *tensor.shape[1:]), steps)
    assert torch.equal(on_tensors(*grid).reward, expected.reshape(2, 3))
    one = mapped(lambda tensor: tensor[4], steps)
    assert on_tensors(*one).reward == expected[4]


def test_it_can_be_mapped(world):
    reward, make = world
    on_tensors = reward.on_tensors(*make(1))
    given = tuple(part for part in make(5) if part is not None)
    places = [i for i, part in enumerate(make(5)) if part is not None]

    def one(*parts):
        step = [None] * 6
        for place, part in zip(places, parts, strict=True):
            step[place] = part
        return on_tensors(*step).reward

    assert torch.equal(torch.vmap(one)(*given), on_tensors(*make(5)).reward)


def test_it_is_one_graph_that_asks_nothing(world):
    """What is on the device `meta` has no values: whatever looked at one would fail."""
    reward, make = world
    on_tensors = reward.on_tensors(*make(1))
    nowhere = mapped(lambda tensor: tensor.to("meta"), make(7))
    assert on_tensors(*nowhere).reward.shape == (7,)
    graph = torch.compile(on_tensors, fullgraph=True, backend="eager")
    assert torch.equal(graph(*make(7)).reward, on_tensors(*make(7)).reward)


def test_gradients_are_those_of_transitions(world):
    reward, make = world
    on_tensors = reward.on_tensors(*make(1))
    gradients = []
    for judge in (on_tensors, reward.transitions):
        before, *rest = make(40)
        wanted = mapped(lambda t: t.requires_grad_() if t.is_floating_point() else t, before)
        judge(wanted, *rest).reward.sum().backward()
        first = wanted["people"] if isinstance(wanted, dict) else wanted
        gradients.append(first.grad)
    assert torch.allclose(*gradients, atol=1e-9)
    assert gradients[0].abs().sum() > 0


def test_what_would_be_an_error_is_not_a_number():
    reward = sfol.RewardFunction("cartpole")
    on_tensors = reward.on_tensors(*pole(1))
    before, _, after = pole(3)
    before[1, 0] = torch.nan
    with pytest.raises(FactError, match="NaN in scene 1"):
        reward.transitions(before, None, after)
    outcome = on_tensors(before, None, after)
    assert outcome.reward.isnan().tolist() == [False, True, False]
    assert outcome.terms["balance"].isnan().tolist() == [False, True, False]
    before[1, :2] = torch.tensor([1.0, torch.inf])
    with pytest.raises(SfolError, match="scene 1"):
        reward.transitions(before, None, after)
    assert on_tensors(before, None, after).reward.isnan().tolist() == [False, True, False]


def test_numbers_of_rules_are_those_of_the_moment():
    reward = sfol.RewardFunction("cartpole")
    early = reward.on_tensors(*pole(1))
    before = early(*pole(5)).reward
    reward.parameters["balance"]["gain"] = 5.0
    late = reward.on_tensors(*pole(1))
    assert torch.equal(early(*pole(5)).reward, before)
    assert torch.equal(late(*pole(5)).reward, reward.transitions(*pole(5)).reward)
    assert not torch.equal(late(*pole(5)).reward, before)


def test_a_form_that_does_not_fit_is_an_error():
    reward = sfol.RewardFunction("cartpole")
    with pytest.raises(SfolError, match="cart"):
        reward.on_tensors(torch.zeros(1, 3))


def test_what_is_too_much_is_an_error(monkeypatch):
    monkeypatch.setattr("sfol.engines.tape.MOST_LANES", 5)
    with pytest.raises(UsageError, match="too much for one graph") as caught:
        sfol.RewardFunction("cartpole").on_tensors(*pole(1))
    assert "transitions" in caught.value.suggestion
