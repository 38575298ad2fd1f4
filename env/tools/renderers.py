"""The street's renderer against pybullet's TinyRenderer: the same moments, drawn by both.

`aeb renderers` does it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np
import numpy.typing as npt
from PIL import Image
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from env.driving.drivers import Cautious
from env.driving.rollout import rollout
from env.perception.networks import weights_file
from env.street.crossing import OccludedCrossing
from env.street.seeds import FRAMES
from env.tools.frames import FRAMES_PER_STREET, frame_set
from env.world.camera import RENDERERS, DashCamera, Renderer
from env.world.cells import Traffic
from sfol import KnowledgeBase
from sfol.errors import UsageError
from sfol.writing import check_writable, replacing
from vsr.classes import SemanticClass
from vsr.grounding import SegmentationGrounding
from vsr.networks.autoencoder import FeatureEncoder, load_autoencoder
from vsr.networks.unet import UNetSegmenter
from vsr.training import feature_quality, segmentation_quality
from vsr.training.frames import FrameSet

_MOMENT = 25.0  # x of ego's front at which frames are timed, in m
_SAMPLES = 40  # frames of each renderer that are timed
_PICTURED = 4  # moments on the picture
_AMPLIFIED = 8  # by how much differences of grey values are, on the picture


class Likeness(NamedTuple):
    """How alike two renderers draw the pixels of a class.

    Attributes:
        share: of all of TinyRenderer's pixels that are of the class.
        same: share of those that have the class in the other's frames too.
        iou: pixels that both give the class, as a share of those that either does.
        equal: share of those of the same class that have the same grey value.
        close: share of those whose grey values differ by 1 at most.
        difference: mean of the grey values' differences, without sign.
    """

    share: float
    same: float
    iou: float
    equal: float
    close: float
    difference: float


def likeness(street: FrameSet, tiny: FrameSet) -> dict[str, Likeness]:
    """Compare two renderers' frames of the same moments, class by class and all together.

    Args:
        street: frames by the street's renderer.
        tiny: those by TinyRenderer.
    """
    same = street.classes == tiny.classes
    gaps = np.abs(street.gray.astype(np.int16) - tiny.gray)
    rows = {}
    for number in np.unique(tiny.classes).tolist():
        here, there = street.classes == number, tiny.classes == number
        both = here & there
        rows[SemanticClass(number).name.lower()] = Likeness(
            there.mean(),
            both.sum() / there.sum(),
            both.sum() / (here | there).sum(),
            *_gray_likeness(gaps[both]),
        )
    agreed = float(same.mean())
    rows["all"] = Likeness(1.0, agreed, agreed / (2.0 - agreed), *_gray_likeness(gaps))
    return rows


def _gray_likeness(gaps: npt.NDArray[np.int16]) -> tuple[float, float, float]:
    return float((gaps == 0).mean()), float((gaps <= 1).mean()), float(gaps.mean())


def milliseconds(traffic: Traffic) -> dict[Renderer, float]:
    """Return the median time of a frame before the crosswalk, in ms; the renderers take turns.

    Args:
        traffic: of the street.
    """
    with OccludedCrossing(traffic=traffic, occlusion="full", perception="none") as street:
        steps = rollout(street, Cautious(), seed=0)
        next(step for step in steps if step.info["position"] >= _MOMENT)
        cameras: dict[Renderer, DashCamera] = {
            name: DashCamera(street.world, street.lens, name) for name in get_args(Renderer)
        }
        times: dict[Renderer, list[float]] = {name: [] for name in cameras}
        people = street.people
        for _ in range(_SAMPLES + 1):
            for name, camera in cameras.items():
                started = time.perf_counter()
                street.world.place_people(
                    people.positions, people.headings, people.phases, people.speeds
                )
                camera.capture(street.ego.position)
                times[name].append(time.perf_counter() - started)
    # The first frame of each builds what the others use.
    return {name: 1e3 * float(np.median(some[1:])) for name, some in times.items()}


def quality(frames: FrameSet) -> dict[str, float]:
    """Return how well the trained networks do on frames.

    Args:
        frames: with their successors.

    Raises:
        UsageError: there are no weights.
    """
    grounding = KnowledgeBase.load("crossing").grounding_of("segmentation", SegmentationGrounding)
    segmenter, autoencoder = (weights_file(name) for name in ("segmenter", "autoencoder"))
    alone = frames.without_successors()
    counts = segmentation_quality.count(UNetSegmenter.load(segmenter), alone, grounding)
    iou = segmentation_quality.iou_table(segmentation_quality.total(counts))
    pairs = ((frames.frame(first), frames.frame(second)) for first, second in frames.pairs())
    found = feature_quality.retrieve(FeatureEncoder.load(autoencoder), pairs, grounding)
    return {
        **{f"IoU, {name}": row["all"] for name, row in iou.items()},
        "PSNR, dB": float(feature_quality.redraw(load_autoencoder(autoencoder), alone).psnr.mean()),
        "retrieval": feature_quality.total(found).rate,
    }


def print_comparison(*, frames: int, picture: Path | None, networks: bool) -> None:
    """Print how alike both renderers draw, how fast, and how well the networks see on either.

    Args:
        frames: moments of held-out streets, rounded up to whole streets.
        picture: file for a few of them side by side, as PNG; None for none.
        networks: whether the trained networks are judged too, which takes a second a moment.

    Raises:
        UsageError: the picture can't be written, or there are not so many frames.
    """
    if picture is not None:
        check_writable(picture)
    seeds = FRAMES["test"][: -(-frames // FRAMES_PER_STREET)]
    if not seeds or FRAMES_PER_STREET * len(seeds) < frames:
        raise UsageError(f"{frames} frames can't be compared", name="frames")
    street, tiny = (frame_set(seeds, pairs=True, renderer=name) for name in ("street", "tiny"))
    console = Console(highlight=False)
    console.print(_likeness_table(likeness(street, tiny), len(street)), _time_table())
    if networks:
        console.print(_quality_table(quality(tiny), quality(street)))
    if picture is not None:
        with replacing(picture) as part:
            side_by_side(street, tiny).save(part, format="png", optimize=True)
        console.print(str(picture), markup=False, soft_wrap=True)


def side_by_side(street: FrameSet, tiny: FrameSet) -> Image.Image:
    """Return moments drawn by TinyRenderer, by the street's renderer, and where they differ.

    Args:
        street: frames by the street's renderer.
        tiny: those by TinyRenderer.
    """
    chosen = np.linspace(0, len(tiny) - 1, _PICTURED).round().astype(int)
    rows = [
        np.hstack([tiny.gray[i], street.gray[i], _difference(street.gray[i], tiny.gray[i])])
        for i in chosen
    ]
    return Image.fromarray(np.vstack(rows))


def _difference(first: npt.NDArray[np.uint8], second: npt.NDArray[np.uint8]) -> Any:
    gaps = np.abs(first.astype(np.int16) - second)
    return (255 - np.minimum(_AMPLIFIED * gaps, 255)).astype(np.uint8)


def _likeness_table(rows: dict[str, Likeness], frames: int) -> Table:
    heads = ["pixels", "same class", "IoU", "same grey", "within 1", "mean gap"]
    table = _table(
        f"{RENDERERS['street']} against {RENDERERS['tiny']}, {frames} frames, shares in %", heads
    )
    for name, row in rows.items():
        shares = [f"{100 * share:.2f}" for share in (row.equal, row.close)]
        table.add_row(
            name,
            f"{100 * row.share:.2f}",
            f"{100 * row.same:.3f}",
            f"{row.iou:.4f}",
            *shares,
            f"{row.difference:.3f}",
        )
    return table


def _time_table() -> Table:
    table = _table("ms for a frame, people placed", [*RENDERERS.values(), "ratio"])
    for traffic in get_args(Traffic):
        times = milliseconds(traffic)
        ratio = times["tiny"] / times["street"]
        table.add_row(traffic, *(f"{times[name]:.2f}" for name in RENDERERS), f"{ratio:.1f}")
    return table


def _quality_table(tiny: dict[str, float], street: dict[str, float]) -> Table:
    table = _table("networks", [RENDERERS["tiny"], RENDERERS["street"], "change"])
    for name, before in tiny.items():
        after = street[name]
        table.add_row(name, f"{before:.4f}", f"{after:.4f}", f"{after - before:+.4f}")
    return table


def _table(title: str, heads: Sequence[str]) -> Table:
    table = Table(title=title, box=SIMPLE_HEAD, title_justify="left")
    table.add_column("", no_wrap=True)
    for head in heads:
        table.add_column(head, justify="right")
    return table
