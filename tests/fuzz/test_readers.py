"""Every reader takes its own seeds, and raises nothing on bytes that were changed by chance."""

import random

import pytest

from tests.fuzz.readers import READERS
from tests.fuzz.seeds import seeds

PIECES = [
    *(
        b"",
        b"\x00",
        b"\xff",
        b"\xed\xa0\x80",
        b"\n",
        b"[",
        b"{",
        b"(",
        b")",
        b":",
        b"'",
        b"\\",
        b"9",
    ),
    *(b"e999", b"nan", b"*", b"&a", b"!!int ", b"not ", b"!=", b".", b",", b"**", b"P(X)", b"--"),
]


def changed(chance, seed):
    data = seed
    for _ in range(chance.randint(1, 6)):
        start = chance.randrange(len(data) + 1)
        end = min(start + chance.choice([0, 0, 1, 2, 8]), len(data))
        data = data[:start] + chance.choice(PIECES) + data[end:]
    return data


@pytest.mark.parametrize("name", READERS)
def test_changed_bytes_raise_nothing(name):
    if name == "log":
        pytest.importorskip("pyarrow")
    known = list(seeds(name))
    assert known
    chance = random.Random(7)
    for number in range(120):
        READERS[name](changed(chance, known[number % len(known)]))


def test_a_fault_would_be_seen(monkeypatch):
    monkeypatch.setattr("tests.fuzz.readers.parse_rule", lambda text: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        READERS["clause"](b"h(X) :- P(X).")
