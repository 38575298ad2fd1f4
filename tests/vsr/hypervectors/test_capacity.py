import json
import sys

import numpy as np
import pytest

from sfol.errors import MissingExtraError, UsageError
from vsr.classes import SemanticClass
from vsr.entities import Direction
from vsr.hypervectors import capacity
from vsr.hypervectors.capacity import Cell, Share, compare, draw_scene, expectation, measure
from vsr.hypervectors.decoding import DecodedEntity, template_count

PERSON, CAR = SemanticClass.PEDESTRIAN, SemanticClass.VEHICLE


def test_scenes_are_drawn_as_promised():
    entities, layout = draw_scene(np.random.default_rng(0), 50)
    assert len(entities) == len(layout.names) == 50
    beside = layout.neighbours.sum(axis=(1, 2))
    assert set(beside) == {1, 2, 3}
    assert {entity.kind for entity in entities} == set(capacity.SIZES)
    for entity, covered in zip(entities, layout.coverage, strict=True):
        top, left, bottom, right = entity.box
        assert 0 <= top < bottom <= 224
        assert 0 <= left < right <= 224
        assert covered.sum() * 196 == pytest.approx(entity.area, rel=1e-3)
    for kind in capacity.SIZES:
        taken = np.zeros((224, 224), int)
        for entity in entities:
            taken[entity.box.area] += entity.kind is kind
        assert taken.max() == 1


def test_scenes_that_are_too_full_are_refused(monkeypatch):
    monkeypatch.setattr(capacity, "_DRAWS", 1)
    with pytest.raises(UsageError, match="200 entities find no place"):
        draw_scene(np.random.default_rng(0), 200)


def read(entity, neighbours=(), kind=None, shift: int = 0) -> DecodedEntity:
    """What a decoder would read of an entity, perhaps with an error."""
    coverage = np.zeros((16, 16), np.float32)
    row, column = (int(16 * middle / 224) for middle in entity.centre)
    coverage[row, (column + shift) % 16] = 1.0
    return DecodedEntity(kind or entity.kind, frozenset(neighbours), coverage, 20.0)


def test_what_is_read_is_compared_by_place_then_class_then_neighbours():
    (entity,), _ = draw_scene(np.random.default_rng(3), 1)
    other = PERSON if entity.kind is not PERSON else CAR
    beside = {(SemanticClass.ROAD, Direction.BELOW_OF)}
    neighbours = np.zeros((1, 6, 3), bool)
    neighbours[0, 3, 2] = True

    def outcome(*decoded):
        return compare([entity], neighbours, decoded)[0].tolist()

    assert outcome(read(entity, beside)) == [True, True, True]
    assert outcome(read(entity)) == [True, True, False]
    assert outcome(read(entity, beside, kind=other)) == [True, False, False]
    assert outcome(read(entity, beside, shift=3)) == [False, False, False]
    assert outcome() == [False, False, False]
    assert outcome(read(entity, kind=other), read(entity, beside)) == [True, True, True]


def test_one_decoded_entity_counts_once():
    (entity,), layout = draw_scene(np.random.default_rng(3), 1)
    twice = np.repeat(layout.neighbours, 2, axis=0)
    assert compare([entity, entity], twice, [read(entity)])[:, 0].sum() == 1


def test_few_entities_in_many_dimensions_are_all_read():
    cell = measure(dimension=4096, entities=3, scenes=2)
    everything = Share(1.0, 1.0, 1.0)
    assert (cell.alone, cell.bundle, cell.spurious) == (everything, everything, 0.0)
    assert cell == measure(dimension=4096, entities=3, scenes=2)


def test_many_entities_in_few_dimensions_are_lost_in_the_bundle_but_not_alone():
    cell = measure(dimension=512, entities=15, scenes=1)
    assert cell.alone.place == 1.0
    assert cell.bundle.neighbours < 0.3
    assert cell.expected[0] < 0.1


def test_theory_expects_more_of_more_dimensions_and_of_fewer_entities():
    rng = np.random.default_rng(0)
    few, many = (draw_scene(rng, count)[1] for count in (5, 30))
    by_dimension = [expectation(d, many) for d in (512, 2048, 8192, 32768)]
    assert by_dimension == sorted(by_dimension)
    assert all(0.0 <= low <= high + 1e-9 <= 1.0 + 1e-6 for low, high in by_dimension)
    assert expectation(2048, few) > expectation(2048, many)
    assert expectation(32768, few) == pytest.approx((1.0, 1.0), abs=1e-3)


def test_the_chance_of_the_best_of_all_is_as_drawn():
    rng, templates = np.random.default_rng(0), 1000
    others = rng.standard_normal((4000, templates - 1)).max(axis=1)
    for mean in (0.0, 2.0, 3.5):
        drawn = (mean + rng.standard_normal(4000) > others).mean()
        chance = capacity._chance_of_best(np.array(mean), templates)
        assert chance == pytest.approx(drawn, abs=0.03)
    assert capacity._chance_of_best(np.array(0.0), 2) == pytest.approx(0.5, abs=1e-6)
    assert template_count(capacity.MOST_NEIGHBOURS) > 1e7


@pytest.fixture
def project(tmp_path, monkeypatch):
    monkeypatch.setattr(capacity, "COUNTS", (1, 2))
    (tmp_path / capacity.PAGE).parent.mkdir(parents=True)
    (tmp_path / capacity.PAGE).write_text(
        f"above\n{capacity._BEGIN}\nold\n{capacity._END}\nbelow\n"
    )
    return tmp_path


def run(project, **options):
    capacity.study(project, dimensions=[512], entities=2, **options)


def test_the_study_writes_numbers_plot_and_table_and_goes_on_where_it_was(project, monkeypatch):
    run(project)
    results = project / capacity.RESULTS
    study = json.loads(results.read_text())
    assert [(c["dimension"], c["entities"], c["scenes"]) for c in study["cells"]] == [
        (512, 1, 2),
        (512, 2, 1),
    ]
    page = (project / capacity.PAGE).read_text()
    assert page.startswith("above\n")
    assert page.endswith("below\n")
    assert "old" not in page
    assert page.count("| 512 |") == 2
    assert (project / capacity.PICTURE).read_bytes().startswith(b"\x89PNG")

    del study["cells"][1]
    results.write_text(json.dumps(study))
    measured = []
    monkeypatch.setattr(
        capacity, "measure", lambda *key, **rest: measured.append(key) or measure(*key, **rest)
    )
    run(project)
    assert measured == [(512, 2)]
    run(project, seed=1)
    assert measured[1:] == [(512, 1), (512, 2)]


def test_a_page_without_marks_is_refused(project):
    (project / capacity.PAGE).write_text("no marks")
    with pytest.raises(UsageError, match="has no place for the table"):
        run(project)


def test_without_matplotlib_the_extra_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"sfol\[plot\]"):
        capacity.plot([], tmp_path / "plot.png")


def test_the_page_shows_the_committed_numbers():
    root = capacity.Path(__file__).parents[3]
    study = json.loads((root / capacity.RESULTS).read_text())
    cells = capacity.read(root / capacity.RESULTS, study["settings"])
    assert capacity.table(cells) in (root / capacity.PAGE).read_text()
    assert all(isinstance(cell, Cell) for cell in cells)
    assert (root / capacity.PICTURE).stat().st_size < 300_000
