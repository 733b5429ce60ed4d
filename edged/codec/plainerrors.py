"""Errors passed between processes of edged: their class, text and further attributes."""

from __future__ import annotations

from typing import Any

from edged import errors
from edged.errors import EdgedError, UserError

_PLAIN = (str, int, float, bool, type(None))
"""Types of an error's attributes, and of the items of its lists and dicts."""


def plain_error(error: EdgedError | OSError) -> dict[str, Any]:
    """Convert an error to a dict for JSON and CBOR."""
    if isinstance(error, OSError):
        number = {"errno": error.errno or 0}
        return {"kind": "OSError", "text": error.strerror or str(error), "fields": number}
    return {"kind": type(error).__name__, "text": str(error), "fields": dict(vars(error))}


def error_of(kind: str, text: str, fields: dict[str, Any]) -> EdgedError | OSError:
    """Recreate the error that the other process raised; an `EdgedError` for an unknown class.

    Raises `TypeError` for invalid content.
    """
    if not (type(kind) is type(text) is str and type(fields) is dict and all(map(_is_plain, fields.items()))):
        raise TypeError("no error")
    if kind == "OSError" and type(fields.get("errno")) is int:
        return OSError(fields["errno"], text)
    found = getattr(errors, kind, None)
    if not (isinstance(found, type) and issubclass(found, EdgedError)):
        return EdgedError(text)
    error = found.__new__(found, text)
    error.args = (text,)
    vars(error).update(fields)
    if isinstance(error, UserError) and not (
        type(vars(error).get("code")) is str and type(vars(error).get("params")) is dict
    ):
        raise TypeError(f"no {kind}: it has a code and its params")
    return error


def _is_plain(field: tuple[Any, Any]) -> bool:
    name, value = field
    if type(name) is not str or not name.isidentifier():
        return False
    if type(value) is dict:
        return all(type(key) is str and type(part) in _PLAIN for key, part in value.items())
    return type(value) in _PLAIN or (
        type(value) in (list, tuple) and all(type(part) in _PLAIN for part in value)
    )
