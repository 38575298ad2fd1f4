"""Files are written whole or not at all, and nothing beside them."""

import os

import pytest

from sfol.errors import UsageError
from sfol.writing import check_writable, replacing


def write(path, text="new", **options):
    with replacing(path, **options) as part:
        part.write_text(text)


def fail_half_way(path):
    with replacing(path) as part:
        part.write_text("half")
        raise ZeroDivisionError


def test_a_file_takes_its_place_and_its_mode_stays(tmp_path):
    path = tmp_path / "made" / "on" / "the" / "way" / "x.txt"
    write(path, "old")
    path.chmod(0o640)
    write(path)
    assert path.read_text() == "new"
    assert path.stat().st_mode & 0o777 == 0o640
    assert os.listdir(path.parent) == ["x.txt"]


def test_an_exception_leaves_everything_as_it_was(tmp_path):
    path = tmp_path / "x.txt"
    path.write_text("old")
    with pytest.raises(ZeroDivisionError):
        fail_half_way(path)
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["x.txt"]


def test_a_planted_link_leads_nowhere(tmp_path):
    victim, folder = tmp_path / "victim", tmp_path / "results"
    victim.write_text("precious")
    folder.mkdir()
    for name in ("x.txt", "x.txt.part"):
        (folder / name).symlink_to(victim)
    write(folder / "x.txt")
    assert victim.read_text() == "precious"
    assert (folder / "x.txt").read_text() == "new"
    assert not (folder / "x.txt").is_symlink()


def test_a_link_that_is_followed_stays_one(tmp_path):
    file, link = tmp_path / "file", tmp_path / "link"
    file.write_text("old")
    link.symlink_to(file)
    write(link, follow_link=True)
    assert link.is_symlink()
    assert file.read_text() == "new"


def test_two_writers_of_one_file_do_not_meet(tmp_path):
    path = tmp_path / "x.txt"
    with replacing(path) as first, replacing(path) as second:
        first.write_text("first")
        second.write_text("second")
    assert path.read_text() == "first"  # its writer came to its end later
    assert os.listdir(tmp_path) == ["x.txt"]


def test_what_can_not_be_written_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match=r"can't be written"):
        write(tmp_path / "file" / "x.txt")
    (tmp_path / "folder").mkdir()
    with pytest.raises(UsageError, match=r"can't be written"):
        write(tmp_path / "folder")
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]


def test_whether_a_file_can_be_written_is_found_out_beforehand(tmp_path):
    (tmp_path / "file").write_text("kept")
    (tmp_path / "folder").mkdir()
    for path in ("file/x.txt", "file/more/x.txt", "folder"):
        with pytest.raises(UsageError, match=r"can't be written"):
            check_writable(tmp_path / "fine.txt", tmp_path / path)
    check_writable(tmp_path / "file", tmp_path / "new" / "x.txt")
    assert (tmp_path / "file").read_text() == "kept"
    assert sorted(os.listdir(tmp_path)) == ["file", "folder", "new"]
    assert os.listdir(tmp_path / "new") == []
