"""YAML files → a checked knowledge base: safe, strict, with file, line and column on every error.

Loading runs no code and follows no path that a file names outside its own folder and the bundled
knowledge bases. Each file's shape is checked before anything is read from its data; then the files
of a chain are merged, and the whole is checked.
"""

from __future__ import annotations

import re
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from sfol import strict_yaml
from sfol.errors import (
    MAXIMUM_ERRORS,
    FileError,
    InvalidKnowledgeBase,
    KnowledgeBaseError,
    Place,
    SfolError,
    did_you_mean,
    expect,
    torn_apart,
)
from sfol.knowledge_base.checking import check
from sfol.knowledge_base.format import KnowledgeBaseFile
from sfol.knowledge_base.parts import Parts
from sfol.strict_yaml import Document, Keys, Places

_NAME = re.compile(r"[a-z0-9_]+(/[a-z0-9_]+)*\Z")
_SUFFIXES = (".yaml", ".yml")
# Where an entry is replaced whole: a rule with its description, a fact with its settings.
_WHOLE = ("rules", "facts")
# What describes one file alone and is not handed on to a file that extends it.
_OWN_SECTIONS = ("extends", "remove", "tests", "description")


def bundled_folder() -> Path:
    """Return the folder of the bundled knowledge bases: of the package, or of a checkout."""
    package = Path(__file__).resolve().parents[1]
    inside = package / "rules"  # as a wheel has it
    return inside if inside.is_dir() else package.parent / "rules"


def bundled_names() -> tuple[str, ...]:
    """Return the names that `load` and `extends` know, such as ``aeb``."""
    folder = bundled_folder()
    return tuple(
        sorted(
            str(p.relative_to(folder).with_suffix("").as_posix()) for p in folder.rglob("*.yaml")
        )
    )


def load(
    *sources: str | Path,
    sections: Mapping[str, type[BaseModel]] | None = None,
    texts: Mapping[Path, str] | None = None,
) -> Parts:
    """Read knowledge bases and what they extend, and apply them left to right.

    Args:
        sources: paths of files (ending in .yaml or .yml), or names of bundled knowledge bases.
        sections: models of the sections of `grounding` that are to be checked too.
        texts: what files are read to say instead of what they do, by resolved path.

    Raises:
        InvalidKnowledgeBase: with every error found.
    """
    if not sources:
        raise KnowledgeBaseError("no knowledge base is named", suggestion="such as load('aeb')")
    try:
        chain = _chain([_path_of(source) for source in sources], texts or {})
        merged = _merge(chain)
    except InvalidKnowledgeBase:
        raise
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
    expect(source, (str, Path), "a knowledge base", "give a path, or the name of a bundled one")
    if isinstance(source, Path) or source.endswith(_SUFFIXES):
        return Path(source)
    return _bundled(source, None)


def _bundled(name: str, place: Place | None) -> Path:
    if name not in bundled_names():
        raise KnowledgeBaseError(
            f"there is no knowledge base '{name}'",
            name=name,
            suggestion=did_you_mean(name, bundled_names()),
            place=place,
        )
    return bundled_folder() / f"{name}.yaml"


def _chain(paths: Sequence[Path], texts: Mapping[Path, str]) -> list[Document]:
    """Return the files in the order in which they apply: bases first, each once."""
    done: dict[Path, Document] = {}

    def visit(path: Path, above: tuple[Path, ...], place: Place | None) -> None:
        real = _real(path)
        if real in above:
            names = " → ".join(p.stem for p in (*above[above.index(real) :], real))
            raise KnowledgeBaseError(
                f"files extend each other in a circle: {names}", name=path.stem, place=place
            )
        if real in done:
            return
        document = _read(path, texts.get(real))
        for base, base_place in _bases(document):
            visit(_base_path(base, path.parent, base_place), (*above, real), base_place)
        done[real] = document

    for path in paths:
        visit(path, (), None)
    return list(done.values())


def _real(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError):  # links in a circle, a name with a null character
        raise FileError(
            "the file can't be read: its name leads nowhere", name=path.name, place=Place(str(path))
        ) from None


def _base_path(name: str, folder: Path, place: Place | None) -> Path:
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


def _read(path: Path, text: str | None) -> Document:
    """Return a file whose shape is that of a knowledge base, though parts may be missing."""
    try:
        document = strict_yaml.read(path) if text is None else strict_yaml.parse(text, str(path))
    except FileError as error:
        if error.suggestion or path.exists():
            raise
        raise FileError(
            error.message,
            name=error.name,
            suggestion=did_you_mean(path.stem, bundled_names()),
            place=error.place,
        ) from None
    errors = _shape_errors(document)
    if errors:
        raise InvalidKnowledgeBase(errors)
    return document


