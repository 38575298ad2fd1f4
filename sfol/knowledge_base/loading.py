"""YAML files → a checked knowledge base: safe, strict, with file, line and column on every error.

Loading reads text and builds plain data. It runs no code, follows no path that a file names
outside its own folder and the bundled knowledge bases, and stops at fixed limits of size, depth
and number of values, so that no file can make it hang.
"""

from __future__ import annotations

import re
import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError

from sfol.errors import InvalidKnowledgeBase, KnowledgeBaseError, Place, SfolError, did_you_mean
from sfol.knowledge_base.checking import check
from sfol.knowledge_base.format import KnowledgeBaseFile
from sfol.knowledge_base.parts import Parts

MAXIMUM_BYTES = 1_000_000
MAXIMUM_DEPTH = 20
MAXIMUM_VALUES = 50_000

Keys = tuple[str | int, ...]

_NAME = re.compile(r"[a-z0-9_]+(/[a-z0-9_]+)*\Z")
_SUFFIXES = (".yaml", ".yml")
# YAML 1.1 takes 1e-3 for a text, since it has no point; people mean a number.
_FLOAT_WITHOUT_POINT = re.compile(r"[+-]?\d+[eE][+-]?\d+\Z")
# What describes one file alone and is not handed on to a file that extends it.
_OWN_SECTIONS = ("extends", "remove", "tests", "description")


def bundled_folder() -> Path:
    """Return the folder of the bundled knowledge bases: in a wheel, or in a checkout."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "rules"
    return inside if inside.is_dir() else package.parent / "rules"


def bundled_names() -> tuple[str, ...]:
    """Return the names that `load` and `extends` know, such as ``aeb``."""
    folder = bundled_folder()
    return tuple(
        sorted(
            str(p.relative_to(folder).with_suffix("").as_posix()) for p in folder.rglob("*.yaml")
        )
    )


def load(*sources: str | Path, sections: Mapping[str, type[BaseModel]] | None = None) -> Parts:
    """Read knowledge bases and what they extend, and apply them left to right.

    Args:
        sources: paths of files (ending in .yaml or .yml), or names of bundled knowledge bases.
        sections: models of the sections of `grounding` that are to be checked too.

    Raises:
        InvalidKnowledgeBase: with every error found.
    """
    if not sources:
        raise KnowledgeBaseError("no knowledge base is named", suggestion="such as load('aeb')")
    try:
        chain = _chain([_path_of(source) for source in sources])
        merged = _merge(chain)
    except SfolError as error:
        raise InvalidKnowledgeBase([error]) from None
    errors = _section_errors(merged, sections or {})
    try:
        parts = check(
            _validated(merged),
            place_of=merged.place_of,
            files=tuple(document.file for document in chain),
            removed_heads=merged.removed_heads,
        )
    except InvalidKnowledgeBase as invalid:
        raise InvalidKnowledgeBase([*errors, *invalid.errors]) from None
    if errors:
        raise InvalidKnowledgeBase(errors)
    return parts


# -- finding files ------------------------------------------------------------------------------


def _path_of(source: str | Path) -> Path:
    if isinstance(source, Path) or source.endswith(_SUFFIXES):
        return Path(source)
    return _bundled(source, None)


def _bundled(name: str, place: Place | None) -> Path:
    path = bundled_folder() / f"{name}.yaml"
    if not _NAME.match(name) or not path.is_file():
        raise KnowledgeBaseError(
            f"there is no knowledge base '{name}'",
            name=name,
            suggestion=did_you_mean(name, bundled_names()),
            place=place,
        )
    return path


def _chain(paths: Sequence[Path]) -> list[_Document]:
    """Return the files in the order in which they apply: bases first, each once."""
    done: dict[Path, _Document] = {}

    def visit(path: Path, above: tuple[Path, ...], place: Place | None) -> None:
        real = path.resolve()
        if real in above:
            names = " → ".join(p.stem for p in (*above[above.index(real) :], real))
            raise KnowledgeBaseError(
                f"files extend each other in a circle: {names}", name=path.stem, place=place
            )
        if real in done:
            return
        document = _read(path)
        for base, base_place in document.bases():
            visit(_base_path(base, path.parent, base_place), (*above, real), base_place)
        done[real] = document

    for path in paths:
        visit(path, (), None)
    return list(done.values())


def _base_path(name: str, folder: Path, place: Place) -> Path:
    if not _NAME.match(name):
        raise KnowledgeBaseError(
            f"'{name}' can't be extended",
            name=name,
            suggestion="write a bundled name, or the name of a file in this folder without .yaml",
            place=place,
        )
    beside = folder / f"{name}.yaml"
    return beside if "/" not in name and beside.is_file() else _bundled(name, place)


# -- one file -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Spot:
    """Where a key and its value stand in a file."""

    file: str
    source: str
    key: yaml.Mark
    value: yaml.Node

    def place(self, offset: int, of_key: bool) -> Place:
        """Return the place of the key, or of the value's character at an offset."""
        mark = self.key if of_key else self.value.start_mark
        if of_key or not isinstance(self.value, yaml.ScalarNode):
            return Place(self.file, mark.line + 1, mark.column + 1)
        index = self._index(offset)
        line_start = self.source.rfind("\n", 0, index) + 1
        return Place(self.file, self.source.count("\n", 0, index) + 1, index - line_start + 1)

    def _index(self, offset: int) -> int:
        """Return the index in the file of a character of the value.

        A scalar's value and its source differ in quotes, block marks and white space only, so
        the n-th visible character of the one is the n-th of the other.
        """
        start, end = self.value.start_mark.index, self.value.end_mark.index
        while start < end and self.source[start] in "|>'\"+-0123456789 \t\r\n":
            if self.source[start] == self.value.value[:1]:
                break
            start += 1
        visible = sum(not c.isspace() for c in self.value.value[:offset])
        for index in range(start, end):
            if self.source[index].isspace():
                continue
            if visible == 0:
                return index
            visible -= 1
        return min(start, len(self.source))


