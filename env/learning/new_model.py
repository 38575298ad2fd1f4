"""PPO's model before its first update: untrained, or with the policy that it starts from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.utils import LinearSchedule, obs_as_tensor
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from env.driving.policies import SUFFIX, TRAINED, check_exists, policy_file
from env.driving.policy_files import PolicyFile, actor_of, load_actor
from env.driving.setup import Setup
from env.learning.actor_critic import ActorCritic, Networks
from env.learning.callbacks import Progress
from env.street.observation import STATE_FIELDS
from sfol.errors import SfolError, UsageError
from vsr.hypervectors.codebook import Codebook

Array = npt.NDArray[np.float32]

# Of the policy, a small network: on a GPU, where the workers' networks run, an update took half as
# long again as on the processor beside it.
DEVICE = "cpu"
# Of a setup's hyperparameters, those that PPO does not take as they are.
_OWN = {
    "learning_rate",
    "last_learning_rate",
    "last_log_std",
    "layers",
    "mean_init",
    "log_std_init",
    "reward_scale",
    "observation_scale",
    "rollout_steps",
    "value_steps",
    "whitening_steps",
}
# How a value function is learnt alone: nothing that is learnt beside it can go wrong meanwhile.
_VALUE_LEARNING = {"learning_rate": 1e-3, "last_learning_rate": 1e-3, "n_epochs": 10}


def start_of(setup: Setup) -> PolicyFile | None:
    """Return the policy that a setup's training starts from; None if it starts from nothing.

    Raises:
        UsageError: there is no such policy, or it drives by something else than the setup says.
    """
    if setup.start is None:
        return None
    path = policy_file(setup.start)
    if path is None or path.suffix != SUFFIX:
        raise UsageError(
            f"a training can't start from '{setup.start}'",
            name=setup.start,
            suggestion=f"'{TRAINED}', or a policy that aeb train wrote, which ends in {SUFFIX}",
        )
    check_exists(path)
    file = PolicyFile(path)
    _check_fit(file, setup)
    return file


def codebook_of(setup: Setup) -> Codebook | None:
    """Return the symbols that a setup's policy is trained with; None where it observes no vector.

    They are those of the policy that the training starts from, if there is one.
    """
    if setup.observation != "vsr":
        return None
    start = start_of(setup)
    return start.codebook() if start else Codebook()


def _check_fit(file: PolicyFile, setup: Setup) -> None:
    """Refuse a policy whose numbers would mean something else; there may be more of them now."""
    former = file.card().setup
    for key in ("observation", "fusion"):
        _check_same(file, key, getattr(former, key), getattr(setup, key))
    for key in ("speed", "frames"):
        _check_same(file, key, getattr(former, key), min(getattr(former, key), getattr(setup, key)))
    _check_same(file, "layers", list(former.learning.layers), list(setup.learning.layers))
    file.load()  # refused now, and not after the streets are built


def _check_same(file: PolicyFile, key: str, former: object, new: object) -> None:
    if former != new:
        raise UsageError(
            f"'{file.path}' was trained with {key} {former}, and the setup has {new}",
            name=key,
            suggestion="the same in the setup, or a training from nothing, without start",
        )


def new_model(setup: Setup, streets: VecEnv, progress: Progress = lambda steps, stage: None) -> PPO:
    """Return a model for a setup's training; it gives the streets its seed.

    Args:
        setup: gives hyperparameters and what the policy starts from.
        streets: that it will learn on; some steps are driven there, if the setup asks for them.
        progress: called with 0 and what is being done, while they are driven.

    Raises:
        UsageError: the policy to start from can't be used.
    """
    model, start = untrained_model(setup, streets), start_of(setup)
    if start is not None:
        load_actor(model, start, setup)
        _learn_value(model, setup, streets, progress)
    elif setup.learning.whitening_steps:
        _whiten(model, setup, streets, progress)
    return model


class FinitePPO(PPO):
    """PPO that ends when its networks' numbers are no longer finite."""

    def train(self) -> None:
        """Do an update.

        Raises:
            SfolError: it has left weights or outputs that are not finite.
        """
        super().train()
        seen = obs_as_tensor(cast(Array, self._last_obs), self.device)
        with torch.no_grad():
            outputs = (self.policy.get_distribution(seen).mode(), self.policy.predict_values(seen))
        if not (is_finite(self) and all(output.isfinite().all() for output in outputs)):
            raise _diverged()


