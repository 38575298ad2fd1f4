"""Files of a study: what is in them is checked before anything is drawn."""

import json

import pytest

from env.study.study_results import StudyFolder, TrainingResult, Trajectory
from sfol.errors import FileError

TRAINING = TrainingResult(
    setup="small",
    setup_hash="0",
    seed=0,
    steps=16,
    seconds=1.0,
    knowledge_base="crossing",
    knowledge_base_hash="0",
    policy="0",
    command="aeb study",
    versions={},
    evaluations=({"steps": 16.0, "success": 1.0},),
    curve=(),
)
TRAJECTORY = Trajectory(
    driver="small-seed0",
    policy="0",
    traffic="low",
    occlusion="full",
    seed=0,
    ending="success",
    knowledge_base="crossing",
    knowledge_base_hash="0",
    command="aeb study",
    control_dt=0.1,
    crosswalk=(60.0, 64.0),
    position=(0.0, 0.1),
    speed=(0.0, 1.0),
    action=(1.0, 1.0),
    distance=(None, None),
    reward=(0.0, 0.1),
    confidences={"safe1": (0.0, 0.0)},
    weights={"safety": (0.0, 0.0)},
)


@pytest.fixture
def folder(tmp_path):
    made = StudyFolder(tmp_path)
    made.write_training("small-seed0", TRAINING)
    made.write_trajectory("small-seed0", TRAJECTORY)
    return made


def test_results_come_back_as_they_were_written(folder):
    assert folder.trainings() == [TRAINING]
    assert folder.trajectories() == [TRAJECTORY]


@pytest.mark.parametrize(
    ("kind", "key", "value", "reason"),
    [
        ("training", "evaluations", [{"steps": 1.0}], "evaluation 1 has no success"),
        ("training", "evaluations", 7, "evaluations: Input should be"),
        ("training", "steps", "many", "steps: Input should be"),
        ("trajectories", "speed", [0.0], "a trajectory has a number for each of its steps"),
        ("trajectories", "weights", {"safety": []}, "a trajectory has a number"),
        ("trajectories", "ending", "gone", "ending: Input should be"),
    ],
)
def test_content_that_does_not_fit_is_named_with_its_file(
    folder, tmp_path, kind, key, value, reason
):
    (path,) = (tmp_path / kind).glob("*.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | {key: value}))
    with pytest.raises(FileError) as caught:
        folder.trainings() if kind == "training" else folder.trajectories()
    assert str(path) in str(caught.value)
    assert reason in str(caught.value)
    assert "remove it" in str(caught.value)


def test_a_trajectory_has_steps(folder, tmp_path):
    (path,) = (tmp_path / "trajectories").glob("*.json")
    content = json.loads(path.read_text())
    columns = ("position", "speed", "action", "distance", "reward")
    empty = {**{key: [] for key in columns}, "weights": {}, "confidences": {}}
    path.write_text(json.dumps(content | empty))
    with pytest.raises(FileError, match="a trajectory has a number"):
        folder.trajectories()
