"""simple_spread of PettingZoo's MPE, rewarded by rules/spread.yaml: each agent by what it sees.

One linear policy for all three agents, found by the cross-entropy method.
Run it: python examples/spread.py [--steps STEPS] [--folder FOLDER]
"""

import numpy as np
from _curves import Episode, options, show
from mpe2 import simple_spread_v3

import sfol
from sfol.wrappers import EPISODE
from sfol.wrappers.pettingzoo import ParallelRuleReward

POPULATION, ELITE = 40, 8

chosen = options(3_000)
env = ParallelRuleReward(simple_spread_v3.parallel_env(), sfol.RewardFunction("spread"))
chance = np.random.default_rng(0)
mean, spread = np.zeros((5, 18)), np.full((5, 18), 1.0)
steps, episodes = 0, []
while steps < chosen.steps:
    policies = mean + spread * chance.normal(size=(POPULATION, 5, 18))
    seeds = chance.integers(1 << 30, size=4)
    returns = np.zeros(POPULATION)
    for number, policy in enumerate(policies):
        for seed in seeds.tolist():
            observations, _ = env.reset(seed=seed)
            while env.agents:
                actions = {a: int((policy @ seen).argmax()) for a, seen in observations.items()}
                observations, _, _, _, infos = env.step(actions)
                steps += 1
            sums = [info[EPISODE] for info in infos.values()]
            by_rules, own = (np.mean([s[k] for s in sums]) for k in ("return", "original_return"))
            episodes.append(Episode(steps, by_rules, own))
            returns[number] += by_rules
    best = policies[returns.argsort()[-ELITE:]]
    mean, spread = best.mean(axis=0), best.std(axis=0) + 0.05
show("spread", episodes, chosen.folder)