@dataclass(frozen=True)
class _Document:
    """The data of one file, and where each part of it stands."""

    file: str
    data: dict[str, Any]
    spots: dict[Keys, _Spot]

    def bases(self) -> Iterator[tuple[str, Place]]:
        extends = self.data.get("extends", [])
        for index, name in enumerate([extends] if isinstance(extends, str) else extends):
            path: Keys = ("extends",) if isinstance(extends, str) else ("extends", index)
            if not isinstance(name, str):
                raise KnowledgeBaseError(
                    f"'{name}' in extends is not a name", place=self.spots[path].place(0, False)
                )
            yield name, self.spots[path].place(0, False)


def _read(path: Path) -> _Document:
    file = str(path)
    text = _text_of(path)
    try:
        node = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError as error:
        raise _broken_yaml(file, error) from None
    except RecursionError:
        raise KnowledgeBaseError("the file is nested too deeply", place=Place(file)) from None
    if not isinstance(node, yaml.MappingNode):
        raise KnowledgeBaseError(
            "the file is not a knowledge base",
            suggestion="it begins with 'version: 1' and 'name: …'",
            place=Place(file, 1, 1),
        )
    builder = _Builder(file, text)
    data = builder.build(node, ())
    return _Document(file, data, builder.spots)


def _text_of(path: Path) -> str:
    place = Place(str(path))
    try:
        if path.stat().st_size > MAXIMUM_BYTES:
            raise KnowledgeBaseError(
                f"the file has more than {MAXIMUM_BYTES} bytes", name=path.name, place=place
            )
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise KnowledgeBaseError(f"the file is not UTF-8 text: {error}", place=place) from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise KnowledgeBaseError(
            f"the file can't be read: {reason}",
            name=path.name,
            suggestion=did_you_mean(path.stem, bundled_names()) if not path.exists() else None,
            place=place,
        ) from None


def _broken_yaml(file: str, error: yaml.YAMLError) -> KnowledgeBaseError:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    problem = getattr(error, "problem", None) or str(error).splitlines()[0]
    place = Place(file, mark.line + 1, mark.column + 1) if mark else Place(file)
    return KnowledgeBaseError(f"this is not YAML: {problem}", place=place)


