import io
import json
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from rich.console import Console
from torch import nn
from typer.testing import CliRunner

from sfol.errors import UsageError
from tests.vsr.painting import GROUNDING, Painting, street
from vsr.classes import CLASS_COUNT, DESCRIPTOR_CLASSES, SemanticClass
from vsr.networks.weights import Card, TrainedOn, read_card, save_weights
from vsr.segmentation import Frame, SimulatorSegmenter
from vsr.training import feature_quality, segmentation_quality
from vsr.training.augmentation import relight
from vsr.training.cli import app
from vsr.training.frames import CARD, FrameSet, load_frames, write_shard
from vsr.training.jobs import judge_segmenter
from vsr.training.loop import Schedule, Training
from vsr.training.segmenter import (
    SegmenterTask,
    band,
    confusion,
    intersection_over_union,
    segmentation_loss,
    windows,
)
from vsr.training.shipping import trained_on

SHAPE = (128, 32)
CAMERA = {"size": 224, "fov": 50.0, "height": 1.5}


def random_frames(
    count: int = 8, first_street: int = 0, shape: tuple[int, int] = SHAPE
) -> FrameSet:
    rng = np.random.default_rng(first_street)
    size = (count, *shape)
    return FrameSet(
        gray=rng.integers(0, 256, size, dtype=np.uint8),
        classes=rng.integers(0, CLASS_COUNT, size, dtype=np.uint8),
        instances=rng.integers(-1, 5, size, dtype=np.int16),
        streets=first_street + np.arange(count) // 2,
        steps=np.arange(count) % 2,
        card={"renderer": "dice", "camera": CAMERA, "seeds": [first_street, first_street + 3]},
    )


def save(frames: FrameSet, folder):
    folder.mkdir(parents=True)
    names = ("gray", "classes", "instances", "streets", "steps")
    write_shard(folder / "0.npz", {name: getattr(frames, name) for name in names})
    (folder / CARD).write_text(json.dumps(dict(frames.card)))


class Interrupted(SegmenterTask):
    """A training that is killed at its fourth step."""

    steps_left = 3

    def loss(self, indices, rng, progress):
        if not self.steps_left:
            raise KeyboardInterrupt
        self.steps_left -= 1
        return super().loss(indices, rng, progress)


class Stagnant(SegmenterTask):
    """A training that never gets any better."""

    def validate(self):
        return {"score": 0.5}


def task(kind: type[SegmenterTask] = SegmenterTask) -> SegmenterTask:
    torch.manual_seed(0)
    network = nn.Sequential(
        nn.Conv2d(1, 4, 3, padding=1), nn.BatchNorm2d(4), nn.Conv2d(4, CLASS_COUNT, 1)
    )
    return kind(network, random_frames(), random_frames(4, 100), torch.device("cpu"))


def training(folder, kind=SegmenterTask, said=None, **schedule) -> Training:
    chosen = Schedule(**{"epochs": 2, "batch": 2, "patience": 100, **schedule})
    return Training(task(kind), chosen, folder, Console(file=said or io.StringIO(), width=200))


def weights(done: Training) -> dict[str, torch.Tensor]:
    return done.task.network.state_dict()


def equal(first: dict[str, torch.Tensor], second: dict[str, torch.Tensor]) -> bool:
    return all(torch.equal(first[name], second[name]) for name in first)


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory) -> Training:
    whole = training(tmp_path_factory.mktemp("whole"))
    whole.run()
    return whole


def test_training_lowers_the_loss(tmp_path):
    done = training(tmp_path, epochs=15, learning_rate=0.02)
    everything = torch.arange(8), torch.Generator().manual_seed(0), 1.0
    before = float(done.task.loss(*everything).detach())
    done.run()
    assert float(done.task.loss(*everything).detach()) < before
    assert done.history[-1]["step"] == 60
    assert {"score", "pedestrian", "crosswalk"} <= set(done.history[-1])


def test_the_seed_decides_everything(tmp_path, uninterrupted):
    again, other = training(tmp_path / "again"), training(tmp_path / "other", seed=1)
    again.run()
    other.run()
    assert equal(weights(again), weights(uninterrupted))
    assert not equal(weights(other), weights(uninterrupted))


