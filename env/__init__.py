"""The bundled street: an occluded pedestrian crossing as a Gymnasium environment.

Example:
    >>> import gymnasium
    >>> street = gymnasium.make("env:OccludedCrossing-v0", traffic="high", occlusion="full")
"""

from sfol.errors import MissingExtraError

try:
    from gymnasium.envs.registration import register
except ImportError as error:
    raise MissingExtraError(
        "the bundled street needs gymnasium",
        name="gymnasium",
        suggestion="python -m pip install 'sfol[aeb]' on Python 3.11",
    ) from error

register(id="OccludedCrossing-v0", entry_point="env.crossing:OccludedCrossing")
