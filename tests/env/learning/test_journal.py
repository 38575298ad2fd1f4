"""The record of a training: whole rows, and errors that name the line."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from env.learning.journal import History
from sfol.errors import FileError, UsageError

NUMBERS = ("steps", "seconds")
ROWS = [{"steps": steps, "seconds": steps / 10, "note": "é"} for steps in (1, 2, 3)]


@pytest.fixture
def history(tmp_path):
    made = History(tmp_path / "rows.jsonl", NUMBERS)
    for row in ROWS:
        made.append(row)
    return made


def test_rows_come_back_and_half_of_one_is_left_out(history):
    assert history.rows() == ROWS
    with history.file.open("a") as file:
        file.write('{"steps": 4, "sec')
    assert history.rows() == ROWS
    history.go_back_to(2)
    assert history.rows() == ROWS[:2]
    history.append(ROWS[2])
    assert history.rows() == ROWS


@pytest.mark.parametrize(
    "line",
    [
        b"garbage",
        b"",
        b"[]",
        b"7",
        b'{"steps": 4}',
        b'{"steps": "4", "seconds": 1.0}',
        b"\xff\xfe",
        b"[" * 100_000,
    ],
)
def test_a_line_that_is_no_row_is_named_and_nothing_is_lost(history, line):
    text = history.file.read_bytes().split(b"\n")
    text.insert(1, line)
    history.file.write_bytes(b"\n".join(text))
    for use in (history.rows, lambda: history.go_back_to(0)):
        with pytest.raises(FileError, match=r"rows\.jsonl:2: this is no row.*remove the line"):
            use()
    assert history.file.read_bytes() == b"\n".join(text)


@given(line=st.binary(max_size=40).filter(lambda line: b"\n" not in line))
def test_whatever_a_line_holds_is_a_row_or_an_error(tmp_path_factory, line):
    history = History(tmp_path_factory.getbasetemp() / "any.jsonl", NUMBERS)
    history.file.write_bytes(line + b"\n")
    with contextlib.suppress(FileError):
        (row,) = history.rows()
        assert row.keys() >= {*NUMBERS}


def test_what_is_no_file_is_an_error(tmp_path):
    history = History(tmp_path, NUMBERS)
    with pytest.raises(FileError, match="can't be read"):
        history.rows()
    with pytest.raises(UsageError, match="can't be written"):
        history.append(ROWS[0])
