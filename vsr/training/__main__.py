"""The command line of the networks: train them, and measure how good they are.

Run as ``python -m vsr.training``.
"""

from __future__ import annotations

import json
import math
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import torch
import typer
from PIL import Image
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import track
from rich.table import Table

import sfol
from sfol.cli import run
from sfol.errors import UsageError
from sfol.writing import replacing
from vsr.grounding import SegmentationGrounding
from vsr.networks import autoencoder, unet
from vsr.networks.weights import read_card
from vsr.segmentation import Frame
from vsr.training import feature_quality, segmentation_quality
from vsr.training.autoencoder import AutoencoderTask
from vsr.training.frames import FrameSet, load_frames
from vsr.training.loop import Schedule, Task, Training
from vsr.training.segmenter import SegmenterTask
from vsr.training.shipping import ship, trained_on

app = typer.Typer(
    help="""The networks that see: train them on frames, and measure how good they are.

    Frames come from any source that writes them as `python -m env.tools.frames` does.
    """,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

T = TypeVar("T")

_PICTURED = 6  # frames in the picture of reconstructions

Data = Annotated[Path, typer.Option(help="Folder with the frames: train/ and validation/ in it.")]
Output = Annotated[Path, typer.Option(help="Folder for the weights and their card.")]
Checkpoints = Annotated[
    Path | None, typer.Option(help="Folder for checkpoints; runs/training/<network> if left out.")
]
Start = Annotated[Path | None, typer.Option(help="A trained segmenter.safetensors to begin with.")]
Epochs = Annotated[int, typer.Option(help="Passes over the frames, at most.")]
Minutes = Annotated[
    float | None, typer.Option(help="Time to use at most; the learning rate falls in time.")
]
Batch = Annotated[int, typer.Option(help="Frames a step.")]
LearningRate = Annotated[float, typer.Option(help="The highest of its cycle.")]
Patience = Annotated[int, typer.Option(help="Validations without progress before it stops.")]
Seed = Annotated[int, typer.Option(help="Decides first weights, order and augmentation.")]
Frames = Annotated[Path, typer.Option(help="Folder with the frames of held-out streets.")]
Weights = Annotated[Path, typer.Option(help="Folder with the weights.")]
Rules = Annotated[str, typer.Option(help="Knowledge base whose grounding reads the maps.")]


def main() -> None:
    """Run the command line; errors of ours end with exit code 2 and no traceback."""
    run(app, prog_name="python -m vsr.training")


@app.command()
def segmenter(  # noqa: PLR0913 (each is an option)
    *,
    data: Data = Path("runs/frames"),
    output: Output = Path("env/weights"),
    checkpoints: Checkpoints = None,
    start: Start = None,
    focus: Annotated[
        bool, typer.Option(help="Look at people most of the time: a second stage.")
    ] = False,
    epochs: Epochs = 3,
    minutes: Minutes = None,
    batch: Batch = 8,
    learning_rate: LearningRate = 1.5e-3,
    patience: Patience = 4,
    seed: Seed = 0,
) -> None:
    """Train the UNet, and write segmenter.safetensors and segmenter.json.

    A training that was stopped, or killed, goes on from its last checkpoint. Tensorboard's scalars
    lie beside the checkpoints.

    Example: `python -m vsr.training segmenter --data runs/frames --minutes 60`
    """
    torch.manual_seed(seed)
    train, validation = _split(data)
    schedule = Schedule(epochs, minutes, batch, learning_rate, patience=patience, seed=seed)
    network = unet.load_unet(start) if start else unet.build_unet()
    task = SegmenterTask(network, train, validation, focus=focus)
    description = _description("segmenter", unet.ARCHITECTURE, (train, validation), start)
    _train(task, schedule, checkpoints, output, description)


@app.command("autoencoder")
def autoencoder_(  # noqa: PLR0913 (each is an option)
    *,
    data: Data = Path("runs/frames"),
    output: Output = Path("env/weights"),
    checkpoints: Checkpoints = None,
    start: Start = None,
    epochs: Epochs = 3,
    minutes: Minutes = None,
    batch: Batch = 8,
    learning_rate: LearningRate = 1.5e-3,
    patience: Patience = 4,
    seed: Seed = 0,
) -> None:
    """Train the autoencoder, and write autoencoder.safetensors and autoencoder.json.

    With `--start` it needs a fraction of the time: the segmenter's encoder is a ResNet18 too.

    A training that was stopped, or killed, goes on from its last checkpoint. Tensorboard's scalars
    lie beside the checkpoints.

    Example: `python -m vsr.training autoencoder --start env/weights/segmenter.safetensors`
    """
    torch.manual_seed(seed)
    train, validation = _split(data)
    schedule = Schedule(epochs, minutes, batch, learning_rate, patience=patience, seed=seed)
    network = autoencoder.Autoencoder()
    if start:
        network.start_from(unet.load_unet(start))
    task = AutoencoderTask(network, train, validation)
    description = _description("autoencoder", autoencoder.ARCHITECTURE, (train, validation), start)
    _train(task, schedule, checkpoints, output, description)


@app.command()
def judge_segmenter(
    data: Frames = Path("runs/frames/test"),
    weights: Weights = Path("env/weights"),
    output: Annotated[Path, typer.Option(help="File for the figures, as JSON.")] = Path(
        "results/networks/segmenter.json"
    ),
    rules: Rules = "crossing",
) -> None:
    """Print IoU by class and distance, and how well the facts agree with the simulator's.

    Example: `python -m vsr.training judge-segmenter --data runs/frames/test`
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


@app.command()
def judge_autoencoder(
    data: Frames = Path("runs/frames/test"),
    weights: Weights = Path("env/weights"),
    output: Annotated[Path, typer.Option(help="File for the figures, as JSON.")] = Path(
        "results/networks/autoencoder.json"
    ),
    picture: Annotated[Path, typer.Option(help="File for the reconstructions.")] = Path(
        "docs/images/reconstructions.png"
    ),
    rules: Rules = "crossing",
) -> None:
    """Print how well frames are drawn again, and whether features tell entities apart.

    The frames have to be rendered with `--pairs`.

    Example: `python -m vsr.training judge-autoencoder --data runs/frames/test`
    """
    file = weights / "autoencoder.safetensors"
    frames, grounding = load_frames(data), _grounding(rules)
    _check_held_out(frames, file)
    pairs = frames.pairs()
    if not len(pairs):
        raise UsageError(
            f"{data} has no frames that follow each other",
            name=str(data),
            suggestion="python -m env.tools.frames test --pairs",
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


def _train(
    task: Task,
    schedule: Schedule,
    checkpoints: Path | None,
    output: Path,
    description: dict[str, Any],
) -> None:
    console = Console(stderr=True, highlight=False)
    folder = checkpoints or Path("runs/training") / description["network"]
    training = Training(task, schedule, folder, console)
    training.run()
    file = ship(training, output, description)
    console.print(f"{file}, {file.stat().st_size / 1e6:.1f} MB: {read_card(file).metrics}")


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
        first, last = seen["seeds"]
        if ((frames.streets >= first) & (frames.streets <= last)).any():
            raise UsageError("the network has seen these streets in its training", name="data")


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
    return shlex.join(["python", "-m", "vsr.training", *sys.argv[1:]])


if __name__ == "__main__":
    main()
