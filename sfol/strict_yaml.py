"""YAML text → plain data, with the place of every part: safe, strict, and within fixed limits.

Scalars are read as YAML 1.2 has them: 1.5e3 is a number, 010 is ten, 1:30 and yes are texts. Keys
are texts and stand once. Nothing is run, merged (``<<``) or guessed, and limits of size, depth and
number of values see to it that no file can make reading hang.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from sfol.errors import FileError, Place
from sfol.reading import text_of

MAXIMUM_DEPTH = 20
MAXIMUM_VALUES = 50_000
MAXIMUM_DIGITS = 400

Keys = tuple[str | int, ...]
Scalar = str | int | float | bool | None

_TAG = "tag:yaml.org,2002:"
_TOO_MUCH = "the file has too many values, or is nested too deeply"

# What would reach a terminal as a command, turn the direction of a line, or is no character:
# controls but tab and line ends, marks of direction, halves of surrogate pairs.
_CONTROLS = r"\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x84\x86-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff"
_NEVER_IN_A_TEXT = re.compile(f"[{_CONTROLS}]")
_NEVER_IN_A_KEY = re.compile(rf"[{_CONTROLS}\t\n\r\x85\u2028\u2029]")


class _Kind(NamedTuple):
    """How a plain scalar is recognised: by its first character, then as a whole."""

    first: str
    text: re.Pattern[str]
    value: Callable[[str], Scalar]


def _integer(text: str) -> int:
    base = {"0o": 8, "0x": 16}.get(text[:2], 10)
    return int(text[2:] if base != 10 else text, base)


def _float(text: str) -> float:
    return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))


# The core schema of YAML 1.2, section 10.3.2.
_KINDS = {
    "null": _Kind("~nN", re.compile(r"~|null|Null|NULL|"), lambda text: None),
    "bool": _Kind(
        "tTfF", re.compile(r"true|True|TRUE|false|False|FALSE"), lambda text: text[0] in "tT"
    ),
    "int": _Kind("+-0123456789", re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+"), _integer),
    "float": _Kind(
        "+-.0123456789",
        re.compile(
            r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
            r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"
        ),
        _float,
    ),
}


class _TooMuch(Exception):  # noqa: N818  (told in words of ours)
    """A file passes a limit while it is parsed."""


class _Loader(yaml.SafeLoader):
    """PyYAML's parser with the scalars of YAML 1.2 instead of 1.1, and an end to what it reads."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012  (as PyYAML declares it)

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._nodes = self._depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        self._nodes += 1
        self._depth += 1
        if (
            self._nodes > 2 * MAXIMUM_VALUES or self._depth > MAXIMUM_DEPTH + 1
        ):  # keys are nodes too
            raise _TooMuch
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


for _name, _kind in _KINDS.items():
    _whole = re.compile(rf"(?:{_kind.text.pattern})\Z")
    _Loader.add_implicit_resolver(_TAG + _name, _whole, [*_kind.first])
_Loader.add_implicit_resolver(_TAG + "null", re.compile(r"\Z"), [""])


@dataclass(frozen=True)
class Spot:
    """Where a key and its value stand in a file."""

    file: str
    source: str
    key: yaml.Mark
    value: yaml.Node

    @property
    def is_text(self) -> bool:
        """Whether the value is a text."""
        return isinstance(self.value, yaml.ScalarNode) and self.value.tag == _TAG + "str"

    def of_key(self) -> Place:
        """Return the place of the key."""
        return Place(self.file, self.key.line + 1, self.key.column + 1)

    def of_value(self, offset: int = 0) -> Place:
        """Return the place of the value, or of the character of it at an offset."""
        mark = self.value.start_mark
        if not isinstance(self.value, yaml.ScalarNode):
            return Place(self.file, mark.line + 1, mark.column + 1)
        index = self._index(self.value, offset)
        line_start = self.source.rfind("\n", 0, index) + 1
        return Place(self.file, self.source.count("\n", 0, index) + 1, index - line_start + 1)

    def _index(self, scalar: yaml.ScalarNode, offset: int) -> int:
        """Return the index in the file of a character of the value.

        A scalar's value and its source differ in quotes, block marks and white space only, so
        the n-th visible character of the one is the n-th of the other.
        """
        start, end = scalar.start_mark.index, scalar.end_mark.index
        while start < end and self.source[start] in "|>'\"+-0123456789 \t\r\n":
            if self.source[start] == scalar.value[:1]:
                break
            start += 1
        visible = sum(not c.isspace() for c in scalar.value[:offset])
        for index in range(start, end):
            if self.source[index].isspace():
                continue
            if visible == 0:
                return index
            visible -= 1
        return min(start, len(self.source))


@dataclass
class Places:
    """Where the parts of a file stand: a tree with the shape of its data.

    Attributes:
        spot: of the part itself; None of the file as a whole.
        below: key or index → the places of that part.
    """

    spot: Spot | None = None
    below: dict[str | int, Places] = field(default_factory=dict)

    def find(self, path: Keys) -> Spot | None:
        """Return where a path of keys stands, if it is known."""
        places: Places | None = self
        for key in path:
            places = places.below.get(key) if places else None
        return places.spot if places else None

    def nearest(self, path: Keys) -> Spot | None:
        """Return where a path of keys stands, or the nearest known part above it."""
        places, found = self, self.spot
        for key in path:
            if key not in places.below:
                break
            places = places.below[key]
            found = places.spot or found
        return found