def test_a_killed_training_ends_as_if_nothing_had_happened(tmp_path, uninterrupted):
    killed = training(tmp_path, Interrupted)
    with pytest.raises(KeyboardInterrupt):
        killed.run(checkpoint_every=0.0)
    said = io.StringIO()
    resumed = training(tmp_path, said=said)
    resumed.run()
    assert "going on from" in said.getvalue()
    assert equal(weights(resumed), weights(uninterrupted))
    assert equal(torch.load(resumed.best_weights), torch.load(uninterrupted.best_weights))
    seconds = {"seconds"}
    assert [
        {key: value for key, value in figures.items() if key not in seconds}
        for figures in resumed.history
    ] == [
        {key: value for key, value in figures.items() if key not in seconds}
        for figures in uninterrupted.history
    ]


def test_a_damaged_checkpoint_is_named_and_the_one_before_is_taken(tmp_path, uninterrupted):
    with pytest.raises(KeyboardInterrupt):
        training(tmp_path, Interrupted).run(checkpoint_every=0.0)
    latest = max(tmp_path.glob("checkpoint-*.pt"))
    latest.write_bytes(latest.read_bytes()[:1000])
    said = io.StringIO()
    resumed = training(tmp_path, said=said)
    resumed.run()
    assert f"{latest.name} is damaged and passed over" in said.getvalue().replace("\n", "")
    assert "checkpoint-0000002.pt" in said.getvalue()
    assert equal(weights(resumed), weights(uninterrupted))


def test_checkpoints_of_another_training_are_refused(tmp_path):
    training(tmp_path, epochs=1).run()
    with pytest.raises(UsageError, match="belongs to a training with"):
        training(tmp_path, epochs=1, seed=7).run()


def test_training_stops_where_nothing_improves(tmp_path):
    done = training(tmp_path, Stagnant, epochs=50, validations=4, patience=3)
    done.run()
    # the first validation is the best so far, and three more do not better it
    assert [figures["step"] for figures in done.history] == [1, 2, 3, 4]


def test_training_ends_when_its_time_is_used(tmp_path):
    done = training(tmp_path, epochs=1000, minutes=1e-6)
    done.run()
    assert done.history[-1]["step"] == 1
    assert done.best_weights.exists()


def test_too_few_frames_for_a_batch_are_an_error(tmp_path):
    with pytest.raises(UsageError, match="8 frames do not fill a batch of 9"):
        training(tmp_path, batch=9)


def test_frames_come_back_from_disk_and_know_their_successors(tmp_path):
    saved = random_frames()
    save(saved, tmp_path / "frames")
    loaded = load_frames(tmp_path / "frames")
    assert np.array_equal(loaded.gray, saved.gray)
    assert np.array_equal(loaded.classes, saved.classes)
    assert np.array_equal(loaded.instances, saved.instances)
    assert loaded.card == saved.card
    assert loaded.pairs().tolist() == [[0, 1], [2, 3], [4, 5], [6, 7]]
    assert len(loaded.without_successors()) == 4


def test_folders_without_frames_and_damaged_files_are_errors(tmp_path):
    with pytest.raises(UsageError, match="holds no frames"):
        load_frames(tmp_path)
    save(random_frames(), tmp_path / "frames")
    (tmp_path / "frames" / "0.npz").write_bytes(b"PK")
    with pytest.raises(UsageError, match=r"0\.npz is no file of frames"):
        load_frames(tmp_path / "frames")


@pytest.mark.parametrize(
    ("column", "values", "message"),
    [
        ("gray", np.zeros((8, *SHAPE), np.float32), "gray is float32"),
        ("gray", np.zeros(8, np.uint8), "gray is uint8 of shape"),
        ("classes", np.zeros((8, 3, 3), np.uint8), "classes is uint8 of shape"),
        ("classes", np.full((8, *SHAPE), CLASS_COUNT, np.uint8), "number beyond 27"),
        ("streets", np.zeros(7, np.int64), "streets is int64 of shape"),
        ("steps", np.array([None] * 8), "allow_pickle"),
    ],
)
def test_columns_that_are_not_what_they_should_be_are_errors(tmp_path, column, values, message):
    save(random_frames(), tmp_path / "frames")
    file = tmp_path / "frames" / "0.npz"
    columns = dict(np.load(file)) | {column: values}
    np.savez(file, **columns)
    with pytest.raises(UsageError, match=message):
        load_frames(tmp_path / "frames")


