"""Data sets of Minari are labelled as their steps are rewarded, whatever they are stored in."""

import json
import pickle
import sys

import numpy as np
import pytest

import sfol
from sfol.errors import FileError, MissingExtraError, SfolError, UsageError
from sfol.tools import label_minari
from sfol.tools.label import label
from tests.sfol.command_line import sfol as command
from tests.sfol.hall import HALL

pq = pytest.importorskip("pyarrow.parquet")
spaces = pytest.importorskip("gymnasium.spaces")

LENGTHS = (30, 1, 70, 25, 44)
ROWS = sum(LENGTHS)
STATES = spaces.Dict(
    {
        "people": spaces.Box(-99.0, 99.0, (4, 2), np.float64),
        "mask": spaces.MultiBinary(4),
        "body": spaces.Dict({"state": spaces.Box(-99.0, 99.0, (5,), np.float64)}),
        "light": spaces.Box(0.0, 1.0, (), np.float64),
    }
)
ACTIONS = spaces.Box(-99.0, 99.0, (1,), np.float64)


def episode(seed, length):
    """Return a random walk through the hall: states, actions, rewards, and how it ended."""
    chance = np.random.default_rng(seed)
    states = {
        "people": chance.normal(0.0, 3.0, (length + 1, 4, 2)),
        "mask": (chance.random((length + 1, 4)) < 0.7).astype(np.int8),
        "body": {"state": chance.normal(0.0, 1.0, (length + 1, 5))},
        "light": chance.random(length + 1),
    }
    ended = np.arange(length) == length - 1
    return states, chance.normal(0.0, 1.0, (length, 1)), chance.random(length), ended


EPISODES = [episode(seed, length) for seed, length in enumerate(LENGTHS)]


def rows(nested, chosen):
    if isinstance(nested, dict):
        return {name: rows(part, chosen) for name, part in nested.items()}
    return nested[chosen]


def expected(reward):
    """Return the rewards of all steps, evaluated episode by episode."""
    found = []
    for states, actions, native, ended in EPISODES:
        before, after = rows(states, slice(-1)), rows(states, slice(1, None))
        outcome = reward.transitions(before, actions, after, native, ended, ~ended & False)
        found.append(outcome.reward)
    return np.concatenate(found)


@pytest.fixture
def hall(tmp_path):
    (tmp_path / "hall.yaml").write_text(HALL)
    return sfol.RewardFunction(tmp_path / "hall.yaml")


@pytest.fixture(params=["hdf5", "arrow", "parquet"])
def data(tmp_path, monkeypatch, request):
    """Make a data set, and return its folder, of which Minari knows."""
    minari = pytest.importorskip("minari")
    pytest.importorskip("h5py")
    from minari.data_collector import EpisodeBuffer  # noqa: PLC0415 (it may be missing)
    from minari.dataset.minari_storage import MinariStorage  # noqa: PLC0415

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "sets"))
    folder = tmp_path / "sets" / "halls" / "walk-v0"
    folder.mkdir(parents=True)
    storage = MinariStorage.new(folder / "data", STATES, ACTIONS, data_format=request.param)
    storage.update_episodes(
        EpisodeBuffer(None, None, None, states, actions, native, ended, ~ended & False, {})
        for states, actions, native, ended in EPISODES
    )
    about = {"dataset_id": "halls/walk-v0", "minari_version": minari.__version__}
    storage.update_metadata(about)
    return folder


def columns(labelled, *names):
    tables = [pq.read_table(path) for path in labelled.parts]
    return [np.concatenate([table.column(n).to_numpy() for table in tables]) for n in names]


@pytest.mark.parametrize("batch_rows", [20, 80, 10_000])
def test_labels_are_what_the_reward_function_says(tmp_path, monkeypatch, hall, data, batch_rows):
    monkeypatch.setattr(label_minari, "BATCH_ROWS", batch_rows)
    seen = []
    labelled = label(
        data, tmp_path / "out", hall, part_rows=60, on_rows=lambda done, _: seen.append(done)
    )
    assert labelled.rows == labelled.new_rows == ROWS
    assert [pq.read_metadata(path).num_rows for path in labelled.parts] == [101, 69]
    assert max(np.diff(seen)) <= batch_rows
    reward, episodes, steps = columns(labelled, "rule_reward", "episode", "step")
    assert reward == pytest.approx(expected(hall), abs=1e-12, rel=0)
    assert episodes.tolist() == [i for i, length in enumerate(LENGTHS) for _ in range(length)]
    assert steps.tolist() == [step for length in LENGTHS for step in range(length)]
    assert np.ptp(reward) > 1


