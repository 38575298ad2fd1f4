"""Files that can't be read end with an error of ours, at once."""

import os

import pytest
from pydantic import BaseModel, ValidationError

from sfol.errors import FileError
from sfol.reading import MAXIMUM_BYTES, first_reason, opened, text_of


def unreadable(folder):
    """Return paths that are no regular files, with what is said of each."""
    os.mkfifo(folder / "pipe")
    (folder / "loop").symlink_to(folder / "loop")
    (folder / "file").write_text("")
    return {
        folder: "not a regular file",
        folder / "pipe": "not a regular file",
        folder / "none": "No such file",
        folder / "loop": "Too many levels",
        folder / "file" / "x": "Not a directory",
        folder / "nu\0ll": "null",
    }


def test_what_is_no_regular_file_is_not_read(tmp_path):
    for path, reason in unreadable(tmp_path).items():
        for read in (opened, text_of):
            with pytest.raises(FileError, match=reason) as caught:
                read(path)
            assert caught.value.place.file == str(path)


def test_a_text_is_utf_8_within_a_limit(tmp_path):
    path = tmp_path / "x"
    path.write_bytes("é".encode() * (MAXIMUM_BYTES // 2))
    assert len(text_of(path)) == MAXIMUM_BYTES // 2
    path.write_bytes(b"e" * (MAXIMUM_BYTES + 1))
    with pytest.raises(FileError, match="more than 1000000 bytes"):
        text_of(path)
    path.write_bytes(b"\xff")
    with pytest.raises(FileError, match="not UTF-8"):
        text_of(path)


class Inner(BaseModel):
    count: int


class Outer(BaseModel):
    parts: list[Inner]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('{"parts": [{"count": 1}, {"count": "x"}]}', "parts.1.count: Input should be a valid int"),
        ("{}", "parts: Field required"),
        ("{", "Invalid JSON: EOF while parsing an object at line 1"),
    ],
)
def test_what_does_not_fit_is_named(text, reason):
    with pytest.raises(ValidationError) as caught:
        Outer.model_validate_json(text)
    assert first_reason(caught.value).startswith(reason)


def test_the_operating_system_s_reason_stands_without_its_number(tmp_path):
    with pytest.raises(OSError, match="Is a directory") as caught:
        tmp_path.read_bytes()
    assert first_reason(caught.value) == "Is a directory"


@pytest.mark.parametrize(
    ("error", "reason"),
    [(ValueError("first\nsecond"), "first"), (KeyError("k"), "'k'"), (ValueError(), "ValueError")],
)
def test_of_others_it_is_the_first_line(error, reason):
    assert first_reason(error) == reason