def _shape_errors(document: Document) -> list[KnowledgeBaseError]:
    """Return what is wrong with a file whatever it extends; what it lacks may stand in its base."""
    try:
        KnowledgeBaseFile.model_validate(document.data)
    except ValidationError as invalid:
        wrong = [error for error in invalid.errors() if error["type"] != "missing"]
        return _in_our_words(wrong, document.places)
    return []


def _bases(document: Document) -> Iterator[tuple[str, Place | None]]:
    extends = document.data.get("extends", [])
    if isinstance(extends, str):
        yield extends, _value_place(document, ("extends",))
        return
    for index, name in enumerate(extends):
        yield name, _value_place(document, ("extends", index))


def _value_place(document: Document, path: Keys) -> Place | None:
    spot = document.places.find(path)
    return spot.of_value() if spot else None


# -- several files ------------------------------------------------------------------------------


@dataclass
class _Merged:
    """The files of a chain applied one after the other.

    Attributes:
        data: as one file would have it.
        places: where each part of it stands; the tree has the shape of the data.
        keys: section → name → key of the section, where a key has variables, too.
        removed_heads: heads that lost rules to an overlay.
    """

    data: dict[str, Any] = field(default_factory=dict)
    places: Places = field(default_factory=Places)
    keys: dict[str, dict[str, str]] = field(
        default_factory=lambda: {section: {} for section in _NAME_OF}
    )
    removed_heads: set[str] = field(default_factory=set)

    def place_of(self, path: Keys, offset: int = 0) -> Place | None:
        """Return where a path of keys stands; the nearest known part of it counts.

        Texts such as rules are located by their value, all else by its key.
        """
        return _place_of(self.places, path, offset)


def _place_of(places: Places, path: Keys, offset: int = 0) -> Place | None:
    spot = places.nearest(path)
    if spot is None:
        return None
    # A predicate, or a fact as long as its formula is not meant, is what the key says.
    by_key = path[0] in ("predicates", "attributes") or (path[0] == "facts" and len(path) == 2)
    return spot.of_value(offset) if spot.is_text and not by_key else spot.of_key()


def _merge(chain: Sequence[Document]) -> _Merged:
    merged = _Merged()
    for document in chain:
        for section in _OWN_SECTIONS:
            _drop(merged.data, merged.places, section)
        _remove(merged, document)
        _apply(merged, document)
    remaining = {_head_of(rule) for rule in merged.data.get("rules", {}).values()}
    merged.removed_heads -= remaining
    return merged


def _remove(merged: _Merged, document: Document) -> None:
    for section, names in document.data.get("remove", {}).items():
        entries = merged.data.get(section, {})
        for index, name in enumerate(names):
            key = _existing_key(merged, section, name)
            if key is None:
                raise KnowledgeBaseError(
                    f"there is no '{name}' in {section} to remove",
                    name=name,
                    suggestion=did_you_mean(
                        name, entries if section == "facts" else map(_predicate_name, entries)
                    ),
                    place=_value_place(document, ("remove", section, index)),
                )
            if section == "rules":
                merged.removed_heads.add(_head_of(entries[key]))
            _remove_entry(merged, section, key)


def _apply(merged: _Merged, document: Document) -> None:
    for section, content in document.data.items():
        if section in _NAME_OF:
            _replace_keys(merged, section, content)
        if section in _WHOLE:
            for name in content:
                _drop(merged.data.get("rules", {}), merged.places.below.get("rules"), name)
        _put(merged.data, merged.places, section, content, document.places.below[section])


def _replace_keys(merged: _Merged, section: str, content: Mapping[str, Any]) -> None:
    for key in content:
        replaced = _existing_key(merged, section, key)
        if replaced is not None and replaced not in content:
            _remove_entry(merged, section, replaced)
        merged.keys[section][_NAME_OF[section](key)] = key


def _put(data: dict[str, Any], places: Places, key: str, value: Any, value_places: Places) -> None:
    """Set an entry; of two mappings the entries are set one by one."""
    old = data.get(key)
    if not (isinstance(old, dict) and isinstance(value, dict)):
        _drop(data, places, key)  # so that what replaces it stands at the end
        data[key], places.below[key] = value, value_places
        return
    below = places.below[key]
    below.spot = value_places.spot
    for inner, content in value.items():
        _put(old, below, inner, content, value_places.below[inner])


def _drop(data: dict[str, Any], places: Places | None, key: str) -> None:
    data.pop(key, None)
    if places:
        places.below.pop(key, None)


def _remove_entry(merged: _Merged, section: str, key: str) -> None:
    _drop(merged.data[section], merged.places.below[section], key)
    if section in _NAME_OF:
        del merged.keys[section][_NAME_OF[section](key)]


