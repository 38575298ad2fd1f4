"""The bundled street: an occluded pedestrian crossing as Gymnasium environments.

Example:
    >>> import gymnasium
    >>> street = gymnasium.make("env:OccludedCrossing-High-Full-v0")
    >>> same = gymnasium.make("env:OccludedCrossing-v0", traffic="high", occlusion="full")
"""

from contextlib import suppress
from typing import Any

from env.world import cells

# The cells' ids, with the arguments that make a street one of them.
CELLS: dict[str, dict[str, Any]] = {cell.id: cell._asdict() for cell in cells.CELLS}
IDS = ("OccludedCrossing-v0", *CELLS)

with suppress(ModuleNotFoundError):  # without Gymnasium nobody can ask for an environment by its id
    from gymnasium.envs.registration import register

    for name in IDS:
        register(
            id=name,
            entry_point="env.street.crossing:OccludedCrossing",
            kwargs=CELLS.get(name, {}),
        )
