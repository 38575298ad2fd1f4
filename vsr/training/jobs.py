"""What the commands of the networks do: trainings, and measures of how good the networks are."""

from __future__ import annotations

import json
import math
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from PIL import Image
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import track
from rich.table import Table

import sfol
from sfol.cli.output import escaped
from sfol.errors import FileError, UsageError
from sfol.writing import replacing
from vsr.grounding import SegmentationGrounding
from vsr.json_files import valid_text
from vsr.networks import autoencoder, unet
from vsr.networks.weights import read_card
from vsr.segmentation import Frame
from vsr.training import feature_quality, segmentation_quality
from vsr.training.autoencoder import AutoencoderTask
from vsr.training.frames import FrameSet, load_frames
from vsr.training.loop import Schedule, Task, Training
from vsr.training.segmenter import SegmenterTask
from vsr.training.shipping import ship, trained_on

T = TypeVar("T")

_PICTURED = 6  # frames in the picture of reconstructions


@dataclass(frozen=True)
class Files:
    """Where a training reads and writes.

    Attributes:
        data: folder with the frames: ``train/`` and ``validation/`` in it.
        output: folder for the weights and their card.
        checkpoints: folder for checkpoints; ``runs/training/<network>`` if None.
        start: a trained segmenter to begin with.
    """

    data: Path
    output: Path
    checkpoints: Path | None = None
    start: Path | None = None


def train_segmenter(files: Files, schedule: Schedule, *, focus: bool = False) -> None:
    """Train the UNet, and write its weights and their card.

    Args:
        files: what is read and written.
        schedule: of the training.
        focus: whether it looks at people most of the time.
    """
    torch.manual_seed(schedule.seed)
    data = _split(files.data)
    network = unet.load_unet(files.start) if files.start else unet.build_unet()
    task = SegmenterTask(network, *data, focus=focus)
    _train(task, schedule, files, _description("segmenter", unet.ARCHITECTURE, data, files.start))


def train_autoencoder(files: Files, schedule: Schedule) -> None:
    """Train the autoencoder, and write its weights and their card.

    Args:
        files: what is read and written.
        schedule: of the training.
    """
    torch.manual_seed(schedule.seed)
    data = _split(files.data)
    network = autoencoder.Autoencoder()
    if files.start:
        network.start_from(unet.load_unet(files.start))
    about = _description("autoencoder", autoencoder.ARCHITECTURE, data, files.start)
    _train(AutoencoderTask(network, *data), schedule, files, about)


def judge_segmenter(data: Path, weights: Path, output: Path, rules: str) -> None:
    """Print IoU by class and distance, and how well the facts agree with the simulator's.

    Args:
        data: folder with the frames of held-out streets.
        weights: folder with the weights.
        output: file for the figures, as JSON.
        rules: knowledge base whose grounding reads the maps.
    """
    file = weights / "segmenter.safetensors"
    frames, grounding = load_frames(data), _grounding(rules)
    _check_held_out(frames, file)
    chosen = frames.without_successors()
    judged = segmentation_quality.count(unet.UNetSegmenter.load(file), chosen, grounding)
    counts = segmentation_quality.total(_tracked(judged, "frames", len(chosen)))
    iou = segmentation_quality.iou_table(counts)
    facts = segmentation_quality.fact_table(counts)
    console = Console(highlight=False)
    console.print(_table("IoU", iou), _table("holds of some entity", facts))
    figures = {"iou": iou, "facts": facts}
    about = {"command": _command(), "frames": {**frames.card, "used": len(chosen)}}
    _write(output, {**about, **figures})


def judge_autoencoder(data: Path, weights: Path, output: Path, picture: Path, rules: str) -> None:
    """Print how well frames are drawn again, and whether features tell entities apart.

    Args:
        data: folder with the frames of held-out streets, rendered with their successors.
        weights: folder with the weights.
        output: file for the figures, as JSON.
        picture: file for the reconstructions.
        rules: knowledge base whose grounding reads the maps.
    """
    file = weights / "autoencoder.safetensors"
    frames, grounding = load_frames(data), _grounding(rules)
    _check_held_out(frames, file)
    pairs = frames.pairs()
    if not len(pairs):
        raise UsageError(
            f"{data} has no frames that follow each other",
            name=str(data),
            suggestion="aeb frames test --pairs",
        )
    figures = {
        "psnr_db": _redrawn(file, frames.without_successors(), picture),
        "retrieval": _retrieval(file, frames, grounding),
    }
    Console(highlight=False).print_json(data=_rounded(figures))
    about = {"command": _command(), "frames": {**frames.card, "pairs": len(pairs)}}
    _write(output, {**about, **figures})


