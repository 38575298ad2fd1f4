"""FetchReach of Gymnasium-Robotics, rewarded by rules/fetch.yaml, and learnt by SAC and hindsight.

Every reward that the replay buffer hands out is the rules', also for goals that it has replaced.
Run it: python examples/fetch.py [--steps STEPS] [--folder FOLDER]
"""

import gymnasium
import gymnasium_robotics
from _curves import learn
from stable_baselines3 import SAC, HerReplayBuffer

import sfol
from sfol.wrappers import RuleReward

gymnasium.register_envs(gymnasium_robotics)
env = RuleReward(gymnasium.make("FetchReach-v4"), sfol.RewardFunction("fetch"))
model = SAC(
    "MultiInputPolicy", env, replay_buffer_class=HerReplayBuffer, learning_starts=200,
    batch_size=256, gamma=0.95, tau=0.05, ent_coef=0.02, learning_rate=1e-3,
    policy_kwargs={"net_arch": [64, 64]}, seed=0, device="cpu",
)  # fmt: skip
learn(model, "fetch", steps=400)
