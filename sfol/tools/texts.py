"""Texts that come from files, as they are shown to people."""

from __future__ import annotations


def visible(text: object) -> str:
    """Return a text as it is shown within a line: what is no visible character is spelt out."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(text))