def _redrawn(file: Path, frames: Sequence[Frame], picture: Path) -> dict[str, Any]:
    """Draw frames again, save a few beside their originals, and return PSNR figures."""
    drawn = feature_quality.redraw(autoencoder.load_autoencoder(file), frames)
    shown = np.linspace(0, len(frames) - 1, _PICTURED).round().astype(int).tolist()
    sheet = feature_quality.side_by_side(
        [frames[i].gray for i in shown], [drawn.pictures[i] for i in shown]
    )
    with replacing(picture) as part:
        Image.fromarray(sheet).save(part, format="png", optimize=True)
    return {
        "mean": drawn.psnr.mean(),
        "worst": drawn.psnr.min(),
        "pictured": [float(drawn.psnr[i]) for i in shown],
    }


def _retrieval(file: Path, frames: FrameSet, grounding: SegmentationGrounding) -> dict[str, Any]:
    """Return how often features find their entity again."""
    pairs = frames.pairs().tolist()
    tracked = _tracked(((frames.frame(i), frames.frame(j)) for i, j in pairs), "pairs", len(pairs))
    encoder = autoencoder.FeatureEncoder.load(file)
    retrieval = feature_quality.total(feature_quality.retrieve(encoder, tracked, grounding))
    return {
        "rate": retrieval.rate,
        "chance": retrieval.chance,
        "queries": retrieval.queries,
        "gone": retrieval.gone,
    }


def _tracked(items: Iterable[T], what: str, total: int) -> Iterable[T]:
    return track(items, what, total=total, console=Console(stderr=True))


def _train(task: Task, schedule: Schedule, files: Files, description: dict[str, Any]) -> None:
    console = Console(stderr=True, highlight=False)
    folder = files.checkpoints or Path("runs/training") / description["network"]
    training = Training(task, schedule, folder, console)
    training.run()
    file = ship(training, files.output, description)
    size = file.stat().st_size / 1e6
    console.print(escaped(f"{file}, {size:.1f} MB: {read_card(file).metrics}"))


def _description(
    network: str, architecture: str, data: tuple[FrameSet, FrameSet], start: Path | None
) -> dict[str, Any]:
    return {
        "network": network,
        "architecture": architecture,
        "trained_on": trained_on(*data),
        "started_from": read_card(start).model_dump() if start else None,
        "command": _command(),
    }


def _split(data: Path) -> tuple[FrameSet, FrameSet]:
    return load_frames(data / "train"), load_frames(data / "validation")


def _grounding(rules: str) -> SegmentationGrounding:
    kb = sfol.KnowledgeBase.load(rules)
    return kb.grounding_of("segmentation", SegmentationGrounding)


def _check_held_out(frames: FrameSet, file: Path) -> None:
    """Refuse frames that the network was trained on, or that another renderer drew."""
    card = read_card(file).trained_on
    if frames.card["renderer"] != card.renderer:
        raise UsageError(
            f"the network was trained on frames of {card.renderer}, these are of "
            f"{frames.card['renderer']}",
            name="data",
        )
    for seen in (card.train, card.validation):
        first, last = _seeds(seen, file)
        if ((frames.streets >= first) & (frames.streets <= last)).any():
            raise UsageError("the network has seen these streets in its training", name="data")


def _seeds(frames: Mapping[str, Any], file: Path) -> tuple[int, int]:
    """Return the first and the last street of what a network has seen."""
    match frames.get("seeds"):
        case [int(first), int(last)]:
            return first, last
    raise FileError(
        f"the card of '{file}' does not say which streets the network has seen",
        name="seeds",
        suggestion="seeds: [first, last]",
    )


def _table(title: str, rows: Mapping[str, Mapping[str, float]]) -> Table:
    columns = list(next(iter(rows.values())))
    table = Table("", *columns, title=title, box=SIMPLE_HEAD)
    for name, row in rows.items():
        table.add_row(name, *(_shown(row[column]) for column in columns))
    return table


def _shown(value: float) -> str:
    if isinstance(value, int):
        return str(value)
    return "–" if math.isnan(value) else f"{value:.3f}"


def _write(output: Path, figures: dict[str, Any]) -> None:
    with replacing(output) as part:
        part.write_text(json.dumps(_rounded(figures), indent=2) + "\n", encoding="utf-8")


def _rounded(value: Any) -> Any:
    """Return figures with four decimals, and None where there is none: JSON knows no nan."""
    if isinstance(value, Mapping):
        return {key: _rounded(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(entry) for entry in value]
    if isinstance(value, int | str):
        return value
    return None if math.isnan(value) else round(float(value), 4)


def _command() -> str:
    program = Path(sys.argv[0]).name
    called = ["python", "-m", "vsr.training"] if program == "__main__.py" else [program]
    return valid_text(shlex.join([*called, *sys.argv[1:]]))
