"""The commands of those who change the street or its networks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from env.cli.app import app
from sfol.cli.inputs import path_or_name


@app.command("frames")
def frames_command(
    split: Annotated[str, typer.Argument(help="train, validation or test: streets of their own.")],
    output: Annotated[Path, typer.Option(help="Folder for the frames.")],
    frames: Annotated[
        int, typer.Option(min=1, help="How many, rounded up to whole streets.")
    ] = 600,
    pairs: Annotated[
        bool, typer.Option(help="Also the frame one control step (0.1 s) after each.")
    ] = False,
    renderer: Annotated[
        Literal["street", "tiny"],
        typer.Option(help="What draws them: the street itself, or pybullet's TinyRenderer."),
    ] = "street",
) -> None:
    """Render frames of many different streets, to train and to test networks on.

    All traffic levels and both occlusions. Ego drives at changing speeds from random places; frames
    of one street are half a second to a second apart. A render that was stopped goes on where it
    was.

    Example: `aeb frames train --frames 8000 --output runs/frames/train`
    """
    from env.tools.frames import render

    render(split, output, frames=frames, pairs=pairs, renderer=renderer)


@app.command("agreement")
def agreement_command(
    *,
    episodes: Annotated[int, typer.Option(min=1, help="Through all cells in turn.")] = 20,
    reach: Annotated[
        float | None,
        typer.Option(
            help="Up to which distance entities count, in m.", show_default="the way to a stand"
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the first episode.")] = 0,
    every: Annotated[int, typer.Option(min=1, help="Compare every how many steps.")] = 1,
    frames: Annotated[
        Path | None, typer.Option(help="Folder for a frame of each kind of difference.")
    ] = None,
) -> None:
    """Print how often the perceptions truth and simulator agree on each predicate.

    Example: `aeb agreement --episodes 6 --every 5 --frames runs/differences`
    """
    from env.tools.agreement import USEFUL_RANGE, print_agreement

    print_agreement(
        episodes=episodes, reach=reach or USEFUL_RANGE, seed=seed, every=every, frames=frames
    )


@app.command("tracking")
def tracking_command(
    *,
    episodes: Annotated[int, typer.Option(min=1, help="Through all cells in turn.")] = 24,
    seed: Annotated[int, typer.Option(min=0, help="Of the first episode.")] = 0,
) -> None:
    """Print how often entities change their names, against the simulator's own bodies.

    The cautious driver drives with the perception simulator. By names that count within each
    picture, and by those that `grounding.segmentation.tracking` keeps: how often somebody is seen
    by another name than before, and how often a name shows somebody else than before.

    Example: `aeb tracking --episodes 60 --seed 5000`
    """
    from env.tools.tracking import print_switches

    print_switches(episodes=episodes, seed=seed)


@app.command("fluctuation")
def fluctuation_command(  # noqa: PLR0913  (each is an option of the command line)
    *,
    episodes: Annotated[int, typer.Option(min=1, help="Through all cells in turn.")] = 24,
    seed: Annotated[int, typer.Option(min=0, help="Of the first episode.")] = 0,
    before: Annotated[str, typer.Option(help="The rules that are compared with.")] = "crossing",
    after: Annotated[str, typer.Option(help="The rules that shall be calmer.")] = "steady",
    perception: Annotated[
        Literal["simulator", "truth", "unet"], typer.Option(help="Where facts come from.")
    ] = "simulator",
    picture: Annotated[
        Path | None,
        typer.Option("--plot", help="Draw the weights of the most restless episode, as w.png."),
    ] = None,
) -> None:
    """Compare how restless the weights of two knowledge bases are, on the same drives.

    The cautious driver drives; what was seen is put to both. For each weight: its total variation
    a second under either, the ratio, and after how many steps the second one has followed where
    the first rises. A rise is a step by which a weight grows by more than 0.05, and it is followed
    where the other weight reaches 90 % of what it comes to.

    Example: `aeb fluctuation --episodes 24 --plot runs/fluctuation.png`
    """
    from env.tools.fluctuation import print_fluctuation

    rules = (path_or_name(before), path_or_name(after))
    print_fluctuation(rules, episodes, seed, perception, picture)


@app.command("renderers")
def renderers_command(
    *,
    frames: Annotated[
        int, typer.Option(min=1, help="Moments of held-out streets, rounded up to whole streets.")
    ] = 60,
    picture: Annotated[
        Path | None, typer.Option(help="PNG file for a few moments, drawn by both.")
    ] = None,
    networks: Annotated[
        bool, typer.Option(help="Judge the trained networks on both renderers' frames.")
    ] = False,
) -> None:
    """Compare the street's renderer with pybullet's TinyRenderer: pixels, speed, networks.

    Example: `aeb renderers --frames 240 --networks --picture runs/renderers.png`
    """
    from env.tools.renderers import print_comparison

    print_comparison(frames=frames, picture=picture, networks=networks)


@app.command("contact-sheet")
def contact_sheet_command(
    output: Annotated[Path, typer.Argument(help="The PNG file, which is replaced.")],
    seed: Annotated[int, typer.Option(min=0, help="Of the episode in every cell.")] = 4,
) -> None:
    """Draw every cell at a few moments of a cautious drive.

    Example: `aeb contact-sheet runs/cells.png`
    """
    from env.tools.contact_sheet import save_sheet

    save_sheet(output, seed)
    print(output)


@app.command("profile")
def profile_command(
    output: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("runs/profile"),
    perception: Annotated[
        Literal["simulator", "unet"], typer.Option(help="Where facts come from.")
    ] = "simulator",
) -> None:
    """Sample three updates of the main setup's training by py-spy: which stage costs how much.

    Writes flame.svg, to be opened in a browser, and stages.json, which is printed as a table: the
    milliseconds of processor time that each stage costs for one step of one street.
    """
    from env.tools.profile import record

    record(output, perception)


@app.command("capacity")
def capacity_command(
    folder: Annotated[Path, typer.Option(help="The project's folder.")] = Path(),
    dimension: Annotated[
        list[int] | None,
        typer.Option(
            help="D of the descriptor. May be given several times.",
            show_default="1024, 2048, 4096, 8192",
        ),
    ] = None,
    entities: Annotated[
        int, typer.Option(help="How many entities are drawn for each cell, at least.", min=1)
    ] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Of the random scenes.")] = 0,
) -> None:
    """Measure how many entities a descriptor holds, and write numbers, plot and table.

    Random scenes of 1 to 50 entities are encoded and decoded again. It takes some ten minutes; a
    study that was stopped goes on from where it was. Numbers go to results/capacity.json, the plot
    to docs/images/capacity.png, the table into the documentation's page on the descriptor.
    """
    from vsr.hypervectors.capacity import DIMENSIONS, study

    study(folder, dimensions=dimension or DIMENSIONS, entities=entities, seed=seed)
