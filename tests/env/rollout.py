"""Drive a short episode and print a digest of everything that came of it."""

import hashlib

import numpy as np

from env.crossing import OccludedCrossing


def digest(street, seed, steps=25):
    actions = np.random.default_rng(7).uniform(-0.3, 1.0, (steps, 1)).astype(np.float32)
    frame, info = street.reset(seed=seed)
    total = hashlib.sha256(frame.tobytes() + repr(info).encode())
    for action in actions:
        frame, reward, terminated, truncated, info = street.step(action)
        for part in (frame.tobytes(), street.frame.classes.tobytes()):
            total.update(part)
        total.update(repr((reward, terminated, truncated, info)).encode())
    return total.hexdigest()


if __name__ == "__main__":
    print(digest(OccludedCrossing(traffic="medium", occlusion="full"), seed=3))
