"""Where the parts of a YAML text stand, as paths of keys."""

from __future__ import annotations

from collections.abc import Iterator
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
