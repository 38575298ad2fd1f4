"""DoorKey of MiniGrid, rewarded by rules/doorkey.yaml, and learnt by PPO.

Run it: python examples/doorkey.py [--steps STEPS] [--folder FOLDER]
"""

import gymnasium
import minigrid
from _curves import learn
from gymnasium.wrappers import ReshapeObservation
from minigrid.wrappers import FullyObsWrapper, ImgObsWrapper
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

import sfol
from sfol.wrappers import RuleReward

gymnasium.register_envs(minigrid)
reward = sfol.RewardFunction("doorkey")


def make() -> RuleReward:
    grid = ImgObsWrapper(FullyObsWrapper(gymnasium.make("MiniGrid-DoorKey-5x5-v0")))
    return RuleReward(ReshapeObservation(grid, (25, 3)), reward)


model = PPO(
    "MlpPolicy", make_vec_env(make, 8, seed=0), n_steps=256, batch_size=256, n_epochs=4,
    ent_coef=0.01, seed=0, device="cpu",
)  # fmt: skip
learn(model, "doorkey", steps=4_096)
