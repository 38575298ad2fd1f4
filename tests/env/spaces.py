"""An environment for tests of what needs only its spaces."""

import gymnasium
import numpy as np
from gymnasium import spaces

PEDAL = spaces.Box(-1.0, 1.0, (1,), np.float32)


class Spaces(gymnasium.Env):
    """An environment that is nothing but its spaces."""

    def __init__(self, observations, actions=PEDAL):
        self.observation_space, self.action_space = observations, actions

    def reset(self, *, seed=None, options=None):
        return self.observation_space.sample(), {}
