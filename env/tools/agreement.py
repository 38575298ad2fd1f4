"""Do the two perceptions say the same? Truth against the simulator, frame by frame.

`aeb agreement` drives episodes of every cell with the simulator's perception, asks
the truth about each frame, and prints for every predicate how often the two agree that it holds of
any entity. `--frames FOLDER` keeps pictures of frames in which they do not.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import track
from rich.table import Table

from env import CELLS
from env.driving.drivers import Cautious, Driver, FullThrottle
from env.driving.rollout import rollout
from env.perception.pipeline import Scene
from env.street.crossing import OccludedCrossing
from env.street.view import StreetView
from env.world.actors import Ego, EgoParameters
from sfol.cli.output import escaped
from sfol.writing import check_writable, replacing
from vsr.segmentation import Frame

MARGIN = 10.0  # m, by which the camera's useful range exceeds the stopping distance
# Where one perception misses thin shins, its distance is three rows of pixels off. So a claim about
# an entity within reach counts as shared if the other makes it of one within reach and this, in m.
SLACK = 5.0

_ZOOM = 4  # of saved frames

Claim = tuple[str, ...]  # a predicate alone, or with the classes of which it holds


def stopping_distance(car: EgoParameters) -> float:
    """Return the way to a stand from top speed, from full throttle to full braking, in m."""
    ego = Ego(car, speed=car.top_speed, force=car.drive)
    while ego.speed > 0.0:
        ego = ego.after(-1.0, 0.01)
    return ego.position


# As far before the bumper as the camera's picture has to be right, in m.
USEFUL_RANGE = stopping_distance(EgoParameters()) + MARGIN


@dataclass(frozen=True)
class Agreement:
    """In how many frames two perceptions make one claim.

    Attributes:
        truth: in which the truth does, of entities within reach …
        confirmed: … and the simulator too, of entities hardly farther.
        simulator: in which the simulator does, of entities within reach …
        found: … and the truth too, of entities hardly farther.
    """

    truth: int = 0
    confirmed: int = 0
    simulator: int = 0
    found: int = 0

    @property
    def precision(self) -> float:
        """Share of the truth's claims that the simulator makes too; nan when there are none."""
        return _share(self.confirmed, self.truth)

    @property
    def recall(self) -> float:
        """Share of the simulator's claims that the truth makes too; nan when there are none."""
        return _share(self.found, self.simulator)


@dataclass(frozen=True, eq=False)
class Sight:
    """One frame and what both perceptions claim of it.

    Attributes:
        name: which episode and step.
        gray: uint8 (H, W), the frame.
        scenes: what the simulator's perception made of it, and what the truth did.
        simulator: what the simulator's perception claims within reach, and hardly farther.
        truth: what the truth claims, likewise.
    """

    name: str
    gray: npt.NDArray[np.uint8]
    scenes: tuple[Scene, Scene]
    simulator: tuple[frozenset[Claim], frozenset[Claim]]
    truth: tuple[frozenset[Claim], frozenset[Claim]]

    def differences(self) -> Iterator[tuple[str, Claim]]:
        """Yield who makes a claim alone, and which."""
        yield from (("simulator", claim) for claim in sorted(self.simulator[0] - self.truth[1]))
        yield from (("truth", claim) for claim in sorted(self.truth[0] - self.simulator[1]))


