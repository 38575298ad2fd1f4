"""Gymnasium's CartPole, rewarded by rules: the reward is rules/cartpole.yaml.

A scripted controller balances the pole for one episode; the table shows what that was worth.
Run it: python examples/cartpole.py
"""

import gymnasium

import sfol
from sfol.wrappers import RuleReward

reward = sfol.RewardFunction("cartpole")
TRACK, FALLEN = 2.4, 0.2095  # m, rad: where CartPole-v1 ends an episode


def facts_of(observation, info, env):
    """What the four numbers of CartPole mean."""
    position, speed, angle, _ = map(float, observation)
    facts = reward.facts()
    facts.add("Upright", "pole", confidence=max(1.0 - abs(angle) / FALLEN, 0.0))
    facts.add("AtEnd", "cart", confidence=min(abs(position) / TRACK, 1.0))
    if position * speed > 0:
        facts.add("Outward", "cart")
    return facts


env = RuleReward(
    gymnasium.make("CartPole-v1"),
    reward,
    facts=facts_of,
    signals=lambda transition: {"speed": float(transition.observation[1])},
)
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