def test_frames_of_two_sizes_are_an_error(tmp_path):
    save(random_frames(), tmp_path / "frames")
    save(random_frames(shape=(32, 32)), tmp_path / "more")
    (tmp_path / "more" / "0.npz").rename(tmp_path / "frames" / "1.npz")
    with pytest.raises(UsageError, match=r"1\.npz has frames of another size"):
        load_frames(tmp_path / "frames")


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"renderer": 3}', "[" * 10_000])
def test_a_card_of_frames_that_says_nothing_is_an_error(tmp_path, content):
    save(random_frames(), tmp_path / "frames")
    (tmp_path / "frames" / CARD).write_text(content)
    with pytest.raises(UsageError, match="is no card of frames"):
        load_frames(tmp_path / "frames")


@pytest.mark.parametrize("seeds", [None, [], [1], ["a", "b"], 3])
def test_a_card_that_does_not_say_what_a_network_has_seen_is_an_error(tmp_path, seeds):
    card = Card(
        network="segmenter",
        architecture="none",
        weights="float16",
        trained_on=TrainedOn(
            renderer="dice", camera=CAMERA, train={"seeds": seeds}, validation={"seeds": [0, 1]}
        ),
        schedule={},
        metrics={},
        command="",
        versions={},
    )
    save_weights(tmp_path, card, {"a": torch.ones(1)})
    save(random_frames(), tmp_path / "frames")
    with pytest.raises(UsageError, match="does not say which streets"):
        judge_segmenter(tmp_path / "frames", tmp_path, tmp_path / "judged.json", "crossing")


def test_frames_whose_camera_nobody_names_are_not_trained_on():
    unnamed = replace(random_frames(), card={"renderer": "dice"})
    with pytest.raises(UsageError, match="training frames have the camera None"):
        trained_on(unnamed, unnamed)


def test_augmentation_changes_light_and_leaves_things_where_they_are():
    picture = torch.zeros(2, 1, 32, 32)
    picture[..., 8:16] = 0.8
    relit = relight(picture, torch.Generator().manual_seed(0))
    assert relit.shape == picture.shape
    assert not torch.equal(relit, picture)
    assert (relit[..., 8:16].mean(dim=(2, 3)) > relit[..., 16:].mean(dim=(2, 3)) + 0.4).all()


def test_a_rare_class_that_is_missed_costs_more_than_its_pixels():
    targets = torch.full((1, 10, 10), int(SemanticClass.ROAD))
    targets[0, 0, 0] = SemanticClass.PEDESTRIAN

    def loss_of(found: torch.Tensor) -> float:
        logits = 10.0 * nn.functional.one_hot(found, CLASS_COUNT).permute(0, 3, 1, 2).float()
        return float(segmentation_loss(logits, targets))

    blind, wrong_road = targets.clone(), targets.clone()
    blind[0, 0, 0] = SemanticClass.ROAD
    wrong_road[0, 5, 5] = SemanticClass.SIDEWALK
    assert loss_of(targets) < loss_of(wrong_road) < loss_of(blind)


def test_most_windows_are_where_people_are():
    classes = torch.full((400, 224, 224), int(SemanticClass.ROAD), dtype=torch.uint8)
    classes[:, 100:104, 5:7] = SemanticClass.PEDESTRIAN
    gray = torch.arange(224, dtype=torch.uint8).expand(400, 224, 224)
    cut_gray, cut_classes = windows(gray, classes, torch.Generator().manual_seed(0))
    assert cut_gray.shape == cut_classes.shape == (400, 128, 128)
    shown = (cut_classes == SemanticClass.PEDESTRIAN).flatten(1).any(dim=1).float().mean()
    assert 0.75 < shown < 0.95  # some are there by chance
    # picture and classes are cut at the same place
    at_people = cut_gray[cut_classes == SemanticClass.PEDESTRIAN]
    assert set(at_people.tolist()) == {5, 6}
    assert cut_gray.min() == 0
    assert cut_gray.max() == 223


