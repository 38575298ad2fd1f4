"""CartPole of Gymnasium, rewarded by rules; rules/cartpole.yaml says how facts are read, too.

A scripted controller balances the pole for one episode; the table shows what that was worth.
Run it: python examples/cartpole.py
"""

import gymnasium

import sfol
from sfol.wrappers import RuleReward

reward = sfol.RewardFunction("cartpole")
env = RuleReward(gymnasium.make("CartPole-v1"), reward)
observation, _ = env.reset(seed=1)
total, done, step = 0.0, False, 0
while not done:
    action = int(observation[2] + 0.3 * observation[3] > 0)  # push to where the pole falls
    observation, value, terminated, truncated, info = env.step(action)
    total, done, step = total + float(value), terminated or truncated, step + 1
    if step % 50 == 0:
        terms = {name: round(info[f"reward_{name}"], 3) for name in reward.kb.terms}
        print(f"step {step:3}  position {observation[0]:+.2f} m  reward {value:+.3f}  {terms}")
print(f"{step} steps, return {total:.1f}")
env.close()