class _Builder:
    """Turns YAML nodes into plain data and notes where each part stands."""

    def __init__(self, file: str, source: str) -> None:
        self.spots: dict[Keys, _Spot] = {}
        self._file = file
        self._source = source
        self._scalars = yaml.constructor.SafeConstructor()
        self._count = 0

    def build(self, node: yaml.Node, path: Keys) -> Any:
        self._count += 1
        if self._count > MAXIMUM_VALUES or len(path) > MAXIMUM_DEPTH:
            # Also the end of alias bombs and of anchors that contain themselves.
            raise self._error(node, "the file has too many values, or is nested too deeply")
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, path)
        if isinstance(node, yaml.SequenceNode):
            return [
                self._noted((*path, index), child, child.start_mark)
                for index, child in enumerate(node.value)
            ]
        assert isinstance(node, yaml.ScalarNode)
        return self._scalar(node)

    def _noted(self, path: Keys, node: yaml.Node, key: yaml.Mark) -> Any:
        self.spots[path] = _Spot(self._file, self._source, key, node)
        return self.build(node, path)

    def _mapping(self, node: yaml.MappingNode, path: Keys) -> dict[str, Any]:
        data: dict[str, Any] = {}
        for key_node, child in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise self._error(key_node, "a key must be a name")
            key = key_node.value
            if key in data:
                raise self._error(key_node, f"the key '{key}' stands twice", key)
            data[key] = self._noted((*path, key), child, key_node.start_mark)
        return data

    def _scalar(self, node: yaml.ScalarNode) -> str | int | float | bool | None:
        kind = node.tag.rpartition(":")[2]
        if kind == "str" and node.style is None and _FLOAT_WITHOUT_POINT.match(node.value):
            return float(node.value)
        if kind not in ("str", "int", "float", "bool", "null"):
            raise self._error(node, f"values of the kind '{node.tag}' are not allowed", node.value)
        try:
            value: str | int | float | bool | None = self._scalars.construct_object(node)
        except (ValueError, yaml.YAMLError):
            raise self._error(node, f"'{node.value}' is not a value") from None
        return value

    def _error(self, node: yaml.Node, message: str, name: str | None = None) -> KnowledgeBaseError:
        mark = node.start_mark
        return KnowledgeBaseError(
            message, name=name, place=Place(self._file, mark.line + 1, mark.column + 1)
        )


# -- several files ------------------------------------------------------------------------------


@dataclass
class _Merged:
    """The files of a chain applied one after the other."""

    data: dict[str, Any] = field(default_factory=dict)
    spots: dict[Keys, _Spot] = field(default_factory=dict)
    removed_heads: set[str] = field(default_factory=set)

    def place_of(self, path: Keys, offset: int = 0) -> Place | None:
        """Return where a path of keys stands; the nearest known part of it counts.

        Texts such as rules are located by their value, all else by its key.
        """
        while path and path not in self.spots:
            path = path[:-1]
        if not path:
            return None
        spot = self.spots[path]
        is_text = isinstance(spot.value, yaml.ScalarNode) and spot.value.tag.endswith(":str")
        return spot.place(offset, of_key=path[0] == "predicates" or not is_text)

    def key_place(self, path: Keys) -> Place | None:
        """Return where the key of a path stands, if the path is known."""
        return self.spots[path].place(0, of_key=True) if path in self.spots else None


def _merge(chain: Sequence[_Document]) -> _Merged:
    merged = _Merged()
    for document in chain:
        for section in _OWN_SECTIONS:
            _drop(merged, (section,))
        _remove(merged, document)
        _apply(merged, document)
    remaining = {_head_of(rule) for rule in merged.data.get("rules", {}).values()}
    merged.removed_heads -= remaining
    return merged


def _remove(merged: _Merged, document: _Document) -> None:
    removals = document.data.get("remove", {})
    if not isinstance(removals, dict):
        return  # the model of the file reports it
    for section, names in removals.items():
        for index, name in enumerate(names if isinstance(names, list) else []):
            existing = merged.data.get(section, {})
            key = _existing_key(section, name, existing)
            if key is None:
                raise KnowledgeBaseError(
                    f"there is no '{name}' in {section} to remove",
                    name=str(name),
                    suggestion=did_you_mean(str(name), map(_predicate_name, existing)),
                    place=document.spots["remove", section, index].place(0, of_key=False),
                )
            if section == "rules":
                merged.removed_heads.add(_head_of(existing[key]))
            _drop(merged, (section, key))


def _apply(merged: _Merged, document: _Document) -> None:
    def put(target: dict[str, Any], key: str, value: Any, path: Keys) -> None:
        old = target.get(key)
        if isinstance(old, dict) and isinstance(value, dict) and path[:1] != ("rules",):
            _note(merged, document, path)
            for inner, content in value.items():
                put(old, inner, content, (*path, inner))
            return
        _drop(merged, path)
        target[key] = value
        for known in [known for known in document.spots if known[: len(path)] == path]:
            _note(merged, document, known)

    for section, content in document.data.items():
        if section in ("rules", "predicates") and isinstance(content, dict):
            entries = merged.data.setdefault(section, {})
            _note(merged, document, (section,))
            for key, value in content.items():
                replaced = _existing_key(section, key, entries)
                if replaced is not None and replaced not in content:
                    _drop(merged, (section, replaced))
                put(entries, key, value, (section, key))
        else:
            put(merged.data, section, content, (section,))


