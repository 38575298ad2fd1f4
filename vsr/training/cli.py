"""The commands of the networks: train them, and measure how good they are.

Thin, so that `--help` loads no torch: `vsr.training.jobs` does the work.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    help="""The networks that see: train them on frames, and measure how good they are.

    Frames come from any source that writes them as `aeb frames` does.
    """,
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

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

    Example: `aeb networks segmenter --data runs/frames --minutes 60`
    """
    from vsr.training import jobs
    from vsr.training.loop import Schedule

    schedule = Schedule(epochs, minutes, batch, learning_rate, patience=patience, seed=seed)
    jobs.train_segmenter(jobs.Files(data, output, checkpoints, start), schedule, focus=focus)


@app.command()
def autoencoder(  # noqa: PLR0913 (each is an option)
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

    Example: `aeb networks autoencoder --start env/weights/segmenter.safetensors`
    """
    from vsr.training import jobs
    from vsr.training.loop import Schedule

    schedule = Schedule(epochs, minutes, batch, learning_rate, patience=patience, seed=seed)
    jobs.train_autoencoder(jobs.Files(data, output, checkpoints, start), schedule)


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

    Example: `aeb networks judge-segmenter --data runs/frames/test`
    """
    from vsr.training import jobs

    jobs.judge_segmenter(data, weights, output, rules)


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

    Example: `aeb networks judge-autoencoder --data runs/frames/test`
    """
    from vsr.training import jobs

    jobs.judge_autoencoder(data, weights, output, picture, rules)
