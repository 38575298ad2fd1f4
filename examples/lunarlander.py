"""LunarLander of Gymnasium, rewarded by rules/lunarlander.yaml, and learnt by PPO.

Run it: python examples/lunarlander.py [--steps STEPS] [--folder FOLDER]
"""

import gymnasium
from _curves import learn
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

import sfol
from sfol.wrappers import RuleReward

reward = sfol.RewardFunction("lunarlander")
envs = make_vec_env(lambda: RuleReward(gymnasium.make("LunarLander-v3"), reward), 8, seed=0)
model = PPO(
    "MlpPolicy", envs, n_steps=256, batch_size=64, n_epochs=4, gamma=0.999, gae_lambda=0.98,
    ent_coef=0.01, seed=0, device="cpu",
)  # fmt: skip
learn(model, "lunarlander", steps=4_096)