def test_a_band_holds_the_horizon_and_every_row_is_in_some():
    rows = torch.arange(224, dtype=torch.uint8)[:, None].expand(2, 224, 4)
    rng = torch.Generator().manual_seed(0)
    tops = set()
    for _ in range(500):
        gray, classes = band(rows, rows, rng)
        assert gray.shape == (2, 128, 4)
        assert torch.equal(gray, classes)
        assert {111, 112} <= set(gray.flatten().tolist())
        tops.add(int(gray.min()))
    assert {0, 96} <= tops


def test_iou_is_that_of_the_textbook():
    truth = torch.tensor([[[1, 1, 1, 12]]])
    found = torch.tensor([[[1, 1, 12, 12]]])
    ious = intersection_over_union(confusion(found, truth))
    assert ious[1] == pytest.approx(2 / 3)
    assert ious[12] == pytest.approx(1 / 2)
    assert ious[2].isnan()


def crossing_street() -> Frame:
    """A person 21 m ahead and one 8.4 m ahead, the far one before a crosswalk."""
    classes = (
        street()
        .rectangle(SemanticClass.CROSSWALK, (118, 121), (40, 184))
        .rectangle(SemanticClass.PEDESTRIAN, (105, 120), (100, 106))
        .rectangle(SemanticClass.PEDESTRIAN, (90, 132), (60, 70))
        .classes
    )
    instances = np.full(classes.shape, -1, np.int32)
    instances[classes == SemanticClass.PEDESTRIAN] = 7
    instances[:, 60:70][classes[:, 60:70] == SemanticClass.PEDESTRIAN] = 8
    return Frame(np.zeros_like(classes), classes, instances)


class Blind:
    """Sees the far person as road, and an extra one on the road 5.6 m ahead."""

    def __call__(self, frames):
        painted = Painting()
        painted.classes = frames[0].classes.copy()
        painted.rectangle(SemanticClass.ROAD, (105, 120), (100, 106))
        painted.rectangle(SemanticClass.PEDESTRIAN, (136, 142), (140, 150))
        return painted.one_hot[None]


def test_a_perfect_segmenter_has_full_marks():
    counts = segmentation_quality.total(
        segmentation_quality.count(SimulatorSegmenter(), [crossing_street()], GROUNDING)
    )
    iou = segmentation_quality.iou_table(counts)
    assert iou["pedestrian"]["all"] == iou["crosswalk"]["all"] == iou["road"]["0-45 m"] == 1.0
    facts = segmentation_quality.fact_table(counts)
    assert {"Pedestrian", "OnRoad", "OnCrosswalk", "Crosswalk"} <= set(facts)
    assert all(row["precision"] == row["recall"] == 1.0 for row in facts.values())


def test_errors_are_counted_where_they_are_made():
    counts = segmentation_quality.total(
        segmentation_quality.count(Blind(), [crossing_street()], GROUNDING)
    )
    row = DESCRIPTOR_CLASSES.index(SemanticClass.PEDESTRIAN)
    # near: one person found whole, and one of 60 px invented; farther: one of 90 px missed
    assert counts.both[row].tolist() == [420, 0, 0, 0]
    assert counts.invented[row].tolist() == [60, 0, 0, 0]
    assert counts.missed[row].tolist() == [0, 90, 0, 0]
    iou = segmentation_quality.iou_table(counts)
    assert iou["pedestrian"]["0-15 m"] == pytest.approx(420 / 480)
    assert iou["pedestrian"]["15-30 m"] == 0.0
    assert iou["pedestrian"]["all"] == pytest.approx(420 / 570)
    facts = segmentation_quality.fact_table(counts)
    assert facts["OnCrosswalk"]["recall"] == 0.0
    assert facts["IsClear"]["precision"] == 0.0
    assert facts["OnRoad"] == {"precision": 1.0, "recall": 1.0, "frames": 1}


