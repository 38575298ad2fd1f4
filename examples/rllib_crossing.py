"""The occluded crossing, learnt by RLlib's PPO: the rules of rules/crossing.yaml are the reward.

RLlib makes the street in processes of its own; it needs no wrapper, since a street's reward is its
knowledge base's. It needs a checkout, for the street, and RLlib: pip install "ray[rllib]".

Run it: python examples/rllib_crossing.py [--updates N] [--runners N] [--rules FILE]
"""

import argparse

import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.tune.registry import register_env

from env.street.crossing import OccludedCrossing

parser = argparse.ArgumentParser()
parser.add_argument("--updates", type=int, default=1, help="1 shows that everything runs")
parser.add_argument("--runners", type=int, default=1, help="processes that drive")
parser.add_argument("--rules", default="crossing", help="a file, or a bundled name")
options = parser.parse_args()


def make(config: dict) -> OccludedCrossing:
    return OccludedCrossing(perception="truth", observation="state", **config)


register_env("OccludedCrossing", make)
ray.init(num_cpus=options.runners + 1, include_dashboard=False, _node_ip_address="127.0.0.1")
learner = (
    PPOConfig()
    .environment("OccludedCrossing", env_config={"traffic": "low", "rules": options.rules})
    .env_runners(num_env_runners=options.runners)
    .training(gamma=0.997, train_batch_size=4_000, minibatch_size=256, num_epochs=8)
    .debugging(seed=0, log_level="ERROR")
).build_algo()
for update in range(1, options.updates + 1):
    driven = learner.train()["env_runners"]
    steps, episodes = driven["num_env_steps_sampled_lifetime"], driven["num_episodes"]
    print(f"update {update}: {steps:.0f} steps, {episodes:.0f} episodes, "
          f"mean return by the rules {driven['episode_return_mean']:.1f}")  # fmt: skip
learner.stop()
ray.shutdown()
