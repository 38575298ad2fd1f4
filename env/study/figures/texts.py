"""Texts from results, as figures and tables show them: whatever they say, nothing else happens."""

from __future__ import annotations

import re

_MARKUP = re.compile(r"([\\`*\[|])")


def plain(text: str) -> str:
    """Return a text that figures show as it is: no formula between ``$``, no control characters."""
    return _visible(text).replace("$", r"\$")


def as_cell(text: str) -> str:
    """Return a text for a cell of a Markdown table: in one line, and without markup of its own."""
    line = _visible(" ".join(text.split()))
    return _MARKUP.sub(r"\\\1", line).replace("<", "&lt;")


def _visible(text: str) -> str:
    return "".join(c if c.isprintable() or c == "\n" else "\ufffd" for c in text)
