import dataclasses

import pytest
import torch
from safetensors.torch import save_file

from sfol.errors import UsageError
from vsr.classes import DESCRIPTOR_CLASSES
from vsr.hypervectors.codebook import CELL_NAMES, CLASS_NAMES, DIRECTION_NAMES, Codebook

# If these change, so does every descriptor and every policy trained on it: raise VERSION.
PINNED_PEDESTRIAN = [0.014051712118089199, 0.002891950076445937, 0.011779353953897953]
PINNED_CELL = [0.006789244245737791, 0.016610072925686836]
PINNED_TOTAL = -2.6596192768461293
PINNED_DIGEST = "1f6851b5e3ec11f28ff6e45b20250cc1fae1e4d85edbaa4a4dd9af8a4d23348d"


def test_shapes_and_statistics():
    book = Codebook()
    assert book.classes.shape == (len(DESCRIPTOR_CLASSES), 2048)
    assert book.directions.shape == (3, 2048)
    assert book.cells.shape == (16, 16, 2048)
    assert book.cells.dtype == torch.float32
    assert book.cells.var().item() == pytest.approx(1 / 2048, rel=0.01)
    assert book.cells.mean().item() == pytest.approx(0, abs=1e-4)


def test_the_vectors_are_the_same_on_every_machine():
    book = Codebook()
    assert book.classes[0, :3].tolist() == pytest.approx(PINNED_PEDESTRIAN, abs=1e-8)
    assert book.cells[9, 8, -2:].tolist() == pytest.approx(PINNED_CELL, abs=1e-8)
    total = sum(part.double().sum() for part in (book.classes, book.directions, book.cells))
    assert total.item() == pytest.approx(PINNED_TOTAL, abs=1e-6)


def test_the_digest_is_of_all_vectors():
    assert Codebook().digest == PINNED_DIGEST
    assert Codebook(seed=1).digest != PINNED_DIGEST


def test_symbols_depend_on_seed_and_name_alone():
    assert torch.equal(Codebook(seed=3).classes, Codebook(seed=3).classes)
    assert not torch.equal(Codebook(seed=3).classes, Codebook(seed=4).classes)
    book = Codebook(seed=3)
    assert torch.equal(book.symbol("class/truck"), book.classes[2])
    assert torch.equal(book.symbol("direction/below_of"), book.directions[2])
    assert torch.equal(book.symbol("cell/9/8"), book.cells[9, 8])


def test_unitary_symbols_have_flat_spectra():
    book = Codebook(dimension=64, unitary=True)
    magnitudes = torch.fft.rfft(book.cells).abs()
    assert torch.allclose(magnitudes, torch.ones_like(magnitudes), atol=1e-5)


def test_a_codebook_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Codebook().seed = 1
    with pytest.raises(UsageError, match="dimension"):
        Codebook(dimension=0)


@pytest.mark.parametrize("book", [Codebook(33, seed=5), Codebook(32, unitary=True)])
def test_what_is_saved_is_loaded(book, tmp_path):
    book.save(tmp_path / "book.safetensors")
    loaded = Codebook.load(tmp_path / "book.safetensors")
    assert loaded == book
    assert loaded.digest == book.digest
    assert torch.equal(loaded.symbol("cell/3/4"), book.cells[3, 4])


def test_codebooks_of_other_versions_come_from_files_alone(tmp_path):
    path = tmp_path / "old.safetensors"
    vectors = {name: torch.randn(8) for name in (*CLASS_NAMES, *DIRECTION_NAMES, *CELL_NAMES)}
    save_file(vectors, path, {"version": "0", "seed": "7", "unitary": "0"})
    loaded = Codebook.load(path)
    assert (loaded.version, loaded.seed, loaded.dimension) == (0, 7, 8)
    assert torch.equal(loaded.classes[2], vectors["class/truck"])
    loaded.save(path)
    assert Codebook.load(path).digest == loaded.digest
    with pytest.raises(UsageError, match="version 0 cannot be drawn"):
        Codebook(version=0)


def a_book(**changes):
    return {name: torch.ones(8) for name in (*CLASS_NAMES, *DIRECTION_NAMES, *CELL_NAMES)} | changes


METADATA = {"version": "1", "seed": "0", "unitary": "0"}


@pytest.mark.parametrize(
    ("vectors", "metadata"),
    [
        ({"class/truck": torch.ones(8)}, METADATA),
        (a_book(), {"version": "1"}),
        (a_book(), METADATA | {"seed": "first"}),
        (a_book(**{"cell/0/0": torch.ones(9)}), METADATA),
        (a_book(**{"cell/0/0": torch.ones(2, 4)}), METADATA),
        ({name: torch.ones(2, 4) for name in a_book()}, METADATA),
    ],
)
def test_files_that_hold_no_codebook_are_refused(vectors, metadata, tmp_path):
    path = tmp_path / "book.safetensors"
    save_file(vectors, path, metadata)
    with pytest.raises(UsageError, match="is no codebook"):
        Codebook.load(path)


def test_files_that_cannot_be_read_or_written_are_refused(tmp_path):
    path = tmp_path / "book.safetensors"
    with pytest.raises(UsageError, match="can't be read"):
        Codebook.load(path)
    path.write_text("no tensors")
    with pytest.raises(UsageError, match="can't be read"):
        Codebook.load(path)
    with pytest.raises(UsageError, match="can't be written"):
        Codebook(8).save(path / "below a file")
