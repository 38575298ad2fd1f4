"""A folder is written to by one process at a time, and who has it is said."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from env.evaluation.folder_lock import locked
from sfol.errors import SfolError, UsageError

ROOT = Path(__file__).parents[3]


def test_who_has_a_folder_is_named_to_others(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["/somewhere/aeb", "train", "--output", "my run"])
    folder = tmp_path / "new" / "run"
    with locked(folder):
        expected = rf"'{folder}' is in use by process {os.getpid()} \(aeb train --output 'my run'\)"
        with pytest.raises(SfolError, match=rf"{expected} since \d{{4}}-\d\d-\d\d "):
            locked(folder).__enter__()
        with locked(tmp_path / "other"):
            pass
    with locked(folder):
        pass
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("content", [b"", b"{", b"\xff", b'{"pid": "x"}'])
def test_a_lock_that_says_nothing_is_one_all_the_same(tmp_path, content):
    with locked(tmp_path):
        (tmp_path / ".lock").write_bytes(content)
        with pytest.raises(SfolError, match="in use by another process"):
            locked(tmp_path).__enter__()


HOLDER = """
import sys, time
from pathlib import Path
from env.evaluation.folder_lock import locked

with locked(Path(sys.argv[1])):
    print("here", flush=True)
    time.sleep(600)
"""


def test_a_killed_process_leaves_no_lock(tmp_path):
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)],
        stdout=subprocess.PIPE,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    with holder:
        assert holder.stdout.readline() == b"here\n"
        with pytest.raises(
            SfolError, match=rf"process {holder.pid} \(-c {re.escape(str(tmp_path))}"
        ):
            locked(tmp_path).__enter__()
        holder.send_signal(signal.SIGKILL)
        holder.wait()
    assert json.loads((tmp_path / ".lock").read_text())["pid"] == holder.pid
    with locked(tmp_path):
        pass


def test_never_two_at_once(tmp_path):
    """Those who come while the last one leaves do not get the file that it removes."""
    inside, most, rounds = [], [], []

    def work():
        for _ in range(200):
            try:
                with locked(tmp_path):
                    inside.append(1)
                    most.append(len(inside))
                    rounds.append(1)
                    inside.pop()
            except SfolError:
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
            locked(folder).__enter__()


def test_a_link_in_place_of_the_lock_is_not_followed(tmp_path):
    precious = tmp_path / "precious"
    precious.write_text("kept")
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / ".lock").symlink_to(precious)
    with pytest.raises(UsageError, match="can't be written"):
        locked(folder).__enter__()
    assert precious.read_text() == "kept"