class Gray:
    """Features that know of each cell of the map how bright it is, in channels of its own."""

    def encode(self, frames):
        means = [frame.gray.reshape(7, 32, 7, 32).mean(axis=(1, 3)) for frame in frames]
        cells = torch.zeros(len(frames), 512, 7, 7)
        for number in range(49):
            row, column = divmod(number, 7)
            for frame, mean in enumerate(means):
                cells[frame, number, row, column] = float(mean[row, column])
        return cells


def people(columns: dict[int, int]) -> Frame:
    painted, bodies = street(), np.full((224, 224), -1, np.int32)
    for body, column in columns.items():
        area = (112, 126), (column, column + 8)
        painted.rectangle(SemanticClass.PEDESTRIAN, *area)
        bodies[slice(*area[0]), slice(*area[1])] = body
    return Frame(np.full((224, 224), 100, np.uint8), painted.classes, bodies)


def test_features_that_know_where_things_are_find_them_again():
    first = people({1: 10, 2: 60, 3: 110, 4: 180})
    second = people({4: 182, 1: 12, 2: 62, 3: 112})
    found = feature_quality.total(feature_quality.retrieve(Gray(), [(first, second)], GROUNDING))
    assert (found.queries, found.found, found.gone) == (4, 4, 0)
    assert found.rate == 1.0
    assert found.chance == 0.25


def test_who_left_is_not_looked_for_and_small_companies_are_passed_over():
    first = people({1: 10, 2: 60, 3: 110, 4: 180})
    second = people({1: 12, 2: 62, 3: 180})
    pairs = [(first, second), (people({1: 10, 2: 60}), people({1: 10, 2: 60}))]
    found = feature_quality.total(feature_quality.retrieve(Gray(), pairs, GROUNDING))
    # person 4 is gone, and person 3 now stands where 4 stood before
    assert (found.queries, found.found, found.gone) == (3, 2, 1)


@pytest.mark.parametrize("network", ["segmenter", "autoencoder"])
def test_the_command_line_trains_ships_and_judges(network, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["/usr/bin/aeb", "networks", network])
    for split, street_number in (("train", 0), ("validation", 50)):
        save(random_frames(4, street_number), tmp_path / "data" / split)
    save(random_frames(2, 90, (224, 224)), tmp_path / "test")
    weights_folder, figures = tmp_path / "[/] weights", tmp_path / "figures.json"
    options = ["--data", tmp_path / "data", "--output", weights_folder, "--epochs", 1]
    options += ["--batch", 2, "--checkpoints", tmp_path / "[/] checkpoints"]
    options += ["--focus"] if network == "segmenter" else []
    trained = run(network, *options)
    assert trained.exit_code == 0, trained.output
    file = weights_folder / f"{network}.safetensors"
    card = read_card(file)
    assert card.network == network
    assert card.trained_on.renderer == "dice"
    assert card.trained_on.train["frames"] == 4
    assert card.trained_on.validation["seeds"] == [50, 53]
    assert card.schedule["steps"] == 2
    assert card.schedule["seed"] == 0
    assert "score" in card.metrics
    assert {"python", "torch", "numpy"} <= set(card.versions)
    assert card.command == f"aeb networks {network}"

    judge = ["--data", tmp_path / "test", "--weights", weights_folder, "--output", figures]
    judge += ["--picture", tmp_path / "p.png"] if network == "autoencoder" else []
    judged = run(f"judge-{network}", *judge)
    assert judged.exit_code == 0, judged.output
    content = json.loads(figures.read_text())
    assert set(content) >= ({"iou", "facts"} if network == "segmenter" else {"psnr_db"})
    assert content["frames"]["renderer"] == "dice"

    seen = run(f"judge-{network}", "--data", tmp_path / "data" / "train", *judge[2:])
    assert "has seen these streets" in str(seen.exception)


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_training_and_validation_may_share_no_street(tmp_path):
    for split in ("train", "validation"):
        save(random_frames(4), tmp_path / split)
    refused = run("segmenter", "--data", tmp_path, "--output", tmp_path / "weights")
    assert "in both training and validation" in str(refused.exception)
    assert not (tmp_path / "weights").exists()
