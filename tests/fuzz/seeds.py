"""Bytes to begin with, for each reader."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

from sfol import Facts, KnowledgeBase
from sfol.knowledge_base.loading import bundled_folder
from sfol.logs import LogWriter


def seeds(reader: str) -> Iterator[bytes]:
    """Yield bytes that a reader takes."""
    kb = KnowledgeBase.load("aeb")
    match reader:
        case "knowledge_base":
            yield from (path.read_bytes() for path in sorted(bundled_folder().glob("*.yaml")))
        case "clause":
            yield from (str(rule.clause).encode() for rule in kb.rules.values())
            yield b"h(X) :- P(X, Y), not Q(Y), X != Y."
            yield b"h(X) :- R, (P(X, 7) implies (Q('a, b', _) or X != -1)), S(X, Y, X) >= 0.5."
        case "formula":
            yield from (term.formula.text.encode() for term in kb.terms.values())
            yield b"where(v > 0, min(1 / v, 5), clip(exp(-v), 0, 1e3)) ** 2"
            yield b"1 - any(below(hypot(P.x - ego.x, P.y), 2, margin=1, shape=cosine) for P in person)"
        case "facts":
            yield b"Vehicle(ego). Pedestrian(p1): [0.76, 0.84]. Near(p1, ego): 0.9. % note"
            yield b"Raining: 0.5. Between(7, \"Mary Ann\", 'b')."
        case "log":
            yield _log(kb)


def _log(kb: KnowledgeBase) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.parquet"
        with LogWriter(path, kb) as log:
            for time in (0.0, 0.1):
                log.step(Facts.parse("Pedestrian(p1): 0.8."), time, v=6.0, v_next=5.5, d=9.0)
            log.end_episode("success")
        return path.read_bytes()
