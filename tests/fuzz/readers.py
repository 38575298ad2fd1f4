"""What is fuzzed: each function takes any bytes, and raises nothing but faults of the project."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from sfol import Facts, KnowledgeBase, RewardFunction
from sfol.clauses import parse_condition, parse_rule
from sfol.errors import SfolError
from sfol.formula import Formula
from sfol.logs import read_log

_FOLDER = Path(tempfile.mkdtemp(prefix="fuzz-"))
_NUMBERS = (0.0, -1.0, 0.5, 1e200, float("inf"))


def knowledge_base(data: bytes) -> None:
    """Read a file; one that is valid gives a reward function with a hash."""
    path = _FOLDER / "file.yaml"
    path.write_bytes(data)
    with suppress(SfolError):
        assert RewardFunction(KnowledgeBase.load(path)).hash


def clause(data: bytes) -> None:
    """Read a rule and a condition; what was read says itself in a form that reads the same."""
    text = data.decode(errors="surrogateescape")
    for parse in (parse_rule, parse_condition):
        with suppress(SfolError):
            parsed = parse(text)
            assert parse(str(parsed)) == parsed


def formula(data: bytes) -> None:
    """Read a formula; one that is valid has a finite value or none."""
    with suppress(SfolError):
        parsed = Formula.parse(data.decode(errors="surrogateescape"))
        for number in _NUMBERS:
            entities = {r.key: [dict.fromkeys(r.names, number)] * 2 for r in parsed.ranges}
            with suppress(SfolError):
                values = {**dict.fromkeys(parsed.names, number), **entities}
                assert abs(parsed(values)) < float("inf")


def facts(data: bytes) -> None:
    """Read facts; what was read says itself in a form that reads the same."""
    with suppress(SfolError):
        parsed = Facts.parse(data.decode(errors="surrogateescape"))
        assert Facts.parse(str(parsed)) == parsed


def log(data: bytes) -> None:
    """Read a log."""
    path = _FOLDER / "file.parquet"
    path.write_bytes(data)
    with suppress(SfolError):
        read_log(path)


READERS: Mapping[str, Callable[[bytes], None]] = {
    reader.__name__: reader for reader in (knowledge_base, clause, formula, facts, log)
}