@dataclass(frozen=True)
class Document:
    """A file as plain data.

    Attributes:
        file: its name, as the user gave it.
        data: mappings, lists, texts, numbers, booleans and None.
        places: where each part stands.
    """

    file: str
    data: dict[str, Any]
    places: Places


def read(path: Path) -> Document:
    """Read a YAML file that is a mapping.

    Raises:
        FileError: it can't be read, is no YAML, or passes a limit.
    """
    return parse(text_of(path), str(path))


def parse(text: str, file: str) -> Document:
    """Read a YAML text that is a mapping.

    Args:
        text: the text.
        file: what places call it.

    Raises:
        FileError: it is no YAML, or passes a limit.
    """
    node = _composed(text, file)
    if not isinstance(node, yaml.MappingNode):
        raise FileError(
            "the file is not a mapping of keys to values",
            suggestion="it begins with 'version: 2' and 'name: …'",
            place=Place(file, 1, 1),
        )
    places = Places()
    return Document(file, _Builder(file, text).build(node, places, depth=0), places)


def _composed(text: str, file: str) -> yaml.Node | None:
    try:
        loader = _Loader(text)
    except yaml.reader.ReaderError as error:
        lines = text[: error.position].splitlines(keepends=True) or [""]
        raise FileError(
            f"this is not YAML: it has the character {text[error.position]!a}",
            place=Place(file, len(lines), len(lines[-1]) + 1),
        ) from None
    suggestion = None
    try:
        return loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark or loader.get_mark()
        problem = f"this is not YAML: {error.problem}"
        if error.problem == "mapping values are not allowed here":
            suggestion = "a colon before a blank ends a key: put a text that has both in quotes"
    except (ValueError, OverflowError):  # PyYAML makes a character of any number
        mark, problem = loader.get_mark(), "this is not YAML: there is no such character"
    except (_TooMuch, RecursionError):
        mark, problem = loader.get_mark(), _TOO_MUCH
    place = Place(file, mark.line + 1, mark.column + 1)
    raise FileError(problem, suggestion=suggestion, place=place)


class _Builder:
    """Turns YAML nodes into plain data and notes where each part stands."""

    def __init__(self, file: str, source: str) -> None:
        self._file = file
        self._source = source
        self._count = 0

    def build(self, node: yaml.Node, places: Places, depth: int) -> Any:
        self._count += 1
        if self._count > MAXIMUM_VALUES or depth > MAXIMUM_DEPTH:
            # Also the end of alias bombs and of anchors that contain themselves.
            raise self._error(node, _TOO_MUCH)
        if isinstance(node, yaml.MappingNode):
            self._check_tag(node, "map")
            return self._mapping(node, places, depth)
        if isinstance(node, yaml.SequenceNode):
            self._check_tag(node, "seq")
            return [
                self._noted(index, child, child.start_mark, places, depth)
                for index, child in enumerate(node.value)
            ]
        assert isinstance(node, yaml.ScalarNode)
        return self._scalar(node)

    def _noted(
        self, key: str | int, node: yaml.Node, mark: yaml.Mark, above: Places, depth: int
    ) -> Any:
        above.below[key] = Places(Spot(self._file, self._source, mark, node))
        return self.build(node, above.below[key], depth + 1)

    def _mapping(self, node: yaml.MappingNode, places: Places, depth: int) -> dict[str, Any]:
        data: dict[str, Any] = {}
        for key_node, child in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise self._error(key_node, "a key must be a name")
            self._scalar(key_node)
            key = self._text(key_node, _NEVER_IN_A_KEY)
            if key in data:
                raise self._error(key_node, f"the key '{key}' stands twice", key)
            data[key] = self._noted(key, child, key_node.start_mark, places, depth)
        return data

    def _scalar(self, node: yaml.ScalarNode) -> Scalar:
        if node.tag == _TAG + "str":
            return self._text(node)
        kind = _KINDS.get(node.tag.removeprefix(_TAG))
        if kind is None:
            raise self._kind_error(node)
        if len(node.value) > MAXIMUM_DIGITS or not kind.text.fullmatch(node.value):
            raise self._error(node, f"'{node.value[:40]}' is not a value of this kind")
        return kind.value(node.value)

    def _text(self, node: yaml.ScalarNode, refused: re.Pattern[str] = _NEVER_IN_A_TEXT) -> str:
        text: str = node.value
        found = refused.search(text)
        if found:
            raise self._error(node, f"a text can't have the character {found.group()!a}")
        return text

    def _check_tag(self, node: yaml.Node, kind: str) -> None:
        if node.tag != _TAG + kind:
            raise self._kind_error(node)

    def _kind_error(self, node: yaml.Node) -> FileError:
        return self._error(node, f"values of the kind '{node.tag}' are not allowed", node.tag)

    def _error(self, node: yaml.Node, message: str, name: str | None = None) -> FileError:
        mark = node.start_mark
        return FileError(
            message, name=name, place=Place(self._file, mark.line + 1, mark.column + 1)
        )
