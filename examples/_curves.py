"""What the examples share: options of the command line, and the curve of what was learnt."""

import argparse
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

import sfol
from sfol.wrappers import EPISODE

POINTS = 20


class Episode(NamedTuple):
    """What an episode came to: after how many steps of training, by the rules, and by itself."""

    steps: int
    by_rules: float
    by_environment: float


def options(steps: int) -> argparse.Namespace:
    """Return how long to train, and where to write the curve.

    Args:
        steps: of a training that shows that everything runs, and no more.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=steps, help=f"of training; {steps} by default")
    parser.add_argument("--folder", type=Path, help="where the curve goes, as JSON and as PNG")
    return parser.parse_args()


def learn(model, name: str, steps: int) -> None:
    """Train a model of stable-baselines3 in an environment that rules reward; show the curve.

    Args:
        model: the model; its environment is a RuleReward, or several of them.
        name: of the knowledge base, and of the files.
        steps: as for `options`.
    """
    from stable_baselines3.common.callbacks import BaseCallback  # noqa: PLC0415 (not all need it)

    episodes = []

    class Listener(BaseCallback):
        def _on_step(self) -> bool:
            sums = [info[EPISODE] for info in self.locals["infos"] if EPISODE in info]
            for found in sums:
                values = float(found["return"]), float(found["original_return"])
                episodes.append(Episode(self.num_timesteps, *values))
            return True

    chosen = options(steps)
    model.learn(chosen.steps, callback=Listener())
    show(name, episodes, chosen.folder)


def show(name: str, episodes: list[Episode], folder: Path | None) -> None:
    """Print the mean returns of the parts of a training; write them, if there is a folder."""
    numbers = np.array(episodes, dtype=np.float64).reshape(-1, 3)
    ends = np.linspace(0, numbers[-1, 0] if len(numbers) else 1, POINTS + 1)[1:]
    parts = np.searchsorted(ends, numbers[:, 0])
    curve = [
        Episode(int(end), *(float(n) for n in numbers[parts == i, 1:].mean(axis=0).round(4)))
        for i, end in enumerate(ends)
        if (parts == i).any()
    ]
    print(f"{name}: mean returns of {len(episodes)} episodes")
    print(f"{'steps':>8} {'by the rules':>13} {'by its own reward':>18}")
    for steps, by_rules, own in curve:
        print(f"{steps:8} {by_rules:13.3f} {own:18.3f}")
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        content = {
            "knowledge_base": sfol.KnowledgeBase.load(name).hash,
            "episodes": len(episodes),
            "curve": [point._asdict() for point in curve],
        }
        (folder / f"{name}.json").write_text(json.dumps(content, indent=1) + "\n", "utf-8")
        _draw(name, curve, folder / f"{name}.png")


def _draw(name: str, curve: list[Episode], path: Path) -> None:
    import matplotlib  # noqa: PLC0415 (only where a curve is kept)

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    steps, by_rules, own = zip(*curve, strict=True)
    figure, (left, right) = plt.subplots(1, 2, figsize=(7, 2.6), layout="constrained")
    for axes, values, title in (
        (left, by_rules, "return by the rules"),
        (right, own, "by the environment's own reward"),
    ):
        axes.plot(steps, values, marker=".")
        axes.set(title=title, xlabel="steps of training")
    figure.suptitle(name)
    figure.savefig(path, dpi=90)
