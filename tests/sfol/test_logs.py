"""Logs: what was recorded comes back, to the last bit, or the error says why not."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sfol
from sfol import Facts, KnowledgeBase
from sfol.errors import MissingExtraError, SignalError, UsageError
from sfol.logs import LOG_VERSION, LogError, LogWriter, read_log

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")


@pytest.fixture(scope="module")
def aeb():
    return KnowledgeBase.load("aeb")


def write(path, kb, endings=("success",)):
    with LogWriter(path, kb) as log:
        for number, ending in enumerate(endings):
            for step in range(3):
                facts = Facts.parse(f"Pedestrian(p{number}): 0.{step}1. NoCrosswalk(ego).")
                log.step(facts, step / 10, v=6.0 + step, d=math.inf)
            log.end_episode(ending)


def write_nothing(log):
    log.end_episode("success")


def test_a_log_comes_back(tmp_path, aeb):
    path = tmp_path / "a.parquet"
    write(path, aeb, ("success", "collision", None))
    log = read_log(path)
    assert (log.name, log.hash, log.sfol_version) == ("aeb", aeb.hash, sfol.__version__)
    assert [episode.ending for episode in log.episodes] == ["success", "collision", None]
    assert [episode.number for episode in log.episodes] == [0, 1, 2]
    step = log.episodes[1].steps[2]
    assert step.time == 0.2
    assert step.signals == {"v": 8.0, "d": math.inf}
    assert step.facts == Facts.parse("Pedestrian(p1): 0.21. NoCrosswalk(ego).")


bounds = st.tuples(st.floats(0, 1), st.floats(0, 1)).map(sorted).map(tuple)
atoms = st.sampled_from([("P", "a"), ("P", "b"), ("Q", "a", "b"), ("Q", "b", "a")])


@settings(max_examples=25)
@given(
    st.lists(st.dictionaries(atoms, bounds), min_size=1, max_size=4),
    st.dictionaries(st.sampled_from(["v", "d", "é"]), st.floats(allow_nan=False)),
)
def test_every_bit_comes_back(tmp_path_factory, scenes, signals):
    path = tmp_path_factory.mktemp("log") / "x.parquet"
    with LogWriter(path, KnowledgeBase.load("aeb")) as log:
        for scene in scenes:
            facts = Facts()
            for atom, bound in scene.items():
                facts.add(*atom, bound=bound)
            log.step(facts, 0.1, **signals)
    (episode,) = read_log(path).episodes
    assert episode.ending is None
    for step, scene in zip(episode.steps, scenes, strict=True):
        assert {(a.predicate, *a.arguments): tuple(b) for a, b in step.facts.items()} == scene
        assert step.signals == signals


def test_facts_are_recorded_as_they_are_now(tmp_path, aeb):
    facts = Facts()
    with LogWriter(tmp_path / "x.parquet", aeb) as log:
        log.step(facts, 0.0)
        facts.add("Vehicle", "v1")
        log.step(facts, 0.1)
    (episode,) = read_log(tmp_path / "x.parquet").episodes
    assert [len(step.facts) for step in episode.steps] == [0, 1]


def test_the_file_appears_when_it_is_whole(tmp_path, aeb):
    path = tmp_path / "x.parquet"
    log = LogWriter(path, aeb)
    log.step(Facts(), 0.0)
    assert {Path(name).suffix for name in os.listdir(tmp_path)} == {".part", ".lock"}
    log.close()
    assert os.listdir(tmp_path) == ["x.parquet"]


def test_an_exception_leaves_the_old_file_and_no_part(tmp_path, aeb):
    path = tmp_path / "x.parquet"
    write(path, aeb)
    old = path.read_bytes()
    with pytest.raises(UsageError), LogWriter(path, aeb) as log:
        write_nothing(log)
    assert os.listdir(tmp_path) == ["x.parquet"]
    assert path.read_bytes() == old


def test_folders_are_made_and_what_is_no_folder_is_an_error(tmp_path, aeb):
    write(tmp_path / "new" / "x.parquet", aeb)
    assert len(read_log(tmp_path / "new" / "x.parquet").episodes) == 1
    with pytest.raises(UsageError, match="can't be written"):
        LogWriter(tmp_path / "new" / "x.parquet" / "y.parquet", aeb)
    with pytest.raises(UsageError, match="can't be written"):
        write(tmp_path / "new", aeb)
    assert os.listdir(tmp_path) == ["new"]


def test_an_episode_needs_a_step(tmp_path, aeb):
    with pytest.raises(UsageError, match="without a step"), LogWriter(tmp_path / "x", aeb) as log:
        write_nothing(log)
    assert os.listdir(tmp_path) == []


def test_it_is_compact(tmp_path, aeb):
    scene = " ".join(f"Pedestrian(p{i}): 0.{i + 10}. OnRoad(p{i})." for i in range(20))
    path = tmp_path / "x.parquet"
    with LogWriter(path, aeb) as log:
        for step in range(200):
            log.step(Facts.parse(scene), step / 10, v=step * 0.1)
    assert path.stat().st_size < 200 * len(scene) / 10


def test_foreign_newer_and_broken_files(tmp_path, aeb):
    path = tmp_path / "x.parquet"

    def error(**how):
        with pytest.raises(LogError) as caught:
            read_log(path, **how)
        assert caught.value.place.file == str(path)
        return str(caught.value)

    assert "can't be read: No such file" in error()
    path.write_text("hello, hello, hello, hello")
    assert "no Parquet file" in error()
    pq.write_table(pa.table({"a": [1]}), path)
    assert "no log of sfol" in error()
    assert "no log of sfol" in error(foreign=True)
    write(path, aeb)
    table = pq.read_table(path)
    about = json.loads(table.schema.metadata[b"sfol"])
    newer = {b"sfol": json.dumps({**about, "version": LOG_VERSION + 1, "sfol": "9.0"})}
    pq.write_table(table.replace_schema_metadata(newer), path)
    assert "written by sfol 9.0; this one reads up to 2 (update sfol)" in error(foreign=True)
    pq.write_table(table.drop_columns(["facts"]), path)
    assert "damaged: it has no column 'facts'" in error(foreign=True)


# -- damage ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def whole(tmp_path_factory, aeb):
    path = tmp_path_factory.mktemp("whole") / "x.parquet"
    write(path, aeb, ("success", "collision"))
    return path


def read_changed(whole, path, content, *, foreign=False):
    """Return the log of changed bytes, which is the whole one, or the error that says where."""
    path.write_bytes(content)
    try:
        found = read_log(path, foreign=foreign)
    except LogError as error:
        found = error
    if isinstance(found, LogError):
        assert found.place.file == str(path)
        assert found.suggestion
    else:
        assert found == read_log(whole)
    return found


@settings(max_examples=200)
@given(st.data())
def test_changed_bytes_are_found_or_change_nothing(whole, tmp_path_factory, data):
    content = bytearray(whole.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    read_changed(whole, tmp_path_factory.getbasetemp() / "changed.parquet", content)


@pytest.mark.parametrize("kept", [0, 1, 4, 8, 0.3, 0.6, 0.99])
def test_a_log_that_is_cut_off_is_found(whole, tmp_path, kept):
    content = whole.read_bytes()
    cut = content[: kept if isinstance(kept, int) else int(kept * len(content))]
    assert isinstance(read_changed(whole, tmp_path / "x.parquet", cut), LogError)


def rewritten(whole, path, rows, schema=None, **metadata):
    """Write rows as another program would, which knows nothing of the digest."""
    table = pq.read_table(whole)
    schema = schema or table.schema
    about = json.loads(table.schema.metadata[b"sfol"]) | metadata
    schema = schema.with_metadata({b"sfol": json.dumps(about)})
    pq.write_table(pa.Table.from_pylist(rows, schema=schema), path)


def test_a_log_that_another_program_wrote_again_is_read_if_asked_for(whole, tmp_path):
    rewritten(whole, tmp_path / "x.parquet", pq.read_table(whole).to_pylist())
    assert read_log(tmp_path / "x.parquet", foreign=True) == read_log(whole)
    with pytest.raises(LogError, match=r"no digest: .* \(.*foreign=True\)"):
        read_log(tmp_path / "x.parquet")


def set_in(*path):
    *above, last = path[:-1]
    value = path[-1]

    def change(rows):
        part = rows
        for key in above:
            part = part[key]
        part[last] = value

    return change


ROWS = [
    (set_in(4, "facts", 0, "lower", 2.0), "row 4 of the log is damaged: Pedestrian(p1) has the bou"),
    (set_in(4, "facts", 0, "lower", math.nan), "row 4 of the log is damaged: Pedestrian(p1) has"),
    (set_in(1, "facts", 0, "atom", "Pedestrian(X)"), "row 1 of the log is damaged: the fact"),
    (set_in(1, "facts", 0, "atom", "P p"), "row 1 of the log is damaged: the end is expected"),
    (set_in(1, "facts", 0, "atom", "NoCrosswalk(ego, ego)"), "1 constants here and 2 elsewhere"),
    (set_in(1, "facts", 0, "atom", None), "row 1 of the log is damaged: a fact has no atom"),
    (set_in(1, "facts", 0, "upper", None), "row 1 of the log is damaged: a fact has no atom"),
    (set_in(1, "facts", 0, None), "row 1 of the log is damaged: a fact has no atom"),
    (set_in(1, "facts", None), "row 1 of the log is damaged: it has no facts"),
    (set_in(1, "signals", None), "row 1 of the log is damaged: it has no signals"),
    (set_in(1, "signals", [("v", None)]), "row 1 of the log is damaged: its signal 'v' is None"),
    (set_in(1, "signals", [("v", math.nan)]), "row 1 of the log is damaged: its signal 'v' is nan"),
    (set_in(1, "signals", [("v", 1.0), ("v", 2.0)]), "row 1 of the log is damaged: a signal stands"),
    (set_in(5, "time", None), "row 5 of the log is damaged: it has no time"),
    (set_in(5, "time", math.nan), "row 5 of the log is damaged: its time is NaN"),
    (set_in(0, "episode", None), "row 0 of the log is damaged: it has no episode"),
    (set_in(0, "episode", 1), "row 0 of the log is damaged: it is step 0 of episode 1, which is out"),
    (set_in(2, "step", 1), "row 2 of the log is damaged: it is step 1 of episode 0, which is out"),
    (set_in(2, "ending", None), "row 2 of the log is damaged: its ending is not that of"),
    (list.reverse, "row 0 of the log is damaged: it is step 2 of episode 1, which is out of order"),
    (lambda rows: rows.extend(rows[:1]), "row 6 of the log is damaged: it is step 0 of episode 0"),
    (lambda rows: rows.pop(1), "row 1 of the log is damaged: it is step 2 of episode 0"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "message"), ROWS)
def test_a_damaged_row_is_named(whole, tmp_path, change, message):
    rows = pq.read_table(whole).to_pylist()
    change(rows)
    path = tmp_path / "x.parquet"
    rewritten(whole, path, rows)
    assert message in str(read_changed(whole, path, path.read_bytes(), foreign=True))


@settings(max_examples=25)
@given(st.randoms(use_true_random=False))
def test_shuffled_rows_are_found(whole, tmp_path_factory, chance):
    rows = pq.read_table(whole).to_pylist()
    chance.shuffle(rows)
    path = tmp_path_factory.getbasetemp() / "shuffled.parquet"
    rewritten(whole, path, rows)
    found = read_changed(whole, path, path.read_bytes())
    assert isinstance(found, LogError) or rows == pq.read_table(whole).to_pylist()


@pytest.mark.parametrize(
    ("metadata", "message"),
    [
        ("no JSON", "they are no JSON"),
        ("[" * 100_000, "they are no JSON"),
        ("[]", "they are no JSON"),
        ('{"version": 1, "sfol": "0.1.0", "name": "aeb"}', "'hash' is missing or wrong"),
        ('{"version": "1", "sfol": "0.1.0", "name": "aeb", "hash": ""}', "'version' is missing or"),
        ('{"version": 1, "sfol": "0.1.0", "name": ["aeb"], "hash": ""}', "'name' is missing or"),
    ],
)
def test_damaged_metadata_are_found(whole, tmp_path, metadata, message):
    table = pq.read_table(whole).replace_schema_metadata({b"sfol": metadata})
    path = tmp_path / "x.parquet"
    pq.write_table(table, path)
    assert message in str(read_changed(whole, path, path.read_bytes(), foreign=True))


@pytest.mark.parametrize("column", ["episode", "step", "time", "facts", "signals", "ending"])
def test_columns_of_another_type_are_found(whole, tmp_path, column):
    table = pq.read_table(whole)
    index = table.schema.get_field_index(column)
    texts = pa.array([str(value) for value in table[column].to_pylist()])
    path = tmp_path / "x.parquet"
    for changed, message in (
        (table.set_column(index, column, texts), f"its column '{column}' has the type string, not"),
        (table.append_column(column, texts), f"it has two columns '{column}'"),
        (table.drop_columns([column]), f"it has no column '{column}'"),
    ):
        pq.write_table(changed, path)
        assert message in str(read_changed(whole, path, path.read_bytes(), foreign=True))


def test_a_log_that_is_too_long_is_not_read(whole, tmp_path, monkeypatch):
    assert len(read_log(whole, maximum_rows=6).episodes) == 2
    monkeypatch.setattr(pq.ParquetFile, "read_row_group", None)
    with pytest.raises(LogError, match=r"more than 5 rows.*several logs"):
        read_log(whole, maximum_rows=5)
    rows = pq.read_table(whole).to_pylist()
    for change, message in (
        (set_in(5, "facts", rows[5]["facts"] * 100), "more than 120 facts or signals"),
        (set_in(5, "facts", 0, "atom", "P" * 20_000), "more than 12000 bytes"),
    ):
        rows = pq.read_table(whole).to_pylist()
        change(rows)
        rewritten(whole, tmp_path / "x.parquet", rows)
        with pytest.raises(LogError, match=message):
            read_log(tmp_path / "x.parquet", maximum_rows=6, foreign=True)


# -- what can't be logged -------------------------------------------------------------------------


@pytest.mark.parametrize("value", [math.nan, "6.0", None, [1.0], 10**400])
@pytest.mark.parametrize("name", ["v", "time"])
def test_what_is_no_number_is_refused(tmp_path, aeb, value, name):
    with LogWriter(tmp_path / "x.parquet", aeb) as log:
        with pytest.raises(SignalError, match=f"'{name}' is .*, which is no number"):
            log.step(Facts(), value, v=1.0) if name == "time" else log.step(Facts(), 0.0, v=value)
        log.step(Facts(), 0.0, v=1.0)
    ((step,),) = [episode.steps for episode in read_log(tmp_path / "x.parquet").episodes]
    assert step.signals == {"v": 1.0}


def test_a_signal_may_have_any_name(tmp_path, aeb):
    signals = {"time": 3.0, "facts": 1.0, "self": 2.0}
    with LogWriter(tmp_path / "x.parquet", aeb) as log:
        log.step(Facts(), 0.5, **signals)
    ((step,),) = [episode.steps for episode in read_log(tmp_path / "x.parquet").episodes]
    assert (step.time, step.signals) == (0.5, signals)


@pytest.mark.parametrize("ending", [5, "a\ud800", b"\xff", ["success"]])
def test_an_ending_that_is_no_text_is_refused(tmp_path, aeb, ending):
    with LogWriter(tmp_path / "x.parquet", aeb) as log:
        log.step(Facts(), 0.0)
        with pytest.raises(UsageError, match="can't be written"):
            log.end_episode(ending)
    assert [e.ending for e in read_log(tmp_path / "x.parquet").episodes] == [None]


def test_a_closed_log_is_closed(tmp_path, aeb):
    log = LogWriter(tmp_path / "x.parquet", aeb)
    log.step(Facts(), 0.0)
    log.close()
    log.close()
    with pytest.raises(UsageError, match="is closed"):
        log.step(Facts(), 0.1)
    with pytest.raises(UsageError, match="is closed"):
        log.end_episode("success")
    assert len(read_log(tmp_path / "x.parquet").episodes) == 1


def test_a_second_writer_is_refused(tmp_path, aeb):
    path = tmp_path / "x.parquet"
    with LogWriter(path, aeb) as first:
        with pytest.raises(UsageError, match=f"is in use by process {os.getpid()} since 20"):
            LogWriter(path, aeb)
        first.step(Facts(), 0.0)
    assert len(read_log(path).episodes) == 1
    write(path, aeb)
    assert os.listdir(tmp_path) == ["x.parquet"]


def test_without_pyarrow_the_error_names_the_extra(tmp_path, aeb, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingExtraError, match=r"sfol\[parquet\]"):
        LogWriter(tmp_path / "x.parquet", aeb)
    with pytest.raises(MissingExtraError, match=r"sfol\[parquet\]"):
        read_log(tmp_path / "x.parquet")


def test_the_module_is_light():
    code = "import sfol.logs, sfol.tools.graph, sfol.cli, sys; print({'pyarrow', 'networkx', 'matplotlib'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
