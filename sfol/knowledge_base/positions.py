"""Where the parts of a YAML text stand, as paths of keys."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import yaml

Keys = tuple[str | int, ...]


class Entry(NamedTuple):
    """A value of a YAML file.

    Attributes:
        path: the keys and indices that lead to it.
        key: the node of its key, or its own node in a list.
        value: its own node.
    """

    path: Keys
    key: yaml.Node
    value: yaml.Node


class Edit(NamedTuple):
    """A part of a text that another one replaces.

    Attributes:
        start: where it begins.
        end: where it ends.
        text: what stands there instead.
        of: what it was, where the edit is of a name.
    """

    start: int
    end: int
    text: str
    of: str = ""


def edited(text: str, edits: Iterable[Edit]) -> str:
    """Return a text with parts of it replaced; they do not overlap."""
    parts, done = [], 0
    for edit in sorted(edits):
        parts += [text[done : edit.start], edit.text]
        done = edit.end
    return "".join([*parts, text[done:]])


def inside(node: yaml.Node, source: str) -> tuple[int, int]:
    """Return where the text of a scalar begins and ends, without its quotes or block mark."""
    start, end = node.start_mark.index, node.end_mark.index
    if not isinstance(node, yaml.ScalarNode) or node.style is None:
        return start, end
    if node.style in ("'", '"'):
        return start + 1, end - 1
    return start + re.search(r"[\r\n]|\Z", source[start:]).start(), end  # type: ignore[union-attr]


def entries(text: str) -> Iterator[Entry]:
    """Yield every value of a YAML text, outer ones first.

    Args:
        text: a knowledge base file that was loaded without error; the loader's limits of size
            and depth are not checked again.
    """
    yield from _below(yaml.compose(text, Loader=yaml.SafeLoader), ())


def _below(node: yaml.Node | None, path: Keys) -> Iterator[Entry]:
    if isinstance(node, yaml.MappingNode):
        children = [Entry((*path, key.value), key, value) for key, value in node.value]
    elif isinstance(node, yaml.SequenceNode):
        children = [Entry((*path, i), child, child) for i, child in enumerate(node.value)]
    else:
        return
    for child in children:
        yield child
        yield from _below(child.value, child.path)
