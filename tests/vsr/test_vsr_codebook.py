import dataclasses

import pytest
import torch

from sfol.errors import UsageError
from vsr.classes import DESCRIPTOR_CLASSES
from vsr.codebook import Codebook

# If these change, so does every descriptor and every policy trained on it: raise VERSION.
PINNED_PEDESTRIAN = [0.014051712118089199, 0.002891950076445937, 0.011779353953897953]
PINNED_CELL = [0.006789244245737791, 0.016610072925686836]
PINNED_TOTAL = -2.6596192768461293


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
