"""Every table and key of the configuration, from the model that reads it."""

from __future__ import annotations

import json
import typing
from collections.abc import Iterator

from pydantic import BaseModel, SecretStr
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from edged.config.cameras import MODE_KEYS
from edged.config.configuration import Config
from referencepages.jsonschema import Schema, in_words
from referencepages.markdown import code, first_line, table

ALIKE = {"cameras.right": "cameras.left", "limits.keep_out": "limits.box"}
"""Sections that share the table of another one."""
HEAD = ("key", "value", "default", "meaning")


def sections(model: type[BaseModel] = Config, path: str = "") -> Iterator[tuple[str, type[BaseModel], bool]]:
    """Dotted path and model of every table, in the order of the model, and whether it is a list of tables."""
    for name, field in model.model_fields.items():
        inner = model_of(field)
        if inner is not None:
            here = f"{path}.{name}" if path else name
            yield here, inner, typing.get_origin(field.annotation) is list
            yield from sections(inner, here)


def heading(path: str, is_list: bool) -> str:
    """Header of the table in the file."""
    return code(f"[[{path}]]" if is_list else f"[{path}]")


def body(model: type[BaseModel], schema: Schema) -> list[str]:
    """Its purpose, and its keys, if it has any that are no tables."""
    keys = list(rows(model, schema))
    return [first_line(model) + ".", *([table(HEAD, keys)] if keys else [])]


def model_of(field: FieldInfo) -> type[BaseModel] | None:
    """The model of a table; None for a key. A list of tables counts as its table."""
    kinds = [field.annotation, *getattr(field.annotation, "__args__", ())]
    return next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), None)


def default_of(field: FieldInfo) -> str:
    """Default value as written in TOML; "" if the only default is to leave it out."""
    value = field.get_default(call_default_factory=True)
    if value is PydanticUndefined:
        return "required"
    if value is None or value in ("", [], {}, SecretStr("")):
        return ""
    return code(json.dumps(value))


def rows(model: type[BaseModel], schema: Schema) -> Iterator[tuple[str, str, str, str]]:
    """Key, value, default and meaning of each key that is no table."""
    for name, field in model.model_fields.items():
        if model_of(field) is None:
            one = schema["properties"][name]
            yield code(name), in_words(one, optional=True), default_of(field), field.description or ""


def all_keys() -> str:
    """A section for each table."""
    definitions = Config.model_json_schema()["$defs"]
    parts = []
    for path, model, is_list in sections():
        if any(path == twin or path.startswith(twin + ".") for twin in ALIKE):
            continue
        paths = [
            path,
            *(path.replace(first, twin) for twin, first in ALIKE.items() if path.startswith(first)),
        ]
        parts.append("## " + ", ".join(heading(one, is_list) for one in paths))
        parts += body(model, definitions[model.__name__])
    return "\n\n".join(parts)


def modes() -> str:
    """Keys that belong to each trigger mode."""
    return table(
        ("`mode`", "keys"),
        (
            (code(mode), ", ".join(code(key) for key in sorted(keys)) or "none")
            for mode, keys in MODE_KEYS.items()
        ),
    )


PARTS = {"keys": all_keys, "trigger-modes": modes}
