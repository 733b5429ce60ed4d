"""The part of JSON Schema that config/edged.schema.json uses, so that no test needs another package.

Stricter in one point: a field that the schema does not name is a violation. Readers must ignore unknown
fields, but edged must not publish undocumented ones.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

SCHEMA_FILE = Path(__file__).parents[2] / "config" / "edged.schema.json"
KNOWN = {
    *("$schema", "title", "description", "$defs", "$ref", "type", "properties", "required"),
    *("additionalProperties", "items", "minItems", "maxItems", "enum", "const", "anyOf", "oneOf", "minimum"),
}
TYPES: dict[str, tuple[type, ...]] = {
    "object": (dict,),
    "array": (list,),
    "string": (str,),
    "integer": (int,),
    "number": (int, float),
    "boolean": (bool,),
    "null": (type(None),),
}


def load_schema() -> dict[str, Any]:
    """The published schema."""
    schema: dict[str, Any] = json.loads(SCHEMA_FILE.read_text())
    return schema


def violations(value: Any, schema: Any, root: dict[str, Any], place: str = "$") -> list[str]:
    """All violations of the schema by `value`; empty if it conforms."""
    if isinstance(schema, bool):
        return [] if schema else [f"{place}: not allowed"]
    unknown = schema.keys() - KNOWN
    assert not unknown, f"the checker does not know {unknown}"
    if "$ref" in schema:
        name = schema["$ref"].removeprefix("#/$defs/")
        return violations(value, root["$defs"][name], root, place)
    found: list[str] = []
    for word, wanted in (("anyOf", None), ("oneOf", 1)):
        if word in schema:
            fits = sum(not violations(value, option, root, place) for option in schema[word])
            if fits == 0 or (wanted and fits != wanted):
                found.append(f"{place}: fits {fits} options of {word}")
    if "const" in schema and value != schema["const"]:
        found.append(f"{place}: {value!r} is not {schema['const']!r}")
    if "enum" in schema and value not in schema["enum"]:
        found.append(f"{place}: {value!r} is not one of {schema['enum']}")
    if "type" in schema and not _has_type(value, schema["type"]):
        return [*found, f"{place}: {type(value).__name__} is not {schema['type']}"]
    if "minimum" in schema and value < schema["minimum"]:
        found.append(f"{place}: {value} is less than {schema['minimum']}")
    if isinstance(value, dict):
        found += _object_violations(value, schema, root, place)
    if isinstance(value, list):
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
            found.append(f"{place}: {len(value)} items")
        for index, item in enumerate(value):
            found += violations(item, schema.get("items", True), root, f"{place}[{index}]")
    return found


def _object_violations(
    value: dict[str, Any], schema: dict[str, Any], root: dict[str, Any], place: str
) -> list[str]:
    properties = schema.get("properties", {})
    found = [f"{place}.{name}: missing" for name in schema.get("required", []) if name not in value]
    for name, item in value.items():
        inner = properties.get(name, schema.get("additionalProperties", not properties))
        found += violations(item, inner, root, f"{place}.{name}")
    return found


def _has_type(value: Any, wanted: str | list[str]) -> bool:
    names = [wanted] if isinstance(wanted, str) else wanted
    if isinstance(value, bool):
        return "boolean" in names
    return any(isinstance(value, TYPES[name]) for name in names)