def _existing_key(merged: _Merged, section: str, name: str) -> str | None:
    """Return the key of an entry; it is the same whatever its variables are called."""
    if section in _NAME_OF:
        return merged.keys[section].get(_NAME_OF[section](name))
    return name if name in merged.data.get(section, {}) else None


def _predicate_name(signature: str) -> str:
    return signature.partition("(")[0].strip()


def _fact_name(signature: str) -> str:
    return re.sub(r"\s+", "", re.sub(r"\w+\s+in\s+", "", signature))


# Sections whose keys have variables → what of a key is its name.
_NAME_OF: Mapping[str, Callable[[str], str]] = {
    "predicates": _predicate_name,
    "attributes": _predicate_name,
    "facts": _fact_name,
}


def _head_of(rule: Any) -> str:
    text = str(rule.get("rule", "") if isinstance(rule, dict) else rule)
    return _predicate_name(text.partition(":-")[0])


# -- the models ---------------------------------------------------------------------------------


def _validated(merged: _Merged) -> KnowledgeBaseFile:
    try:
        return KnowledgeBaseFile.model_validate(merged.data)
    except ValidationError as invalid:
        raise InvalidKnowledgeBase(_in_our_words(invalid.errors(), merged.places)) from None


def _section_errors(
    merged: _Merged, sections: Mapping[str, type[BaseModel]]
) -> list[KnowledgeBaseError]:
    grounding = merged.data.get("grounding", {})
    errors = []
    for name, model in sections.items():
        if name not in grounding:
            continue
        try:
            model.model_validate(grounding[name])
        except ValidationError as invalid:
            above = ("grounding", name)
            errors += _in_our_words(invalid.errors(), merged.places, above, model)
    return errors


def _in_our_words(
    errors: Sequence[Any],
    places: Places,
    above: Keys = (),
    model: type[BaseModel] = KnowledgeBaseFile,
) -> list[KnowledgeBaseError]:
    """Return what pydantic found wrong below a path of keys: one error for each place."""
    first: dict[Keys, Any] = {}
    for error in errors:
        # Where several kinds are allowed, pydantic complains once for each of them.
        first.setdefault((error["type"] == "missing", *_path_of_error(error, places, above)), error)
    return [_of_pydantic(e, places, above, model) for e in [*first.values()][:MAXIMUM_ERRORS]]


def _path_of_error(error: Any, places: Places, above: Keys) -> Keys:
    """Return the keys that lead to an error, without those that name one of several kinds."""
    path: Keys = (*above, *error["loc"])
    if error["type"] in ("missing", "extra_forbidden"):
        return path
    known = 0
    while known < len(path) and places.find(path[: known + 1]) is not None:
        known += 1
    return path[: max(known, len(above))] or path


def _of_pydantic(
    error: Any, places: Places, above: Keys, model: type[BaseModel]
) -> KnowledgeBaseError:
    path = _path_of_error(error, places, above)
    name = str(path[-1])
    parent = f" in {'.'.join(map(str, path[:-1]))}" if path[1:] else ""
    if error["type"] == "extra_forbidden":
        spot = places.find(path)
        return KnowledgeBaseError(
            f"unknown key '{name}'{parent}",
            name=name,
            suggestion=torn_apart(name) or did_you_mean(name, _fields_at(model, error["loc"][:-1])),
            place=spot.of_key() if spot else None,
        )
    if error["type"] == "missing":
        place = _place_of(places, path[:-1]) or _first_place(places)
        return KnowledgeBaseError(f"the key '{name}' is missing{parent}", name=name, place=place)
    message = f"{'.'.join(map(str, path))}: {error['msg'][:1].lower()}{error['msg'][1:]}"
    if not isinstance(error["input"], dict | list):
        message += f", not {_short(error['input'])}"
    place = _place_of(places, path)
    return KnowledgeBaseError(message, name=name, suggestion=torn_apart(name), place=place)


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}…"


def _first_place(places: Places) -> Place | None:
    spot = next((below.spot for below in places.below.values()), None)
    return Place(spot.file, 1, 1) if spot else None


def _fields_at(model: type[BaseModel], path: Keys) -> tuple[str, ...]:
    """Return the keys that a model allows at a path of keys."""
    kind: Any = model
    for key in path:
        kind = _child_type(kind, key)
    return _keys_of(kind) if _is_model(kind) else ()


def _keys_of(model: type[BaseModel]) -> tuple[str, ...]:
    return tuple(found.alias or name for name, found in model.model_fields.items())


def _child_type(kind: Any, key: str | int) -> Any:
    if _is_model(kind):
        found = next((f for n, f in kind.model_fields.items() if (f.alias or n) == key), None)
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
