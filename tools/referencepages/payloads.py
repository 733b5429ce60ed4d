"""Zenoh's keys, and every field of the published messages, from the schema."""

from __future__ import annotations

import json
from collections.abc import Iterator

from edged.adapters.zenoh.keys import KEYS, PREFIX, TRIGGER_PARAMETERS
from referencepages.jsonschema import Schema, in_words
from referencepages.markdown import ROOT, anchor, code, table

KINDS = {
    "kept": "published, last one kept",
    "published": "published",
    "queryable": "queryable",
    "token": "liveliness token",
}


def schema() -> Schema:
    """The published schema."""
    loaded: Schema = json.loads((ROOT / "config" / "edged.schema.json").read_text("utf-8"))
    return loaded


def keys() -> str:
    """Every key of a cell."""
    rows = (
        (
            code(f"{PREFIX}/<cell>/{key.path}"),
            KINDS[key.kind],
            f"[{key.message}_message](#{anchor(key.message + '_message')})" if key.message else "",
            key.help,
        )
        for key in KEYS
    )
    return table(("key", "", "message", "what"), rows)


def trigger() -> str:
    """Parameters of a trigger."""
    rows = (
        (code(name), code(default) if default else "", text)
        for name, (default, text) in TRIGGER_PARAMETERS.items()
    )
    return table(("parameter", "default", "meaning"), rows)


def fields(definition: Schema, prefix: str = "") -> Iterator[tuple[str, str, str]]:
    """Name, value and meaning of each field; fields of a nested table follow it, with its name as prefix."""
    required = definition.get("required", [])
    for name, one in definition.get("properties", {}).items():
        meaning = one.get("description", "")
        if name not in required:
            meaning = f"{meaning}; may be left out" if meaning else "may be left out"
        yield code(prefix + name), in_words(one, table="object"), meaning
        inner = one.get("items", one)
        if "properties" in inner:
            mark = "[]." if "items" in one else "."
            yield from fields(inner, f"{prefix}{name}{mark}")


def messages() -> str:
    """A section for each message and each of its parts."""
    parts = []
    for name, definition in schema()["$defs"].items():
        description = definition["description"]
        parts += [
            f"### {name}",
            description[:1].upper() + description[1:] + ".",
            table(("field", "value", "meaning"), fields(definition)),
        ]
    return "\n\n".join(parts)


PARTS = {"keys": keys, "trigger": trigger, "messages": messages}
