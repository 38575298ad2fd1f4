"""Files that can't be read end with an error of ours, at once."""

import os

import pytest

from sfol.errors import FileError
from sfol.reading import MAXIMUM_BYTES, opened, text_of


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
