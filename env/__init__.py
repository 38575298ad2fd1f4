"""The bundled street: an occluded pedestrian crossing as a Gymnasium environment.

Example:
    >>> import gymnasium
    >>> street = gymnasium.make("env:OccludedCrossing-v0", traffic="high", occlusion="full")
"""

from contextlib import suppress

with suppress(ModuleNotFoundError):  # without Gymnasium nobody can ask for an environment by its id
    from gymnasium.envs.registration import register

    register(id="OccludedCrossing-v0", entry_point="env.crossing:OccludedCrossing")
