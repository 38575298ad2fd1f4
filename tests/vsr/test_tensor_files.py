"""Files of tensors are believed only as far as they have been compared."""

import errno
import json
from pathlib import Path

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel
from safetensors.torch import save, save_file

from sfol.errors import FileError, SfolError, UsageError
from vsr import tensor_files
from vsr.tensor_files import TensorKind

DTYPES = [
    torch.float16, torch.bfloat16, torch.float32, torch.float64, torch.int8, torch.uint8,
    torch.int64, torch.bool, torch.complex64, torch.float8_e4m3fn,
]  # fmt: skip
FLOATS = {torch.float16, torch.bfloat16, torch.float32}


class Note(BaseModel, extra="forbid"):
    text: str


@given(
    dtype=st.sampled_from(DTYPES),
    shape=st.lists(st.integers(0, 3), max_size=3).map(tuple),
    name=st.sampled_from(["a", "b"]),
    floating=st.booleans(),
)
@settings(deadline=None)
def test_only_what_was_expected_fits(tmp_path_factory, dtype, shape, name, floating):
    file = tmp_path_factory.mktemp("file") / "one.safetensors"
    save_file({name: torch.zeros(shape).to(dtype)}, file)
    difference = tensor_files.misfit(
        tensor_files.read_header(file), {"a": TensorKind(floating, (2, 3))}
    )
    right_type = dtype in FLOATS if floating else dtype == torch.int64
    assert (difference is None) == (right_type and shape == (2, 3) and name == "a")


def test_the_header_alone_is_compared(tmp_path, monkeypatch):
    file = tmp_path / "large.safetensors"
    save_file({"a": torch.zeros(1000, 1000)}, file)
    monkeypatch.setattr(tensor_files, "load_file", lambda _: pytest.fail("loaded"))
    header = tensor_files.read_header(file)
    assert "not floats of shape (2,)" in tensor_files.misfit(header, {"a": TensorKind(True, (2,))})


@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32])
def test_numbers_that_are_not_finite_are_refused(tmp_path, number, dtype):
    file = tmp_path / "one.safetensors"
    save_file({"fine": torch.ones(3), "a": torch.tensor([0.0, number]).to(dtype)}, file)
    with pytest.raises(FileError, match="'a' that aren't finite"):
        tensor_files.load_finite(file)


@given(st.binary(max_size=200))
@settings(deadline=None)
def test_files_of_anything_are_read_or_refused(tmp_path_factory, content):
    file = tmp_path_factory.mktemp("file") / "any.safetensors"
    file.write_bytes(content)
    for read in (tensor_files.read_header, tensor_files.load_finite):
        with pytest.raises(FileError, match="can't be read"):
            read(file)


@given(st.integers(0, 200), st.binary(min_size=1, max_size=9))
@settings(deadline=None)
def test_a_file_with_bytes_changed_is_read_or_refused(tmp_path_factory, place, change):
    file = tmp_path_factory.mktemp("file") / "any.safetensors"
    content = save({"a": torch.ones(2, 3), "b": torch.ones(4, dtype=torch.int64)})
    file.write_bytes(content[:place] + change + content[place + len(change) :])
    try:
        tensor_files.misfit(tensor_files.read_header(file), {"a": TensorKind(True, (2, 3))})
        tensor_files.load_finite(file)
    except FileError as error:
        assert str(file) in str(error)  # noqa: PT017


def test_there_is_no_file(tmp_path):
    for path in (tmp_path / "none", tmp_path):
        with pytest.raises(FileError, match="can't be read"):
            tensor_files.read_header(path)
        with pytest.raises(FileError, match="can't be read"):
            tensor_files.check_belongs(path, "0" * 64, tmp_path / "card.json")


@pytest.mark.parametrize(
    ("digest", "message"),
    [(None, "does not say which file it belongs to"), ("0" * 64, "is not the file that")],
)
def test_a_file_that_its_card_does_not_name_is_refused(tmp_path, digest, message):
    file = tmp_path / "weights"
    file.write_bytes(b"weights")
    tensor_files.check_belongs(file, tensor_files.sha256(b"weights"), tmp_path / "card.json")
    with pytest.raises(FileError, match=message) as caught:
        tensor_files.check_belongs(file, digest, tmp_path / "card.json")
    assert "take both from one place" in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "Invalid JSON"),
        (b"\xff", "Invalid JSON"),
        (b"[" * 100_000, "recursion limit"),
        (b"{}", "text: Field required"),
        (json.dumps({"text": "x" * 1_000_000}).encode(), "more than 1000000 bytes"),
    ],
)
def test_what_is_no_card_is_refused(tmp_path, content, message):
    card = tmp_path / "card.json"
    card.write_bytes(content)
    with pytest.raises(FileError, match=message):
        tensor_files.read_card(card, Note, "note")
    with pytest.raises(FileError, match="the note can't be read: No such file"):
        tensor_files.read_card(tmp_path / "none.json", Note, "note")


@pytest.mark.parametrize("failing", [0, 1, 2])
def test_files_that_belong_together_are_written_all_or_none(tmp_path, monkeypatch, failing):
    files = [tmp_path / name for name in ("weights", "codebook", "card")]
    tensor_files.write_together(dict.fromkeys(files, b"old"))
    write, calls = Path.write_bytes, iter(range(9))

    def fill_the_disk(path, content):
        if next(calls) == failing:
            write(path, content[:1])
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", fill_the_disk)
    with pytest.raises(UsageError, match="No space left"):
        tensor_files.write_together(dict.fromkeys(files, b"new"))
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {
        path.name: b"old" for path in files
    }


def test_the_card_is_put_in_its_place_last(tmp_path):
    weights, card = tmp_path / "weights", tmp_path / "card"
    card.mkdir()  # so that it can't be replaced
    with pytest.raises(SfolError, match="can't be written"):
        tensor_files.write_together({weights: b"new", card: b"new"})
    assert weights.read_bytes() == b"new"  # which the old card, were there one, does not name
