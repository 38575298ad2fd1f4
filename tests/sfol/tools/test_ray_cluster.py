"""Parts that a Ray cluster labels are those that one process labels."""

import sys

import numpy as np
import pytest

import sfol
from sfol.errors import MissingExtraError, SfolError, UsageError
from sfol.tools.label import label
from sfol.tools.ray_cluster import on_ray
from tests.sfol.hall import HALL
from tests.sfol.tools.test_label import GROUP, ROWS, steps, table

pq = pytest.importorskip("pyarrow.parquet")


def test_without_ray_an_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match="ray"):
        list(on_ray(abs, [1], "local"))


@pytest.fixture
def hall(tmp_path):
    pytest.importorskip("ray", reason="a Ray cluster needs the extra ray")
    (tmp_path / "hall.yaml").write_text(HALL)
    return sfol.RewardFunction(tmp_path / "hall.yaml")


def test_labels_are_the_same(tmp_path, hall):
    data = tmp_path / "steps.parquet"
    pq.write_table(table(steps()), data, row_group_size=GROUP)
    alone = label(data, tmp_path / "alone", hall, part_rows=GROUP)
    told = []
    folder = tmp_path / "shared"
    shared = label(
        data, folder, hall, part_rows=GROUP, ray="local", on_rows=lambda *rows: told.append(rows)
    )
    assert told == [(done, ROWS) for done in range(0, ROWS + 1, GROUP)]
    assert shared.new_rows == ROWS
    assert [p.read_bytes() for p in shared.parts] == [p.read_bytes() for p in alone.parts]
    shared.parts[3].unlink()
    assert label(data, folder, hall, part_rows=GROUP, ray="local").new_rows == GROUP
    assert shared.parts[3].read_bytes() == alone.parts[3].read_bytes()


def test_an_error_of_a_part_is_told_as_anywhere(tmp_path, hall):
    parts = steps()
    parts[0]["body"]["state"][ROWS // 2] = np.nan
    data = tmp_path / "steps.parquet"
    pq.write_table(table(parts), data, row_group_size=GROUP)
    with pytest.raises(SfolError) as alone:
        label(data, tmp_path / "alone", hall, part_rows=GROUP)
    with pytest.raises(SfolError) as shared:
        label(data.resolve(), tmp_path / "shared", hall, part_rows=GROUP, ray="local")
    assert str(shared.value) == str(alone.value)


@pytest.mark.usefixtures("hall")
def test_what_no_cluster_can_do_is_refused():
    with pytest.raises(UsageError, match="no Ray cluster at 'nowhere'"):
        list(on_ray(abs, [1], "nowhere"))
    with pytest.raises(UsageError, match="needs 1000 processors"):
        list(on_ray(abs, [1], "local", processors=1000))
