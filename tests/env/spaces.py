"""An environment for tests of what needs only its spaces."""

import gymnasium
import numpy as np
from gymnasium import spaces

PEDAL = spaces.Box(-1.0, 1.0, (1,), np.float32)


class Spaces(gymnasium.Env):
    """An environment that is nothing but its spaces; its episodes have one step."""

    def __init__(self, observations, actions=PEDAL):
        self.observation_space, self.action_space = observations, actions

    def reset(self, *, seed=None, options=None):
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), 0.0, True, False, {}