def sights(
    episodes: int, reach: float = USEFUL_RANGE, *, first_seed: int = 0, every: int = 1
) -> Iterator[Sight]:
    """Drive episodes through all cells, in turn with a cautious and a reckless driver.

    Args:
        episodes: how many.
        reach: up to which distance from the bumper entities count, in m.
        first_seed: of the first episode; the others count on from it.
        every: how many steps there are from one frame that is compared to the next.

    Yields:
        The frames, and what simulator and truth claim of them.
    """
    streets = [
        OccludedCrossing(**cell, perception="truth", observation="state") for cell in CELLS.values()
    ]
    drivers: tuple[Driver, ...] = (Cautious(), FullThrottle())
    try:
        for number in range(episodes):
            driver = drivers[number // len(CELLS) % len(drivers)]
            street = streets[number % len(CELLS)]
            steps = rollout(street, driver, first_seed + number, frames_every=every)
            for index, step in enumerate(steps):
                if step.frame is not None:
                    name = f"{street.traffic}-{street.occlusion}-{first_seed + number}-{index}"
                    yield _sight(street, step.frame, step.scene, name, reach)
    finally:
        for street in streets:
            street.close()


def _sight(street: StreetView, frame: Frame, truth: Scene, name: str, reach: float) -> Sight:
    (shown,) = street.pipeline.perceive([frame])
    claimed = (
        (claims(scene, street, reach), claims(scene, street, reach + SLACK))
        for scene in (shown, truth)
    )
    return Sight(name, frame.gray, (shown, truth), *claimed)


def claims(scene: Scene, street: StreetView, reach: float) -> frozenset[Claim]:
    """Return what a scene claims of any entity of a class, those within reach.

    An entity's distance is that of its lowest visible row, for whichever perception.

    Args:
        scene: of either perception.
        street: has the camera.
        reach: in m from the bumper.
    """
    kinds = {
        entity.name: entity.kind.name.lower()
        for entity in scene.entities
        if street.lens.pinhole.distance(entity.bottom) - street.lens.setback <= reach
    }
    kinds[street.pipeline.kb.subject] = "ego"
    near = [atom for atom in scene.facts if all(name in kinds for name in atom.arguments)]
    detailed = {(atom.predicate, *(kinds[name] for name in atom.arguments)) for atom in near}
    return frozenset(detailed | {claim[:1] for claim in detailed})


def compare(frames: Iterable[Sight]) -> dict[Claim, Agreement]:
    """Count for every claim how often both perceptions make it, or only one of them."""
    counts: dict[Claim, Counter[str]] = defaultdict(Counter)
    for frame in frames:
        for claim in frame.truth[0]:
            counts[claim].update(truth=1, confirmed=int(claim in frame.simulator[1]))
        for claim in frame.simulator[0]:
            counts[claim].update(simulator=1, found=int(claim in frame.truth[1]))
    return {claim: Agreement(**counts[claim]) for claim in sorted(counts)}


def print_agreement(
    *, episodes: int, reach: float, seed: int, every: int, frames: Path | None
) -> None:
    """Print how often truth and simulator agree on each predicate.

    Args:
        episodes: how many are driven, through all cells in turn.
        reach: up to which distance entities count, in m.
        seed: of the first episode.
        every: of how many steps one is compared.
        frames: folder for a frame of each kind of difference; None for none.
    """
    if frames is not None:
        check_writable(frames / "any.png")
    console = Console(highlight=False)
    driven = sights(episodes, reach, first_seed=seed, every=every)
    all_sights = list(track(driven, "driving …", console=console, total=None))
    console.print(_table(compare(all_sights), len(all_sights)))
    way = stopping_distance(EgoParameters())
    console.print(
        f"Entities up to {reach:.1f} m before the bumper; the way to a stand is {way:.1f} m."
    )
    if frames is not None:
        for path in _save_differences(all_sights, frames):
            console.print(escaped(path), soft_wrap=True)


def _table(found: Mapping[Claim, Agreement], frames: int) -> Table:
    table = Table(title=f"{frames} frames", box=SIMPLE_HEAD, title_justify="left")
    table.add_column("predicate", no_wrap=True)
    for name in ("truth", "confirmed", "precision", "simulator", "found", "recall"):
        table.add_column(name, justify="right")
    for (predicate, *kinds), agreement in found.items():
        table.add_row(
            f"  of {', '.join(kinds)}" if kinds else predicate,
            str(agreement.truth),
            str(agreement.confirmed),
            f"{agreement.precision:.3f}",
            str(agreement.simulator),
            str(agreement.found),
            f"{agreement.recall:.3f}",
        )
    return table


def _save_differences(frames: Sequence[Sight], folder: Path) -> Iterator[Path]:
    """Save the first frame of every kind of difference; the file's name says which it is."""
    known: set[tuple[str, Claim]] = set()
    for frame in frames:
        for who, claim in frame.differences():
            if (who, claim) not in known:
                known.add((who, claim))
                path = folder / f"{'-'.join(claim)}-{who}-only-{frame.name}.png"
                with replacing(path) as part:
                    _picture(frame).save(part, format="png")
                yield path


def _picture(frame: Sight) -> Image.Image:
    """Return the frame with the simulator's entities in red and the truth's in cyan."""
    height, width = frame.gray.shape
    size = (_ZOOM * width, _ZOOM * height)
    picture = Image.fromarray(frame.gray).convert("RGB").resize(size, Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(picture)
    for scene, colour in zip(frame.scenes, ("red", "cyan"), strict=True):
        for entity in scene.entities:
            top, left, bottom, right = (_ZOOM * edge for edge in entity.box)
            draw.rectangle((left, top, right, bottom), outline=colour)
    return picture


def _share(part: int, whole: int) -> float:
    return part / whole if whole else math.nan
