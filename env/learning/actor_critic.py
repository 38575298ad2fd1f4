"""The networks that PPO learns: a policy, and what judges it in training."""

from __future__ import annotations

from typing import Any, cast

from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import create_mlp
from torch import Tensor, nn

from env.learning.whitening import Whitening


class ActorCritic(ActorCriticPolicy):
    """The ``MlpPolicy`` of PPO with a critic that may see more than the actor does.

    One picture shows no speeds, and what a drive is worth depends on them. The value function is
    needed in training alone, so it may be given the state of the world.

    Args:
        args: those of ``ActorCriticPolicy``, as are the other keywords.
        frames: how many observations are stacked.
        state_size: how many numbers at the end of each are the state of the world; the policy does
            not see them, and the value function sees nothing but the last frame's. 0: both see
            everything.
        whitened: whether what the policy sees is whitened first, by what `Networks.whitening` has
            been measured with.

    Source: Pinto et al., "Asymmetric Actor Critic for Image-Based Robot Learning", 2018.
    """

    def __init__(
        self,
        *args: Any,
        frames: int = 1,
        state_size: int = 0,
        whitened: bool = False,
        **keywords: Any,
    ) -> None:
        self._options: dict[str, Any] = {
            "frames": frames,
            "state_size": state_size,
            "whitened": whitened,
        }
        super().__init__(*args, **keywords)

    def _build_mlp_extractor(self) -> None:
        widths = cast(dict[str, list[int]], self.net_arch)
        self.mlp_extractor = cast(Any, Networks(self.features_dim, widths, **self._options))


class Networks(nn.Module):
    """Hidden layers of policy and value function, under the names that stable-baselines3 expects.

    Args:
        inputs: float (B, inputs) is what they are given.
        widths: of the layers, ``pi`` and ``vf``.
        frames: see `ActorCritic`, as for those that follow.
        state_size: see there.
        whitened: see there.

    Attributes:
        whitening: what is done to the policy's observations first; None if nothing is.
    """

    def __init__(
        self,
        inputs: int,
        widths: dict[str, list[int]],
        frames: int,
        state_size: int,
        whitened: bool,
    ) -> None:
        super().__init__()
        self._frames, self._state_size = frames, state_size
        seen = inputs - frames * state_size
        self.whitening = Whitening(seen) if whitened else None
        self.policy_net = nn.Sequential(*create_mlp(seen, -1, widths["pi"], nn.Tanh))
        self.value_net = nn.Sequential(*create_mlp(state_size or inputs, -1, widths["vf"], nn.Tanh))
        self.latent_dim_pi, self.latent_dim_vf = widths["pi"][-1], widths["vf"][-1]

    def forward(self, observations: Tensor) -> tuple[Tensor, Tensor]:
        """Return what `forward_actor` and `forward_critic` do."""
        return self.forward_actor(observations), self.forward_critic(observations)

    def forward_actor(self, observations: Tensor) -> Tensor:
        """Return the last hidden layer of the policy, float (B, width)."""
        return cast(Tensor, self.policy_net(self._whitened(self.of_actor(observations))))

    def forward_critic(self, observations: Tensor) -> Tensor:
        """Return the last hidden layer of the value function, float (B, width)."""
        if self._state_size:
            return cast(Tensor, self.value_net(observations[:, -self._state_size :]))
        return cast(Tensor, self.value_net(self._whitened(observations)))

    def of_actor(self, observations: Tensor) -> Tensor:
        """Return what the policy sees of observations, as it is, float (B, N)."""
        if not self._state_size:
            return observations
        frames = observations.unflatten(1, (self._frames, -1))
        return frames[..., : -self._state_size].flatten(1)

    def _whitened(self, observations: Tensor) -> Tensor:
        return observations if self.whitening is None else self.whitening(observations)
