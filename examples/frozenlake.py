"""FrozenLake of Gymnasium, rewarded by rules/frozenlake.yaml: its goal is where an episode ends.

Q-learning in a table. Run it: python examples/frozenlake.py [--steps STEPS] [--folder FOLDER]
"""

import gymnasium
import numpy as np
from _curves import Episode, options, show

import sfol
from sfol.wrappers import EPISODE, RuleReward

chosen = options(4_000)
env = RuleReward(
    gymnasium.make("FrozenLake-v1", is_slippery=False), sfol.RewardFunction("frozenlake")
)
values, chance = np.zeros((16, 4)), np.random.default_rng(0)
state, _ = env.reset(seed=0)
episodes = []
for step in range(chosen.steps):
    explores = chance.random() < 0.5 * (1 - step / chosen.steps)
    action = int(chance.integers(4) if explores else values[state].argmax())
    following, reward, terminated, truncated, info = env.step(action)
    target = reward + 0.95 * (not terminated) * values[following].max()
    values[state, action] += 0.3 * (target - values[state, action])
    state = following
    if terminated or truncated:
        sums = info[EPISODE]
        episodes.append(Episode(step, sums["return"], sums["original_return"]))
        state, _ = env.reset()
show("frozenlake", episodes, chosen.folder)
