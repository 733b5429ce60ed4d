"""Describes in words what a JSON Schema allows: for the configuration, jobs, and published messages."""

from __future__ import annotations

import json
from typing import Any

from referencepages.markdown import anchor, number

Schema = dict[str, Any]

WORDS = {
    "string": "text",
    "number": "number",
    "integer": "integer",
    "boolean": "true or false",
    "null": "null",
}
PLURALS = {
    "text": "texts",
    "table": "tables",
    "object": "objects",
    "number": "numbers",
    "integer": "integers",
    "number or null": "numbers or nulls",
}


def in_words(schema: Schema, *, optional: bool = False, table: str = "table") -> str:
    """The kind of value and its bounds.

    optional : the value may be left out and is null then, which is not mentioned.
    table : word for a value with named fields, in TOML or in JSON.
    """
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{anchor(name)})"
    if "anyOf" in schema:
        options = [one for one in schema["anyOf"] if not (optional and one == {"type": "null"})]
        return " or ".join(in_words(one, table=table) for one in options)
    if "const" in schema:
        return f"`{json.dumps(schema['const'])}`"
    if "enum" in schema:
        return ", ".join(f"`{json.dumps(value)}`" for value in schema["enum"])
    kind = schema.get("type", "any value")
    if isinstance(kind, list):
        return " or ".join(in_words({**schema, "type": one}, table=table) for one in kind)
    if kind == "array":
        return _array(schema, table)
    if kind == "object":
        more = schema.get("additionalProperties")
        return f"{table} of {in_words(more, table=table)}" if isinstance(more, dict) else table
    if schema.get("format") == "path":
        return "path"
    return WORDS.get(kind, kind) + _bounds(schema)


def _array(schema: Schema, table: str) -> str:
    items = schema.get("items", {})
    least, most = schema.get("minItems"), schema.get("maxItems")
    inner = in_words(items, table=table)
    if least is not None and least == most:
        if items.get("type") == "array":
            return f"{least} rows of {inner}"
        return f"{least} {PLURALS.get(inner, inner)}"
    return f"list of {PLURALS.get(inner, inner)}"


def _bounds(schema: Schema) -> str:
    low, above = schema.get("minimum"), schema.get("exclusiveMinimum")
    high = schema.get("maximum")
    if low is not None and high is not None:
        return f", {number(low)} to {number(high)}"
    parts = []
    if low is not None:
        parts.append(f"{number(low)} or more")
    if above is not None:
        parts.append(f"above {number(above)}")
    if high is not None:
        parts.append(f"up to {number(high)}")
    return "".join(f", {part}" for part in parts)
