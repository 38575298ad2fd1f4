"""Logs: what was recorded comes back, to the last bit, or the error says why not."""

import json
import math
import os
import subprocess
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sfol
from sfol import Facts, KnowledgeBase
from sfol.errors import MissingExtraError, UsageError
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
                log.step(facts, time=step / 10, v=6.0 + step, d=math.inf)
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
            log.step(facts, time=0.1, **signals)
    (episode,) = read_log(path).episodes
    assert episode.ending is None
    for step, scene in zip(episode.steps, scenes, strict=True):
        assert {(a.predicate, *a.arguments): tuple(b) for a, b in step.facts.items()} == scene
        assert step.signals == signals


def test_facts_are_recorded_as_they_are_now(tmp_path, aeb):
    facts = Facts()
    with LogWriter(tmp_path / "x.parquet", aeb) as log:
        log.step(facts, time=0.0)
        facts.add("Vehicle", "v1")
        log.step(facts, time=0.1)
    (episode,) = read_log(tmp_path / "x.parquet").episodes
    assert [len(step.facts) for step in episode.steps] == [0, 1]


def test_the_file_appears_when_it_is_whole(tmp_path, aeb):
    path = tmp_path / "x.parquet"
    log = LogWriter(path, aeb)
    log.step(Facts(), time=0.0)
    assert [name.endswith(".part") for name in os.listdir(tmp_path)] == [True]
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
            log.step(Facts.parse(scene), time=step / 10, v=step * 0.1)
    assert path.stat().st_size < 200 * len(scene) / 10


def test_foreign_newer_and_broken_files(tmp_path, aeb):
    path = tmp_path / "x.parquet"

    def error():
        with pytest.raises(LogError) as caught:
            read_log(path)
        assert caught.value.place.file == str(path)
        return str(caught.value)

    assert "can't be read: No such file" in error()
    path.write_text("hello, hello, hello, hello")
    assert "no Parquet file" in error()
    pq.write_table(pa.table({"a": [1]}), path)
    assert "no log of sfol" in error()
    write(path, aeb)
    table = pq.read_table(path)
    about = json.loads(table.schema.metadata[b"sfol"])
    newer = {b"sfol": json.dumps({**about, "version": LOG_VERSION + 1, "sfol": "9.0"})}
    pq.write_table(table.replace_schema_metadata(newer), path)
    assert "written by sfol 9.0; this one reads up to 1 (update sfol)" in error()
    pq.write_table(table.drop_columns(["facts"]), path)
    assert "damaged: it has no column 'facts'" in error()
    rows = table.to_pylist()
    rows[0]["facts"][0]["lower"] = 2.0
    pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), path)
    assert "damaged: Pedestrian(p0) has the bound [2.0" in error()


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