def _note(merged: _Merged, document: _Document, path: Keys) -> None:
    merged.spots[path] = document.spots[path]


def _drop(merged: _Merged, path: Keys) -> None:
    content: Any = merged.data
    for key in path[:-1]:
        content = content.get(key, {})
    if isinstance(content, dict):
        content.pop(path[-1], None)
    for known in [known for known in merged.spots if known[: len(path)] == path]:
        del merged.spots[known]


def _existing_key(section: str, name: object, entries: Mapping[str, Any]) -> str | None:
    """Return the key of an entry; a predicate is the same whatever its variables are called."""
    if section != "predicates":
        return name if isinstance(name, str) and name in entries else None
    wanted = _predicate_name(str(name))
    return next((key for key in entries if _predicate_name(key) == wanted), None)


def _predicate_name(signature: str) -> str:
    return signature.partition("(")[0].strip()


def _head_of(rule: Any) -> str:
    return _predicate_name(str(rule.get("rule", "") if isinstance(rule, dict) else rule))


# -- the models ---------------------------------------------------------------------------------


def _validated(merged: _Merged) -> KnowledgeBaseFile:
    try:
        return KnowledgeBaseFile.model_validate(merged.data)
    except ValidationError as error:
        raise InvalidKnowledgeBase([_of_pydantic(e, merged) for e in error.errors()]) from None


def _section_errors(
    merged: _Merged, sections: Mapping[str, type[BaseModel]]
) -> list[KnowledgeBaseError]:
    grounding = merged.data.get("grounding", {})
    errors = []
    for name, model in sections.items():
        if not isinstance(grounding, dict) or name not in grounding:
            continue
        try:
            model.model_validate(grounding[name])
        except ValidationError as error:
            path = ("grounding", name)
            errors += [_of_pydantic(e, merged, path, model) for e in error.errors()]
    return errors


def _of_pydantic(
    error: Any, merged: _Merged, above: Keys = (), model: type[BaseModel] = KnowledgeBaseFile
) -> KnowledgeBaseError:
    """Say in our words, with a place, what pydantic found wrong below a path of keys."""
    path: Keys = (*above, *error["loc"])
    name = str(path[-1])
    parent = f" in {'.'.join(map(str, path[:-1]))}" if path[1:] else ""
    if error["type"] == "extra_forbidden":
        return KnowledgeBaseError(
            f"unknown key '{name}'{parent}",
            name=name,
            suggestion=did_you_mean(name, _fields_at(model, error["loc"][:-1])),
            place=merged.key_place(path),
        )
    if error["type"] == "missing":
        place = merged.place_of(path[:-1]) or _first_place(merged)
        return KnowledgeBaseError(f"the key '{name}' is missing{parent}", name=name, place=place)
    message = f"{'.'.join(map(str, path))}: {error['msg'][:1].lower()}{error['msg'][1:]}"
    if not isinstance(error["input"], dict | list):
        message += f", not {error['input']!r}"
    return KnowledgeBaseError(message, name=name, place=merged.place_of(path))


def _first_place(merged: _Merged) -> Place | None:
    spot = next(iter(merged.spots.values()), None)
    return Place(spot.file, 1, 1) if spot else None


def _fields_at(model: type[BaseModel], path: Keys) -> tuple[str, ...]:
    """Return the keys that a model allows at a path of keys."""
    kind: Any = model
    for key in path:
        kind = _child_type(kind, key)
    return tuple(kind.model_fields) if _is_model(kind) else ()


def _child_type(kind: Any, key: str | int) -> Any:
    if _is_model(kind):
        found = kind.model_fields.get(str(key))
        return _bare(found.annotation) if found else None
    arguments = get_args(kind)
    return _bare(arguments[-1]) if arguments else None


def _bare(kind: Any) -> Any:
    """Strip `Annotated` and `| None` off a type."""
    while get_origin(kind) in (Annotated, Union, types.UnionType):
        kind = get_args(kind)[0]
    return kind


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)
