"""The JSON Schema of a knowledge base file, made from the pydantic models.

An overlay may leave out what it does not change: entries of the sections that are merged key by
key need all their parts only in a file that extends nothing.
"""

from __future__ import annotations

import json
from typing import Any

from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import core_schema

from sfol.knowledge_base.format import KnowledgeBaseFile

DIALECT = "https://json-schema.org/draft/2020-12/schema"
# Section → the model of its entries, which overlays may give in part.
_MERGED = {
    "entities": "Sort",
    "signals": "Signal",
    "weights": "Weight",
    "terms": "Term",
    "schedules": "Schedule",
}


class _WithDefaults(GenerateJsonSchema):
    """States also the defaults that a factory makes, and leaves out titles like "At Least"."""

    def field_title_should_be_set(self, schema: object) -> bool:
        return False

    def get_default_value(self, schema: core_schema.WithDefaultSchema) -> Any:
        factory = schema.get("default_factory")
        if factory is None:
            return super().get_default_value(schema)
        return factory()  # type: ignore[call-arg]  # ours take no argument


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of a knowledge base file or overlay, as plain data."""
    schema = KnowledgeBaseFile.model_json_schema(schema_generator=_WithDefaults)
    needed = {section: schema["$defs"][model].pop("required") for section, model in _MERGED.items()}
    return {
        "$schema": DIALECT,
        **schema,
        "title": "sfol knowledge base",
        "if": {"not": {"required": ["extends"]}},
        "then": {
            "properties": {
                section: {"additionalProperties": {"required": names}}
                for section, names in needed.items()
            }
        },
    }


def schema_text() -> str:
    """Return the JSON Schema as the text of the file that editors read."""
    return json.dumps(json_schema(), indent=2, ensure_ascii=False) + "\n"