def test_labelling_goes_on_where_it_was_stopped(tmp_path, hall, data):
    folder = tmp_path / "out"
    whole = label(data, folder, hall, part_rows=60)
    whole.parts[1].unlink()
    again = label(f"minari:halls/{data.name}", folder, hall, part_rows=60)
    assert (again.rows, again.new_rows, again.parts) == (ROWS, 69, whole.parts)
    (reward,) = columns(again, "rule_reward")
    assert reward == pytest.approx(expected(hall), abs=1e-12, rel=0)
    metadata = data / "data" / "metadata.json"
    metadata.write_text(metadata.read_text() + " ")
    with pytest.raises(UsageError, match="labels of other data"):
        label(data, folder, hall, part_rows=60)


def test_the_command(tmp_path, monkeypatch, hall, data):
    monkeypatch.chdir(tmp_path)
    done = command("label", "minari:halls/walk-v0", "--rules", "hall.yaml")
    assert done.code == 0, done.err
    assert f"{ROWS} rows in 1 parts" in done.out
    assert (tmp_path / "walk-v0.labelled" / "part-00000.parquet").exists()
    done = command("label", data, "--rules", "hall.yaml")
    assert (data.parent / "walk-v0.labelled" / "part-00000.parquet").exists()
    assert done.code == 0


def test_what_minari_does_not_have_is_said(tmp_path, hall, data):
    with pytest.raises(UsageError, match="no data set 'halls/run-v0'") as caught:
        label("minari:halls/run-v0", tmp_path / "out", hall)
    assert caught.value.suggestion.startswith("minari download halls/run-v0")
    assert not (tmp_path / "out").exists()


def changed(data, **changes):
    path = data / "data" / "metadata.json"
    about = {**json.loads(path.read_text()), **changes}
    path.write_text(json.dumps({name: value for name, value in about.items() if value != ""}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"data_format": "runes"}, "the data can't be read: 'runes'"),
        ({"total_episodes": len(LENGTHS) + 1}, "the data can't be read"),
        ({"observation_space": None}, "the data can't be read"),
    ],
)
def test_what_can_not_be_read_is_said(tmp_path, hall, data, changes, message):
    changed(data, **changes)
    with pytest.raises(FileError, match=message):
        label(data, tmp_path / "out", hall)


def test_data_do_not_say_which_environment_is_made(tmp_path, monkeypatch, hall, data):
    (tmp_path / "evil_module.py").write_text("raise SystemExit('run')")
    monkeypatch.syspath_prepend(tmp_path)
    spec = {"id": "Evil-v0", "entry_point": "evil_module:Evil", "additional_wrappers": []}
    changed(data, observation_space="", env_spec=json.dumps(spec))
    with pytest.raises(FileError, match="its metadata has no observation_space"):
        label(data, tmp_path / "out", hall)


def test_episodes_of_other_lengths_are_refused(tmp_path, monkeypatch, hall, data):
    episodes = label_minari.MinariEpisodes(data)
    monkeypatch.setattr(episodes, "_sizes", [length + 1 for length in LENGTHS])
    (piece,) = episodes.pieces(ROWS + len(LENGTHS))
    with pytest.raises(FileError, match="an episode has 31 observations, and not 32"):
        next(episodes.batches(piece))


def test_episodes_can_be_sent_to_another_process(data):
    episodes = label_minari.MinariEpisodes(data)
    (piece,) = episodes.pieces(ROWS)
    sent = pickle.loads(pickle.dumps(episodes))
    (here,), (there,) = episodes.batches(piece), sent.batches(piece)
    assert there.columns == here.columns
    assert (there.step()[3] == here.step()[3]).all()


def test_what_rules_miss_is_told_with_its_rows(tmp_path, data):
    (tmp_path / "hall.yaml").write_text(HALL.replace("key: light", "key: lamp"))
    reward = sfol.RewardFunction(tmp_path / "hall.yaml")
    with pytest.raises(SfolError, match=r"rows 0 to 169 of '.*walk-v0': .*lamp"):
        label(data, tmp_path / "out", reward)
    assert not [*(tmp_path / "out").glob("part-*")]


def test_minari_is_named_where_it_is_missing(tmp_path, monkeypatch, hall):
    monkeypatch.setitem(sys.modules, "minari.storage.datasets_root_dir", None)
    monkeypatch.setitem(sys.modules, "minari", None)
    with pytest.raises(MissingExtraError, match=r"minari.* is not installed") as caught:
        label("minari:halls/walk-v0", tmp_path / "out", hall)
    assert "pip install 'sfol[minari]'" in caught.value.suggestion
