"""Tables of the keys that a file may have, made from the pydantic models that check it."""

from __future__ import annotations

import importlib
import inspect
import typing
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

LIMITS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤", "min_length": "at least"}
NAMES: Mapping[Any, str] = {
    str: "text",
    int: "integer",
    float: "number",
    bool: "true or false",
    type(None): "null",
}


def keys(name: str) -> str:
    """Return a table of the keys of a pydantic model, then those of every model within it."""
    module, _, model = name.rpartition(".")
    first, *parts = _with_parts(getattr(importlib.import_module(module), model))
    sections = [f"### `{part.__name__}`\n\n{_key_table(part)}" for part in parts]
    return "\n\n".join([_key_table(first), *sections])


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', '∣') for cell in line)} |" for line in lines)


def one_line(text: str) -> str:
    """Return a docstring's text as one line of Markdown."""
    return " ".join(text.split()).replace("``", "`")


def _with_parts(model: type[BaseModel]) -> list[type[BaseModel]]:
    found = [model]
    for part in found:  # grows while it is walked
        for field in part.model_fields.values():
            found += [inner for inner in _models_in(field.annotation) if inner not in found]
    return found


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if _is_model(annotation):
        yield annotation
    for argument in typing.get_args(annotation):
        yield from _models_in(argument)


def _is_model(annotation: Any) -> bool:
    return inspect.isclass(annotation) and issubclass(annotation, BaseModel)


def _key_table(model: type[BaseModel]) -> str:
    rows = [
        (f"`{field.alias or key}`", _type_text(field), _default_text(field), _meaning(field))
        for key, field in model.model_fields.items()
    ]
    return f"{one_line(inspect.getdoc(model) or '')}\n\n" + table(
        ("key", "type", "default", "meaning"), rows
    )


def _type_text(field: FieldInfo) -> str:
    limits = [
        f", {sign} {getattr(item, limit)}"
        for item in field.metadata
        for limit, sign in LIMITS.items()
        if hasattr(item, limit)
    ]
    return "".join([_type_name(field.annotation), *limits])


def _type_name(annotation: Any) -> str:
    if _is_model(annotation):
        return f"[`{annotation.__name__}`](#{annotation.__name__.lower()})"
    if annotation in NAMES:
        return NAMES[annotation]
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Literal:
        return " or ".join(f"`{value}`" for value in arguments)
    if origin is typing.Annotated:
        return _type_name(arguments[0])
    return _compound(origin, [_type_name(part) for part in arguments if part is not ...])


def _compound(origin: Any, parts: Sequence[str]) -> str:
    if origin is dict:
        return f"mapping of {' → '.join(parts)}"
    if origin in (list, tuple) and len(parts) == 1:
        return f"list of {parts[0]}"
    if origin is tuple:
        return f"[{', '.join(parts)}]"
    return " or ".join(parts)


def _default_text(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    default = field.get_default(call_default_factory=True)
    if isinstance(default, BaseModel):
        return "its own defaults"
    if isinstance(default, tuple):
        default = list(default)
    words = {"None": "null", "True": "`true`", "False": "`false`"}
    words |= dict.fromkeys(("", "[]", "{}"), "empty")
    return words.get(str(default), f"`{default}`")


def _meaning(field: FieldInfo) -> str:
    text = (field.description or "").rstrip(".")
    return one_line(text[:1].upper() + text[1:])
