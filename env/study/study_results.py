"""What a study leaves behind: files of trainings, drives and trajectories, from which figures come.

A study's folder has ``training/<name>.json``, how a setup was trained with one seed;
``drives/<name>/<cell>.json``, how it then drives (see `env.evaluation.results`); and
``trajectories/<name>.json``, one episode step by step. The name is that of setup and seed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from env.driving.names import Name, checked_name
from env.driving.rollout import Ending
from env.evaluation.results import DriveResult, ResultFolder, read_json, write_json
from env.world.cells import CellOcclusion, Traffic
from sfol.errors import UsageError
from sfol.writing import check_writable

Content = TypeVar("Content")


@dataclass(frozen=True)
class CurvePoint:
    """A stretch of a training: the episodes that ended in it.

    Attributes:
        steps: of all streets together, at its end.
        episodes: how many ended in it.
        total: their mean return.
        success: share of them.
        collision: share of them.
        timeout: share of them.
    """

    steps: int
    episodes: int
    total: float
    success: float
    collision: float
    timeout: float


@dataclass(frozen=True)
class TrainingResult:
    """How a setup was trained with one seed.

    Attributes:
        setup: its name.
        setup_hash: of its content, the seed among it.
        seed: of the training.
        steps: of all streets together.
        seconds: that the training took, evaluations during it included.
        knowledge_base: its name.
        knowledge_base_hash: of its content.
        policy: hash of the policy file that came of it.
        command: makes it again.
        versions: of the software that made it.
        evaluations: in order; steps, shares of success, collision and timeout, mean return and
            length, on streets that neither training nor the final test sees.
        curve: in order, what the training's own episodes were like.
    """

    setup: Name
    setup_hash: str
    seed: int
    steps: int
    seconds: float
    knowledge_base: str
    knowledge_base_hash: str
    policy: str
    command: str
    versions: Mapping[str, str]
    evaluations: tuple[Mapping[str, float], ...]
    curve: tuple[CurvePoint, ...]

    def __post_init__(self) -> None:
        """Refuse evaluations that lack what figures are drawn from.

        Raises:
            ValueError: one does.
        """
        for number, evaluation in enumerate(self.evaluations, start=1):
            missing = {"steps", "success"} - evaluation.keys()
            if missing:
                raise ValueError(f"evaluation {number} has no {min(missing)}")


@dataclass(frozen=True)
class Trajectory:
    """One episode, step by step; all sequences have a number for each step.

    Attributes:
        driver: who drove: the name of setup and seed, or a scripted driver.
        policy: hash of the policy file; None for a scripted driver.
        traffic: of the cell.
        occlusion: of the cell.
        seed: of the episode.
        ending: how it ended.
        knowledge_base: its name.
        knowledge_base_hash: of its content.
        command: makes it again.
        control_dt: length of a step, in s.
        crosswalk: where it begins and ends along the street, in m.
        position: of ego's front along the street when the step began, in m.
        speed: then, in m/s.
        action: throttle above 0, brake below.
        distance: d at the end of the step, in m; None where nobody is in the way.
        reward: R.
        confidences: head → its confidence.
        weights: weight → its value.
    """

    driver: Name
    policy: str | None
    traffic: Traffic
    occlusion: CellOcclusion
    seed: int
    ending: Ending
    knowledge_base: str
    knowledge_base_hash: str
    command: str
    control_dt: float
    crosswalk: tuple[float, float]
    position: tuple[float, ...]
    speed: tuple[float, ...]
    action: tuple[float, ...]
    distance: tuple[float | None, ...]
    reward: tuple[float, ...]
    confidences: Mapping[str, tuple[float, ...]]
    weights: Mapping[str, tuple[float, ...]]

    def __post_init__(self) -> None:
        sequences = (self.position, self.speed, self.action, self.distance, self.reward)
        columns = (*sequences, *self.confidences.values(), *self.weights.values())
        if not self.speed or {len(column) for column in columns} != {len(self.speed)}:
            raise UsageError("a trajectory has a number for each of its steps", name="trajectory")


class StudyFolder:
    """The folder of a study.

    Args:
        path: of the folder; it is made when something is written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    @property
    def drives(self) -> ResultFolder:
        """Where the drives are."""
        return ResultFolder(self._path / "drives")

    def check(self, names: Iterable[str]) -> None:
        """Make sure that results can be written here, before anything is trained.

        Args:
            names: of setups and seeds.

        Raises:
            UsageError: a file can't be written, or one that is there can't be read.
        """
        folders = (self._path / "training", self._path / "trajectories")
        check_writable(*(folder / f"{name}.json" for folder in folders for name in names))
        self.drives.check([])

    def training(self, name: str) -> TrainingResult | None:
        """Return the training of setup and seed, if it is there."""
        return _read(self._file("training", name), TrainingResult)

    def trajectory(self, name: str) -> Trajectory | None:
        """Return the trajectory of a driver, if it is there."""
        return _read(self._file("trajectories", name), Trajectory)

    def trainings(self) -> list[TrainingResult]:
        """Return all trainings, by their names."""
        files = sorted((self._path / "training").glob("*.json"))
        return [read_json(file, TrainingResult) for file in files]

    def trajectories(self) -> list[Trajectory]:
        """Return all trajectories, by the names of the drivers."""
        files = sorted((self._path / "trajectories").glob("*.json"))
        return [read_json(file, Trajectory) for file in files]

    def drive_results(self) -> list[DriveResult]:
        """Return how everybody drives, by driver and cell."""
        return self.drives.all()

    def write_training(self, name: str, result: TrainingResult) -> None:
        """Write how a setup was trained."""
        write_json(self._file("training", name), result)

    def write_trajectory(self, name: str, trajectory: Trajectory) -> None:
        """Write an episode step by step."""
        write_json(self._file("trajectories", name), trajectory)

    def _file(self, folder: str, name: str) -> Path:
        return self._path / folder / f"{checked_name(name)}.json"


def _read(path: Path, kind: type[Content]) -> Content | None:
    return read_json(path, kind) if path.exists() else None
