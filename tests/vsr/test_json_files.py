"""JSON files are read as what they should be, or refused."""

import os
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfol.errors import FileError, UsageError
from vsr.json_files import read_json, valid_text


@dataclass(frozen=True)
class Pair:
    first: int
    second: int

    def __post_init__(self):
        if self.first > self.second:
            raise UsageError("a pair ascends", name="pair")


def test_what_fits_is_read(tmp_path):
    file = tmp_path / "pair.json"
    file.write_text('{"first": 1, "second": 2}')
    assert read_json(file, Pair, "pair", most=25) == Pair(1, 2)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "Invalid JSON"),
        ("[" * 10_000, "recursion limit"),
        ('{"first": 1}', "second: Field required"),
        ('{"first": 1, "second": "x"}', "second: Input should be a valid integer"),
        ('{"first": 3, "second": 2}', "a pair ascends"),
        (f'{{"first": {"9" * 5000}, "second": 2}}', "more than 100 bytes"),
        ('{"first": 1, "second": 2}' + 100 * " ", "more than 100 bytes"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path, content, message):
    file = tmp_path / "pair.json"
    file.write_text(content)
    most = 20_000 if message == "recursion limit" else 100
    with pytest.raises(FileError, match=message) as caught:
        read_json(file, Pair, "pair", most=most, suggestion="write another")
    assert str(file) in str(caught.value)
    assert "pair" in caught.value.message
    assert caught.value.suggestion == "write another"


@given(st.binary(max_size=60))
def test_whatever_the_file_holds_it_is_a_pair_or_refused(tmp_path_factory, content):
    file = tmp_path_factory.mktemp("pair") / "pair.json"
    file.write_bytes(content)
    with pytest.raises(FileError, match="is no pair"):
        read_json(file, Pair, "pair", most=100)


@given(st.binary())
def test_every_path_can_be_written_as_text(path):
    text = valid_text(os.fsdecode(path))
    text.encode()
    if path.isascii():
        assert text == path.decode()
