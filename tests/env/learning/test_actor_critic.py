"""What PPO learns with: a critic that may see more than the actor."""

import contextlib

import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3 import PPO

from env.driving.setup import Setup
from env.learning.actor_critic import ActorCritic
from env.learning.new_model import untrained_model
from env.learning.vector_streets import make_streets
from env.street.observation import STATE_FIELDS, PrivilegedObserver, StateObserver, observer_of
from tests.env.spaces import Spaces

SMALL = {"n_steps": 64, "batch_size": 64, "device": "cpu"}
NARROW = {"net_arch": {"pi": [8], "vf": [8]}}


@pytest.mark.parametrize("frames", [1, 3])
def test_the_actor_sees_no_state_and_the_critic_nothing_else(frames):
    """Of each frame, two numbers are the street's and three the state's."""
    observed = spaces.Box(-1.0, 1.0, (frames * 5,), np.float32)
    split = {"frames": frames, "state_size": 3}
    model = PPO(ActorCritic, Spaces(observed), policy_kwargs=NARROW | split, **SMALL)
    seen = torch.rand(1, frames, 5, requires_grad=True)
    policy = model.policy
    policy.get_distribution(seen.flatten(1)).distribution.mean.sum().backward()
    of_actor, seen.grad = seen.grad, None
    policy.predict_values(seen.flatten(1)).sum().backward()
    is_state = torch.zeros(1, frames, 5, dtype=torch.bool)
    is_state[..., 2:] = True
    assert torch.equal(of_actor != 0.0, ~is_state)
    is_state[:, :-1] = False  # what has been tells the critic nothing more
    assert torch.equal(seen.grad != 0.0, is_state)


@pytest.mark.parametrize(
    ("changes", "shared"),
    [
        ({"critic": "state"}, False),
        ({}, True),
        ({"critic": "state", "observation": "state", "perception": "truth"}, True),
    ],
)
def test_a_setup_says_what_the_critic_sees(changes, shared):
    stages = [{"steps": 4096, "traffic": ["low"], "occlusion": ["full"]}]
    chosen = {"version": 1, "name": "s", "stages": stages, "fusion": "ssi", "streets": 1}
    learning = {"observation_scale": 0.5}
    setup = Setup.model_validate(chosen | changes | {"learning": learning})
    with contextlib.closing(make_streets(setup, setup.stages[0].cells, seed=7)) as streets:
        extractor = untrained_model(setup, streets).policy.mlp_extractor
        actor, critic = (net[0].in_features for net in (extractor.policy_net, extractor.value_net))
        (size,) = streets.observation_space.shape
        if shared:
            assert actor == critic == size
        else:
            assert (actor, critic) == (size - len(STATE_FIELDS), len(STATE_FIELDS))
            # The state is of the order of 1 and is not scaled.
            state = streets.reset()[:, -len(STATE_FIELDS) :]
            (street,) = streets.get_attr("street")
            np.testing.assert_array_equal(state, StateObserver()(street)[None])


def test_a_privileged_observation_is_another_one_and_the_state():
    """Tried with the state itself, which needs no picture."""
    inner = observer_of("state", 224)
    both = PrivilegedObserver(inner)
    stages = [{"steps": 1, "traffic": ["low"], "occlusion": ["full"]}]
    setup = Setup.model_validate({"version": 1, "name": "s", "stages": stages, "streets": 1})
    setup = setup.model_copy(update={"observation": "state", "perception": "truth"})
    with contextlib.closing(make_streets(setup, setup.stages[0].cells, seed=7)) as streets:
        streets.reset()
        (street,) = streets.get_attr("street")
        seen = both(street)
        np.testing.assert_array_equal(seen, np.tile(inner(street), 2))
        assert both.space.contains(seen)
