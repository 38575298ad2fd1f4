"""Data that is labelled by rules, in parts, and gone on with after a kill."""

import json
import os
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pytest

import sfol
from sfol.errors import FileError, SfolError, UsageError
from sfol.tools.label import ABOUT, label
from tests.sfol.command_line import sfol as command
from tests.sfol.hall import HALL

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")

ROWS, GROUP = 1_000, 100


def steps(seed=0, rows=ROWS):
    """Return random steps in the hall: arrays, as `RewardFunction.transitions` takes them."""
    chance = np.random.default_rng(seed)

    def observation():
        return {
            "people": chance.normal(0.0, 3.0, (rows, 4, 2)),
            "mask": chance.random((rows, 4)) < 0.7,
            "body": {"state": chance.normal(0.0, 1.0, (rows, 5))},
            "light": chance.random(rows),
        }

    return observation(), chance.normal(0.0, 1.0, (rows, 1)), observation()


def column(part, fixed):
    """Return an array, or arrays by name, as a column of Parquet."""
    if isinstance(part, dict):
        return pa.StructArray.from_arrays([column(p, fixed) for p in part.values()], names=[*part])
    if part.ndim == 1:
        return pa.array(part)
    inner = column(part.reshape(-1, *part.shape[2:]), fixed)
    if fixed:
        return pa.FixedSizeListArray.from_arrays(inner, part.shape[1])
    return pa.ListArray.from_arrays(np.arange(0, len(inner) + 1, part.shape[1], np.int32), inner)


def table(parts, *, fixed=True):
    observation, action, after = parts
    columns = {"observation": observation, "action": action, "next_observation": after}
    numbers = pa.array(np.arange(len(action)))
    made = {name: column(part, fixed) for name, part in columns.items()}
    return pa.table({"number": numbers, **made})


@pytest.fixture
def hall(tmp_path):
    (tmp_path / "hall.yaml").write_text(HALL)
    return sfol.RewardFunction(tmp_path / "hall.yaml")


@pytest.fixture
def data(tmp_path):
    pq.write_table(table(steps()), tmp_path / "steps.parquet", row_group_size=GROUP)
    return tmp_path / "steps.parquet"


def read(labelled):
    return pa.concat_tables(pq.read_table(path) for path in labelled.parts)


@pytest.mark.parametrize("fixed", [True, False])
def test_labels_are_what_the_reward_function_says(tmp_path, hall, fixed):
    parts = steps()
    path = tmp_path / "steps.parquet"
    pq.write_table(table(parts, fixed=fixed), path, row_group_size=GROUP)
    labelled = label(path, tmp_path / "out", hall, part_rows=250)
    assert labelled.rows == labelled.new_rows == ROWS
    assert [pq.read_metadata(p).num_rows for p in labelled.parts] == [300, 300, 300, 100]
    found, outcome = read(labelled), hall.transitions(*parts)
    assert found.column("number").to_pylist() == list(range(ROWS))
    assert found.column("observation") == pq.read_table(path).column("observation")
    expected = {"rule_reward": outcome.reward}
    expected |= {f"reward_{name}": values for name, values in outcome.terms.items()}
    expected |= {f"weight_{name}": values for name, values in outcome.weights.items()}
    expected |= {f"confidence_{name}": values for name, values in outcome.confidences.items()}
    assert found.column_names[4:] == [*expected]
    for name, values in expected.items():
        assert found.column(name).to_numpy() == pytest.approx(values, abs=1e-12, rel=0)
    assert np.ptp(outcome.reward) > 1


FLAT = """\
version: 1
name: flat
subject: cart
background: [Cart(cart)]
predicates:
  Cart(X): X is a cart.
  Fast(X): X is fast.
rules:
  fast: fast(X) :- Cart(X), Fast(X).
observation:
  cart: {fields: [x, v]}
facts:
  Fast(cart): {formula: cart.v > 1, bounds: exact, at_least: 1}
signals:
  x: {unit: m, from: next.cart.x - cart.x}
  own: {unit: "1", from: native + 10 * terminated - truncated}
  extra: {unit: "1"}
weights:
  w: {normalizer: 1, coefficients: {fast: 1.0}}
terms:
  t: {weight: 1, formula: x + own + 100 * extra}
  fast: {weight: w, formula: 1000}
"""


def test_columns_may_stand_beside_each_other(tmp_path):
    (tmp_path / "flat.yaml").write_text(FLAT)
    columns = {
        "x": [0.0, 1.0, 2.5], "v": [1.0, 1.5, 0.0], "next.x": [1.0, 2.5, 2.5],
        "next.v": [1.5, 0.0, 0.0], "reward": [0.5, 0.25, 0.0], "extra": [1, 2, 3],
        "terminated": [False, False, True], "truncated": [False, True, False],
    }  # fmt: skip
    (tmp_path / "data").mkdir()
    for name, chosen in (("a", slice(0, 2)), ("b", slice(2, 3))):
        made = pa.table({key: values[chosen] for key, values in columns.items()})
        pq.write_table(made, tmp_path / "data" / f"{name}.parquet")
    reward = sfol.RewardFunction(tmp_path / "flat.yaml")
    labelled = label(tmp_path / "data", tmp_path / "out", reward)
    assert len(labelled.parts) == 2
    assert read(labelled).column("rule_reward").to_pylist() == [101.5, 1200.75, 310.0]


