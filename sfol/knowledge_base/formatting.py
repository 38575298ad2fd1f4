"""Formats the clauses of a knowledge base file, and touches nothing else in it.

Rules, conditions, facts and predicate signatures are found by their position in the source. In
these texts the blanks between two tokens of one line are made regular: ``safe( X ):-Near(X,Y) .``
becomes ``safe(X) :- Near(X, Y).`` Line breaks, indentation and comments stay, as does every byte
outside.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import yaml

from sfol.connectives import IMPLIES, OR
from sfol.knowledge_base.positions import Edit, Entry, edited, entries, inside
from sfol.syntax import OPERATORS

_PIECE = re.compile(
    r"(?P<comment>[%#][^\r\n]*)"
    r"|(?P<blank>[ \t]+)"
    r"|(?P<break>\s+)"
    r"|(?P<word>\"[^\"\r\n]*\"|'[^'\r\n]*'|[+-]?\d+(\.\d+)?([eE][+-]?\d+)?|[^\W\d]\w*)"
    rf"|(?P<mark>{'|'.join(map(re.escape, OPERATORS))}|.)"
)


class _Piece(NamedTuple):
    kind: str
    text: str


_EDGE = _Piece("edge", "")
_SAYS = _Piece("says", "=")


def format_file(text: str) -> str:
    """Return the text of a knowledge base file with its clauses formatted.

    Args:
        text: the whole file, which must be valid, with its own line breaks.
    """
    # By position, since an alias leads to the same text again.
    edits = {edit.start: edit for entry in entries(text) for edit in _edits(entry, text)}
    return edited(text, edits.values())


def format_clause(text: str) -> str:
    """Return the text of a rule, a condition or facts with regular blanks.

    Example:
        >>> format_clause("safe( X ):-Near(X,Y) ,not Far(Y) .")
        'safe(X) :- Near(X, Y), not Far(Y).'
    """
    parts: list[str] = []
    left, blank = _EDGE, ""
    for right in (*_joined(_pieces(text)), _EDGE):
        if right.kind == "blank":
            blank = right.text
            continue
        parts += [_gap(left, right, blank), right.text]
        left, blank = right, ""
    return "".join(parts)


def _joined(pieces: Iterable[_Piece]) -> Iterator[_Piece]:
    """Yield pieces, connectives told from predicates that are called so, and = from itself.

    Outside of parentheses it says a value, inside of them what an option is.
    """
    before, depth = _EDGE, 0
    for piece in pieces:
        depth += (piece.text == "(") - (piece.text == ")")
        if piece.text == "=" and not depth:
            yield _SAYS
        elif piece.kind in ("blank", "break", "comment"):
            yield piece
        else:
            before = _told_apart(piece, before)
            yield before


def _told_apart(piece: _Piece, before: _Piece) -> _Piece:
    ends = before.text == ")" or before.kind == "word"
    connects = piece.text in (OR, IMPLIES) and ends and before.text != "not"
    return _Piece("connective", piece.text) if connects else piece


def _gap(left: _Piece, right: _Piece, blank: str) -> str:
    """Return what belongs between two neighbours that have a blank, or none, between them."""
    if _EDGE in (left, right):
        return ""
    if {left.kind, right.kind} & {"break", "comment"}:
        return blank
    if right.text == "(" and (left.kind == "connective" or left.text in (",", *OPERATORS)):
        return " "
    if left.text in ("(", "[") or right.text in ("(", ")", "]", ",", ".", ":"):
        return ""
    if {left.kind, right.kind} & {"connective", "says"}:
        return " "
    words = left.kind == right.kind == "word"
    spaced = left.text in (",", ":", ".", *OPERATORS) or right.text in OPERATORS
    return " " if words or spaced else ""


def _pieces(text: str) -> Iterator[_Piece]:
    for match in _PIECE.finditer(text):
        yield _Piece(match.lastgroup or "", match.group())


def renamed_predicates(text: str, renames: Mapping[str, str], start: int) -> Iterator[Edit]:
    """Yield the edits by which predicates of a clause get other names.

    Args:
        text: of the clause, as it stands in a file.
        renames: name → new name.
        start: where it stands there.
    """
    pieces = list(_pieces(text))
    for number, piece in enumerate(pieces):
        rest = (later.text for later in pieces[number + 1 :] if later.kind != "blank")
        if piece.kind == "word" and piece.text in renames and next(rest, "") == "(":
            yield Edit(start, start + len(piece.text), renames[piece.text], piece.text)
        start += len(piece.text)


def _tokens(text: str) -> list[_Piece]:
    return [piece for piece in _pieces(text) if piece.kind not in ("blank", "break")]


def _edits(entry: Entry, source: str) -> Iterator[Edit]:
    node = clause_of(entry)
    if not isinstance(node, yaml.ScalarNode):
        return
    start, end = inside(node, source)
    old = source[start:end]
    # Escapes, anchors and comments in folded lines: the source is not the text that is meant.
    if _tokens(old) != _tokens(node.value):
        return
    new = format_clause(old)
    if node.style is None and ": " in new and new != old:
        new = f'"{new}"' if not set(new) & {'"', "\\"} else old
    if new != old:
        yield Edit(start, end, new)


def clause_of(entry: Entry) -> yaml.Node | None:
    """Return the node of a value that is a clause, or of a key that is a signature."""
    match entry.path:
        case ("predicates" | "attributes" | "facts", str()):
            return entry.key
        case (
            ("rules", str())
            | ("rules", str(), "rule")
            | ("background", int())
            | ("entity_weights", int(), "when")
            | ("tests", int(), "facts")
            | ("tests", int(), "facts", int())
            | ("tests", int(), "steps", int(), "facts")
            | ("tests", int(), "steps", int(), "facts", int())
        ):
            return entry.value
    return None
