"""highway-fast of highway-env, rewarded by rules/highway.yaml, and learnt by DQN.

Run it: python examples/highway.py [--steps STEPS] [--folder FOLDER]
"""

import gymnasium
import highway_env
from _curves import learn
from stable_baselines3 import DQN

import sfol
from sfol.wrappers import RuleReward

gymnasium.register_envs(highway_env)
env = gymnasium.make("highway-fast-v0", config={"vehicles_count": 10})
model = DQN(
    "MlpPolicy", RuleReward(env, sfol.RewardFunction("highway")), learning_starts=200,
    batch_size=32, gamma=0.8, learning_rate=5e-4, train_freq=1, gradient_steps=1,
    target_update_interval=50, policy_kwargs={"net_arch": [256, 256]}, exploration_fraction=0.5,
    seed=0, device="cpu",
)  # fmt: skip
learn(model, "highway", steps=100)
