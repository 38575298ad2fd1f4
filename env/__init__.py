"""The bundled street: an occluded pedestrian crossing as Gymnasium environments.

Example:
    >>> import gymnasium
    >>> street = gymnasium.make("env:OccludedCrossing-High-Full-v0")
    >>> same = gymnasium.make("env:OccludedCrossing-v0", traffic="high", occlusion="full")
"""

from contextlib import suppress
from itertools import product
from typing import TypedDict


class Cell(TypedDict):
    """Arguments of a street that make it one of the study's cells."""

    traffic: str
    occlusion: str


CELLS: dict[str, Cell] = {
    f"OccludedCrossing-{traffic.capitalize()}-{occlusion.capitalize()}-v0": {
        "traffic": traffic,
        "occlusion": occlusion,
    }
    for traffic, occlusion in product(("low", "medium", "high"), ("partial", "full"))
}
IDS = ("OccludedCrossing-v0", *CELLS)

with suppress(ModuleNotFoundError):  # without Gymnasium nobody can ask for an environment by its id
    from gymnasium.envs.registration import register

    for name in IDS:
        register(
            id=name,
            entry_point="env.crossing:OccludedCrossing",
            kwargs=dict(CELLS[name]) if name in CELLS else {},
        )
