"""Locks: one process writes, the others are told who does; what died locks nothing."""

import errno
import os
import signal
import subprocess
import sys
import threading

import pytest

from sfol import locking
from sfol.errors import UsageError
from sfol.locking import locked, locked_folder

HOLD = """
import sys
from pathlib import Path
from sfol.locking import locked
with locked(Path(sys.argv[1]), "log"):
    print("held", flush=True)
    sys.stdin.read()
"""


def held_by_another(path):
    command = [sys.executable, "-c", HOLD, str(path)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    return process


def lock(path):
    with locked(path, "log"):
        return os.listdir(path.parent)


def test_a_lock_is_a_file_beside_and_ends_with_the_block(tmp_path):
    assert lock(tmp_path / "new" / "x") == ["x.lock"]
    assert os.listdir(tmp_path / "new") == []
    with pytest.raises(ZeroDivisionError), locked(tmp_path / "x", "log"):
        raise ZeroDivisionError
    assert lock(tmp_path / "x") == ["new", "x.lock"]


def test_another_process_is_named_until_it_dies(tmp_path):
    path = tmp_path / "x"
    with held_by_another(path) as process:
        with pytest.raises(UsageError, match=f"by process {process.pid} since 20"):
            lock(path)
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert os.listdir(tmp_path) == ["x.lock"]
        lock(path)
    assert os.listdir(tmp_path) == []


def test_what_a_dead_process_left_behind_locks_nothing(tmp_path):
    (tmp_path / "x.lock").write_text("process 1 since 2020-01-01 00:00:00, and more than is new")
    with locked(tmp_path / "x", "log"):
        assert (tmp_path / "x.lock").read_text().startswith(f"process {os.getpid()} since")
        assert "new" not in (tmp_path / "x.lock").read_text()


def test_a_lock_that_was_removed_meanwhile_is_taken_anew(tmp_path, monkeypatch):
    """Between opening and locking, the holder ends: its file is no longer the one at the path."""
    path, flock, calls = tmp_path / "x", locking.fcntl.flock, []

    def end_first(descriptor, operation):
        if not calls:
            (tmp_path / "x.lock").unlink()
        calls.append(flock(descriptor, operation))

    monkeypatch.setattr(locking.fcntl, "flock", end_first)
    assert lock(path) == ["x.lock"]
    assert len(calls) == 2


@pytest.mark.parametrize("code", [errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP])
def test_where_there_are_no_locks_nothing_is_locked(tmp_path, monkeypatch, code):
    def refuse(descriptor, operation):
        raise OSError(code, "no locks")

    monkeypatch.setattr(locking.fcntl, "flock", refuse)
    assert lock(tmp_path / "x") == ["x.lock"]
    monkeypatch.setattr(locking, "fcntl", None)
    assert lock(tmp_path / "x") == []


def test_what_can_not_be_locked_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    os.mkfifo(tmp_path / "pipe.lock")
    (tmp_path / "victim").write_text("precious")
    (tmp_path / "link.lock").symlink_to(tmp_path / "victim")
    (tmp_path / "folder.lock").mkdir()
    for name in ("file/x", "pipe", "link", "folder"):
        with pytest.raises(UsageError, match=r"can't be written"):
            lock(tmp_path / name)
    assert (tmp_path / "victim").read_text() == "precious"


def test_who_has_a_folder_is_named_to_others(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["/somewhere/aeb", "train", "--output", "my run"])
    folder = tmp_path / "new" / "run"
    with locked_folder(folder):
        process = rf"process {os.getpid()} since 20[^(]* \(aeb train --output 'my run'\)"
        with pytest.raises(UsageError, match=rf"the folder '{folder}' is in use by {process}"):
            locked_folder(folder).__enter__()
        with locked_folder(tmp_path / "other"):
            pass
    with locked_folder(folder):
        pass
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("content", [b"", b"{", b"\xff", b"process 1\x1b[2J"])
def test_a_lock_that_says_nothing_is_one_all_the_same(tmp_path, content):
    with locked_folder(tmp_path):
        (tmp_path / ".lock").write_bytes(content)
        with pytest.raises(UsageError, match="in use by another process"):
            locked_folder(tmp_path).__enter__()


def test_never_two_at_once(tmp_path):
    """Those who come while the last one leaves do not get the file that it removes."""
    inside, most, rounds = [], [], []

    def work():
        for _ in range(200):
            try:
                with locked_folder(tmp_path):
                    inside.append(1)
                    most.append(len(inside))
                    rounds.append(1)
                    inside.pop()
            except UsageError:
                pass

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert rounds
    assert set(most) == {1}


def test_a_folder_that_can_t_be_written_is_an_error(tmp_path):
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file", tmp_path / "file" / "run"):
        with pytest.raises(UsageError, match="can't be written"):
            locked_folder(folder).__enter__()


def test_a_link_in_place_of_the_lock_is_not_followed(tmp_path):
    precious = tmp_path / "precious"
    precious.write_text("kept")
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / ".lock").symlink_to(precious)
    with pytest.raises(UsageError, match="can't be written"):
        locked_folder(folder).__enter__()
    assert precious.read_text() == "kept"
