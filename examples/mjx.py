"""Poles on carts, simulated by MuJoCo's MJX in JAX and rewarded by rules/cartpole.yaml in torch.

Arrays go from one library to the other through DLPack, without a copy. The controller is a plain
feedback; what is shown is that rules judge a batch of another library's worlds in one call.

It needs MJX: pip install "mujoco-mjx>=3.4,<3.5"
Run it: python examples/mjx.py [--worlds N] [--steps N]
"""

import argparse
from functools import partial

import jax
import mujoco
import torch
from jax import numpy as jnp
from mujoco import mjx

import sfol

CART = """
<mujoco>
  <option timestep="0.02"/>
  <worldbody>
    <body name="cart">
      <joint name="track" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.2 0.1 0.1" mass="1"/>
      <body name="pole">
        <joint name="hinge" type="hinge" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 1" size="0.02" mass="0.1"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="track" gear="10" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
GAINS = jnp.array([0.05, 0.1, 3.0, 0.5])  # of position, speed, angle and spin

parser = argparse.ArgumentParser()
parser.add_argument("--worlds", type=int, default=256)
parser.add_argument("--steps", type=int, default=100)
options = parser.parse_args()

model = mjx.put_model(mujoco.MjModel.from_xml_string(CART))
reward = sfol.RewardFunction("cartpole")


def begin(key: jax.Array) -> mjx.Data:
    """Return a world whose pole stands nearly upright."""
    data = mjx.make_data(model)
    return data.replace(qpos=jax.random.uniform(key, (2,), minval=-0.1, maxval=0.1))


@jax.jit
@partial(jax.vmap)
def step(world: mjx.Data) -> mjx.Data:
    """Return a world a moment later, with the cart driven under its pole."""
    return mjx.step(model, world.replace(ctrl=observe(world)[None] @ GAINS))


def observe(world: mjx.Data) -> jax.Array:
    """Return position, speed, angle and spin, as rules/cartpole.yaml names them."""
    return jnp.stack([world.qpos, world.qvel], axis=-1).reshape(*world.qpos.shape[:-1], 4)


worlds = jax.vmap(begin)(jax.random.split(jax.random.key(0), options.worlds))
before = torch.from_dlpack(observe(worlds))
for number in range(options.steps):
    worlds = step(worlds)
    after = torch.from_dlpack(observe(worlds))
    outcome = reward.transitions(before, None, after)
    before = after
    if number % 20 == 0:
        terms = {name: round(float(values.mean()), 3) for name, values in outcome.terms.items()}
        print(f"step {number:3}: mean reward {outcome.reward.mean():.3f}, terms {terms}")
