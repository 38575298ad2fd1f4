"""Drive a short episode of every id and print a digest of everything that came of it."""

import hashlib

import gymnasium
import numpy as np

from env import IDS


def digest(street, seed, steps=8):
    """Return a digest of observations, class maps, rewards and infos."""
    actions = np.random.default_rng(7).uniform(-0.3, 1.0, (steps, 1)).astype(np.float32)
    observation, info = street.reset(seed=seed)
    total = hashlib.sha256(observation.tobytes() + repr(info).encode())
    for action in actions:
        observation, reward, terminated, truncated, info = street.step(action)
        for part in (observation.tobytes(), street.frame.classes.tobytes()):
            total.update(part)
        total.update(repr((reward, terminated, truncated, info, str(street.scene.facts))).encode())
    return total.hexdigest()


if __name__ == "__main__":
    for name in IDS:
        with gymnasium.make(f"env:{name}") as made:
            print(name, digest(made.unwrapped, seed=3))
