"""PPO's model before its first update: untrained, or with the policy that it starts from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import cast

import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.utils import LinearSchedule, obs_as_tensor
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from torch import Tensor, nn

from env.driving.policies import SUFFIX, TRAINED, check_exists, policy_file
from env.driving.policy_files import CLIP, Interface, PolicyFile, policy_network
from env.driving.setup import Setup
from env.learning.callbacks import Progress
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
    "gamma",
    "layers",
    "log_std_init",
    "norm_obs",
    "norm_reward",
    "observation_scale",
    "rollout_steps",
    "value_steps",
}
# What a policy has in common with the one that it starts from.
_SAME = ("observation", "fusion", "unit_rms", "decision_steps", "layers", "standardised")
# Observations that statistics count for which no later ones shall change.
_FOR_EVER = 1e18
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
    former, new = file.card().interface, Interface.of(setup)
    for key in _SAME:
        _check_same(file, key, getattr(former, key), getattr(new, key))
    for key in ("speed", "frames"):
        _check_same(file, key, getattr(former, key), min(getattr(former, key), getattr(new, key)))
    file.load()  # refused now, and not after the streets are built


def _check_same(file: PolicyFile, key: str, former: object, new: object) -> None:
    if former != new:
        raise UsageError(
            f"'{file.path}' was trained with {key} {former}, and the setup has {new}",
            name=key,
            suggestion="the same in the setup, or a training from nothing, without start",
        )


def normalised(setup: Setup, streets: VecEnv) -> VecNormalize:
    """Return streets with observations and rewards normalised as a setup says, while they learn."""
    learning = setup.learning
    normal = VecNormalize(
        streets, norm_reward=learning.norm_reward, clip_obs=CLIP, gamma=setup.discount
    )
    if not learning.norm_obs:
        seen = cast(RunningMeanStd, normal.obs_rms)
        seen.var[:], seen.count = learning.observation_scale**-2, _FOR_EVER
    return normal


def new_model(
    setup: Setup, streets: VecNormalize, progress: Progress = lambda steps, stage: None
) -> PPO:
    """Return a model for a setup's training; it gives the streets its seed.

    Args:
        setup: gives hyperparameters and what the policy starts from.
        streets: that it will learn on; some steps are driven there, if the policy starts from
            another.
        progress: called with 0 and what is being done, while they are driven.

    Raises:
        UsageError: the policy to start from can't be used.
    """
    model, start = untrained_model(setup, streets), start_of(setup)
    if start is not None:
        load_policy(model, streets, start, setup.frames)
        _learn_value(model, setup, streets, progress)
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
        suggestion="a smaller learning_rate, and another --output; checkpoints "
        "from before and the best policy are kept",
    )


def is_finite(model: PPO) -> bool:
    """Tell whether all weights of a model are finite."""
    return all(bool(tensor.isfinite().all()) for tensor in model.policy.state_dict().values())


def untrained_model(setup: Setup, streets: VecEnv) -> PPO:
    """Return a model with a setup's hyperparameters that has seen nothing."""
    learning = setup.learning
    layers = list(learning.layers)
    return FinitePPO(
        "MlpPolicy",
        streets,
        seed=setup.seed,
        device=DEVICE,
        policy_kwargs={
            "net_arch": {"pi": layers, "vf": layers},
            "log_std_init": learning.log_std_init,
        },
        learning_rate=LinearSchedule(
            learning.learning_rate, learning.last_learning_rate, end_fraction=1.0
        ),
        gamma=setup.discount,
        n_steps=learning.rollout_steps // setup.streets,
        **learning.model_dump(exclude=_OWN),
    )


def _learn_value(model: PPO, setup: Setup, streets: VecNormalize, progress: Progress) -> None:
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


# -- policies as networks of their own -------------------------------------------------------------


def policy_of(model: PPO, interface: Interface) -> nn.Sequential:
    """Return the network that chooses a model's most likely actions, from observations as they are.

    Args:
        model: with the normalised streets that it learns on.
        interface: of the policy.
    """
    actor = actor_of(model)
    network = policy_network(cast(nn.Linear, actor[0]).in_features, interface)
    state = {name: tensor.detach().cpu().clone() for name, tensor in actor.state_dict().items()}
    streets = cast(VecNormalize, model.get_vec_normalize_env())
    seen = cast(RunningMeanStd, streets.obs_rms)
    deviation = np.sqrt(seen.var + streets.epsilon)
    state["standardised.mean"] = torch.from_numpy(seen.mean.astype(np.float32))
    state["standardised.deviation"] = torch.from_numpy(deviation.astype(np.float32))
    network.load_state_dict(state)
    return network


def actor_of(model: PPO) -> nn.Sequential:
    """Return what chooses the most likely actions, from normalised observations."""
    return nn.Sequential(*model.policy.mlp_extractor.policy_net, model.policy.action_net)


def load_policy(model: PPO, streets: VecNormalize, file: PolicyFile, frames: int) -> None:
    """Let a model choose the actions that a written policy does, by what that had seen.

    What the model is given and the policy is not, ego's speed or earlier frames, has no weight in
    the beginning.

    Args:
        model: whose layers are as wide as the policy's.
        streets: that it learns on, whose observations have all that the policy is given.
        file: of the policy.
        frames: how many the model is given.

    Raises:
        UsageError: the file can't be read, or holds something else.
    """
    card, state, actor = file.card(), file.network().state_dict(), actor_of(model)
    (inputs,) = cast(spaces.Box, streets.observation_space).shape
    wider = partial(_widened, frames=card.interface.frames, inputs=inputs, new_frames=frames)
    seen = cast(RunningMeanStd, streets.obs_rms)
    seen.mean = wider(state.pop("standardised.mean")[None])[0].double().numpy()
    deviation = wider(state.pop("standardised.deviation")[None], fill=1.0)[0].double().numpy()
    # The policy's weights are right for these numbers, so they stay.
    seen.var, seen.count = deviation**2 - streets.epsilon, _FOR_EVER
    actor.load_state_dict({**state, "0.weight": wider(state["0.weight"])})


def _widened(rows: Tensor, frames: int, inputs: int, new_frames: int, fill: float = 0.0) -> Tensor:
    """Return rows with a number for each of more frames, and of more numbers at their ends.

    Args:
        rows: float (H, N), for that many frames, the last one last.
        frames: divides N.
        inputs: of what is returned, float (H, inputs).
        new_frames: divides them.
        fill: what stands where there was nothing.
    """
    old = rows.unflatten(1, (frames, -1))
    new = rows.new_full((len(rows), new_frames, inputs // new_frames), fill)
    new[:, new_frames - frames :, : old.shape[2]] = old
    return new.flatten(1)
