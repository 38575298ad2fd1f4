"""Rewrites a file of an older version of the format, and touches nothing else in it.

Version 1 and version 2 say the same in the same words, but for two things (what they are stands in
the reference of the file's keys):

- A predicate of version 1 may have the name of an operator over time, such as ``once``. Clauses of
  version 2 can't, so that it gets a name of its own, wherever the file names it.
- A formula of version 1 that names a signal or a parameter means it, even if a head is called the
  same. In version 2 it could mean either, which is an error that only the author can resolve.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import yaml

from sfol.knowledge_base.format import FORMAT_VERSION
from sfol.knowledge_base.formatting import clause_of, renamed_predicates
from sfol.knowledge_base.positions import Edit, Entry, edited, entries, inside
from sfol.syntax import OVER_TIME


class Migration(NamedTuple):
    """What a file says in the newest version of the format.

    Attributes:
        text: the whole file.
        changes: what is different, each in a few words; none if nothing is.
    """

    text: str
    changes: tuple[str, ...]


def clashing_names(text: str) -> frozenset[str]:
    """Return the operators over time after which a file of version 1 calls predicates.

    Args:
        text: of the file, which must be YAML within the limits of `sfol.strict_yaml`.
    """
    found = list(entries(text))
    if _version(found) != "1":
        return frozenset()
    signatures = (e.path[1] for e in found if e.path[:1] == ("predicates",) and len(e.path) == 2)
    rules = (e.value.value for e in found if _is_rule(e))
    named = (str(said).partition("(")[0].strip() for said in (*signatures, *rules))
    return frozenset(named).intersection(OVER_TIME)


def migrated(text: str, clashing: Iterable[str]) -> Migration:
    """Return a file in the newest version of the format.

    Args:
        text: the whole file, with its own line breaks; YAML within the limits of
            `sfol.strict_yaml`.
        clashing: the names that predicates can't have any longer, of this file and of those that
            it is migrated together with.
    """
    found = list(entries(text))
    if _version(found) != "1":
        return Migration(text, ())
    renames = {name: f"{name}_" for name in sorted(clashing)}
    edits = {edit.start: edit for entry in found for edit in _edits(entry, text, renames)}
    new = edited(text, edits.values())
    used = (name for name in renames if any(edit.of == name for edit in edits.values()))
    renamed = (f"the predicate '{name}' is called '{renames[name]}' from now on" for name in used)
    return Migration(new, (f"version 1 → {FORMAT_VERSION}", *renamed))


def _version(found: Iterable[Entry]) -> str:
    """Return the version as it is written; a file may leave it to those that it extends."""
    values = (entry.value for entry in found if entry.path == ("version",))
    return next((node.value for node in values if isinstance(node, yaml.ScalarNode)), "")


def _is_rule(entry: Entry) -> bool:
    return isinstance(entry.value, yaml.ScalarNode) and (
        entry.path[:1] == ("rules",) and (len(entry.path) == 2 or entry.path[2:] == ("rule",))
    )


def _edits(entry: Entry, source: str, renames: Mapping[str, str]) -> Iterator[Edit]:
    if entry.path == ("version",):
        start, end = inside(entry.value, source)
        yield Edit(start, end, str(FORMAT_VERSION))
    node = clause_of(entry)
    if isinstance(node, yaml.ScalarNode):
        start, end = inside(node, source)
        yield from renamed_predicates(source[start:end], renames, start)
    for name in _names(entry):
        start, end = inside(name, source)
        text = source[start:end]
        before, dot, last = text.rpartition(".") if entry.path[0] == "schedules" else ("", "", text)
        if last in renames:
            yield Edit(start + len(before + dot), end, renames[last], last)


def _names(entry: Entry) -> Iterator[yaml.ScalarNode]:
    """Yield the node of a key, or of a value, that is the name of a head or a predicate."""
    match entry.path:
        case (
            ("weights", str(), "coefficients", str())
            | ("tests", int(), "expect", "bounds" | "confidences", str())
            | ("tests", int(), "steps", int(), "expect", "bounds" | "confidences", str())
            | ("schedules", str())
        ):
            node = entry.key
        case ("remove", "predicates", int()):
            node = entry.value
        case _:
            return
    if isinstance(node, yaml.ScalarNode):
        yield node