@contextmanager
def divergence_told() -> Iterator[None]:
    """Make an error of ours of what torch says when numbers of a policy are not finite.

    Raises:
        SfolError: they are not.
    """
    try:
        yield
    except ValueError as error:
        if "to satisfy the constraint" not in str(error):  # torch's words for them
            raise
        raise _diverged() from None


def _diverged() -> SfolError:
    return SfolError(
        "the training has diverged: not all numbers of its networks are finite",
        suggestion="a smaller learning_rate or reward_scale, and another --output; checkpoints "
        "from before and the best policy are kept",
    )


def is_finite(model: PPO) -> bool:
    """Tell whether all weights of a model are finite."""
    return all(bool(tensor.isfinite().all()) for tensor in model.policy.state_dict().values())


def untrained_model(setup: Setup, streets: VecEnv) -> PPO:
    """Return a model with a setup's hyperparameters that has seen nothing."""
    learning = setup.learning
    layers = list(learning.layers)
    model = FinitePPO(
        ActorCritic,
        streets,
        seed=setup.seed,
        device=DEVICE,
        policy_kwargs={
            "net_arch": {"pi": layers, "vf": layers},
            "log_std_init": learning.log_std_init,
            "frames": setup.frames,
            "state_size": len(STATE_FIELDS) if setup.privileged else 0,
            # What a policy to start from has been whitened by is part of its first layer.
            "whitened": bool(learning.whitening_steps) and setup.start is None,
        },
        learning_rate=LinearSchedule(
            learning.learning_rate, learning.last_learning_rate, end_fraction=1.0
        ),
        n_steps=learning.rollout_steps // setup.streets,
        **learning.model_dump(exclude=_OWN),
    )
    torch.nn.init.constant_(cast(nn.Linear, model.policy.action_net).bias, learning.mean_init)
    return model


def _learn_value(model: PPO, setup: Setup, streets: VecEnv, progress: Progress) -> None:
    """Let the policy drive as it is, until the value function, which it has none of, fits it.

    With a random one, the first updates would spoil what the policy can do already.
    """
    steps = setup.learning.value_steps
    learning = setup.learning.model_copy(update=_VALUE_LEARNING)
    learner = untrained_model(setup.model_copy(update={"learning": learning}), streets)
    learner.policy.load_state_dict(model.policy.state_dict())
    for parameter in (*actor_of(learner).parameters(), learner.policy.log_std):
        parameter.requires_grad_(False)

    def report(*_: object) -> bool:
        progress(0, f"learning its value, {learner.num_timesteps} of {steps} steps")
        return True

    learner.learn(steps, callback=report)
    model.policy.load_state_dict(learner.policy.state_dict())


def _whiten(model: PPO, setup: Setup, streets: VecEnv, progress: Progress) -> None:
    """Let an untrained policy drive, and whiten observations by what it sees."""
    steps, noise_steps = setup.learning.whitening_steps, setup.learning.sde_sample_freq
    observations: Any = streets.reset()
    seen: list[Array] = []
    while len(seen) * streets.num_envs < steps:
        if model.use_sde and noise_steps > 0 and len(seen) % noise_steps == 0:
            model.policy.reset_noise(streets.num_envs)
        progress(0, f"looking around, {len(seen) * streets.num_envs} of {steps} steps")
        seen.append(observations)
        observations, *_ = streets.step(model.predict(observations)[0])
    networks = cast(Networks, model.policy.mlp_extractor)
    assert networks.whitening is not None
    networks.whitening.measure(networks.of_actor(torch.from_numpy(np.concatenate(seen))))