KILLED = """\
    import os, signal, sys
    from pathlib import Path
    import sfol
    from sfol.tools.label import label
    data, folder, rules = map(Path, sys.argv[1:])

    def on_rows(done, rows):
        if done >= 450:  # in the midst of the third part
            os.kill(os.getpid(), signal.SIGKILL)

    label(data, folder, sfol.RewardFunction(rules), part_rows=200, on_rows=on_rows)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no such signal on Windows")
def test_who_was_killed_goes_on_without_loss_or_doubles(tmp_path, hall, data):
    folder = tmp_path / "out"
    code = textwrap.dedent(KILLED)
    batches = "import sfol.tools.label_parquet as module; module.BATCH_ROWS = 50\n"
    killed = subprocess.run(
        [sys.executable, "-c", batches + code, data, folder, tmp_path / "hall.yaml"], check=False
    )
    assert killed.returncode == -signal.SIGKILL
    there = {path.name: path.stat().st_ino for path in folder.glob("part-*.parquet")}
    assert [*sorted(there)] == ["part-00000.parquet", "part-00001.parquet"]
    assert [*folder.glob("*.part")]  # what it was at
    labelled = label(data, folder, hall, part_rows=200)
    assert (labelled.rows, labelled.new_rows, len(labelled.parts)) == (ROWS, 600, 5)
    assert {name: (folder / name).stat().st_ino for name in there} == there  # not made again
    assert sorted(os.listdir(folder)) == [ABOUT, *(f"part-0000{i}.parquet" for i in range(5))]
    whole = read(label(data, tmp_path / "whole", hall, part_rows=ROWS))
    assert read(labelled).combine_chunks() == whole.combine_chunks()
    assert label(data, folder, hall, part_rows=200).new_rows == 0


def test_labels_of_other_rules_or_data_are_kept_apart(tmp_path, hall, data):
    label(data, tmp_path / "out", hall)
    hall.coefficients["care"]["careful"] = 0.5
    with pytest.raises(UsageError, match="labels of other data or of other rules"):
        label(data, tmp_path / "out", hall)
    hall.coefficients["care"]["careful"] = 1.0
    pq.write_table(table(steps(seed=1)), data)
    with pytest.raises(UsageError, match="labels of other data or of other rules"):
        label(data, tmp_path / "out", hall)
    (tmp_path / "out" / ABOUT).unlink()
    with pytest.raises(UsageError, match="says what they are of"):
        label(data, tmp_path / "out", hall)


def nothing(made):
    return made.set_column(1, "observation", pa.nulls(len(made), pa.list_(pa.float64())))


def ragged(made):
    lists = [[1.0]] * (len(made) - 1) + [[1.0, 2.0]]
    return made.set_column(2, "action", pa.array(lists))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda made: made.drop_columns("action"), r"rows 0 to 999 .* the action is not given"),
        (lambda made: made.append_column("reward_haste", made.column(0)), "'reward_haste' already"),
        (lambda made: made.set_column(2, "action", pa.array(["x"] * ROWS)), "of string"),
        (nothing, "'observation' has rows without a value"),
        (ragged, "different lengths: 1 to 2"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, hall, data, change, message):
    pq.write_table(change(pq.read_table(data)), data)
    with pytest.raises(SfolError, match=message):
        label(data, tmp_path / "out", hall)
    assert not [*(tmp_path / "out").glob("part-*")]


def test_what_can_not_be_read_is_said(tmp_path, hall):
    (tmp_path / "none.parquet").write_bytes(b"PAR1 nothing PAR1")
    with pytest.raises(FileError, match="the data can't be read"):
        label(tmp_path / "none.parquet", tmp_path / "out", hall)
    with pytest.raises(FileError, match="No such file"):
        label(tmp_path / "missing.parquet", tmp_path / "out", hall)
    with pytest.raises(UsageError, match="a path"):
        label(3, tmp_path / "out", hall)
    with pytest.raises(UsageError, match="the reward"):
        label(tmp_path / "none.parquet", tmp_path / "out", "aeb")
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match="no Parquet file"):
        label(tmp_path / "empty", tmp_path / "out", hall)


def test_the_command(tmp_path, hall, data):
    arguments = ("label", data, "--rules", tmp_path / "hall.yaml", "--part-rows", 400)
    done = command(*arguments)
    assert done.code == 0
    assert "1000 rows in 3 parts; 1000 of them labelled now" in done.out
    folder = tmp_path / "steps.labelled"
    assert json.loads((folder / ABOUT).read_text())["hash"] == hall.hash
    assert "0 of them labelled now" in command(*arguments).out
    again = command("label", data, "--rules", "aeb_state")
    assert again.code == 2
    assert "other rules" in again.err


def test_rules_over_time_are_refused_before_anything_is_written(tmp_path, data):
    (tmp_path / "hall.yaml").write_text(HALL)
    (tmp_path / "later.yaml").write_text(
        "version: 1\nname: later\nextends: hall\nrules:\n"
        "  again: again(X) :- previously(again(X)).\n"
        "weights:\n  again: {normalizer: 1, coefficients: {again: 1}}\n"
    )
    with pytest.raises(UsageError, match="'later' has rules over time"):
        label(data, tmp_path / "labels", sfol.RewardFunction(tmp_path / "later.yaml"))
    assert not (tmp_path / "labels").exists()
