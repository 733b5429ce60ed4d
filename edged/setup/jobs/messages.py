"""Orders to the worker process and its answers as CBOR: values of edged's own kinds, and nothing that is run.

The worker reads strangers' files with libraries in C++. Whoever takes it over may answer what they like; what
is read here is bounded by the length of the data, and is made of numbers, texts, arrays, and of dataclasses,
models and enumerations of edged, filled as they are without a call of their own. That their fields are of the
kinds that they say is not checked.

A value that CBOR has no word for is a list that begins with one for it: `["tuple", 1, 2]`.
Source: RFC 8949.
"""

from __future__ import annotations

import dataclasses
import enum
import re
from collections.abc import Mapping
from datetime import datetime
from importlib import import_module
from pathlib import Path, PurePath
from typing import Any

import cbor2
import numpy as np
from pydantic import BaseModel

from edged import errors
from edged.cbor import decode_item
from edged.errors import UserError

MAX_DEPTH = 256
"""Of lists in lists; a job in a result has a few dozen."""
_SEQUENCES: dict[type, str] = {list: "list", tuple: "tuple", frozenset: "set"}
_MODULE = re.compile(r"edged(?:\.[a-z][a-z0-9_]*)+")
_ARRAY_KINDS = "biufUS"
_PARAMS = {str, int, float}
"""Kinds of what a `UserError` holds."""
_DAMAGE = (
    cbor2.CBORDecodeError,
    TypeError,
    LookupError,
    AttributeError,
    ArithmeticError,
    ImportError,
    RecursionError,
)
"""What reading anything else raises, but for ValueError."""


def encode_message(value: object) -> bytes:
    """A value as CBOR. Raises `TypeError` for one of another kind."""
    return cbor2.dumps(_plain(value))


def decode_message(data: bytes) -> Any:
    """The value. Raises `ValueError` for anything that `encode_message` does not write."""
    try:
        return _value(decode_item(data, MAX_DEPTH))
    except _DAMAGE as error:
        raise ValueError(f"no message of a worker: {error!r}") from error


def _plain(value: Any) -> Any:
    """What CBOR has words for."""
    if isinstance(value, enum.Enum):
        return ["member", *_name(type(value)), _plain(value.value)]
    if isinstance(value, np.ndarray | np.generic):
        if value.dtype.kind not in _ARRAY_KINDS:
            raise TypeError(f"an array of {value.dtype} is no message")
        if isinstance(value, np.generic):
            return ["scalar", value.dtype.str, value.tobytes()]
        return ["array", value.dtype.str, list(value.shape), value.tobytes()]
    if value is None or type(value) in (bool, int, float, str, bytes):
        return value
    if isinstance(value, PurePath):
        return ["path", str(value)]
    if isinstance(value, datetime):
        return ["time", value.isoformat()]
    if isinstance(value, BaseModel):
        stated = {name: _plain(getattr(value, name)) for name in value.model_fields_set}
        return ["model", *_name(type(value)), stated]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = (field.name for field in dataclasses.fields(value))
        return ["fields", *_name(type(value)), *(_plain(getattr(value, name)) for name in fields)]
    if isinstance(value, Mapping):
        return ["dict", *([_plain(key), _plain(item)] for key, item in value.items())]
    if isinstance(value, UserError):
        return ["error", type(value).__name__, str(value), value.code, _plain(dict(value.params))]
    kind = _SEQUENCES.get(type(value))
    if kind is None:
        raise TypeError(f"{type(value).__module__}.{type(value).__qualname__} is no message")
    return [kind, *map(_plain, value)]


def _value(plain: Any) -> Any:
    """Raises as `decode_message`, or another error of those that it catches."""
    if plain is None or type(plain) in (bool, int, float, str, bytes):
        return plain
    if not isinstance(plain, list):
        raise TypeError(f"{type(plain).__name__} is no message")
    kind, *rest = plain
    match kind:
        case "list":
            return [*map(_value, rest)]
        case "tuple":
            return (*map(_value, rest),)
        case "set":
            return frozenset(map(_value, rest))
        case "dict":
            return {_value(key): _value(item) for key, item in rest}
        case "path":
            (path,) = rest
            return Path(path)
        case "time":
            (at,) = rest
            return datetime.fromisoformat(at)
        case "scalar":
            kind_of, data = rest
            return _array(kind_of, [], data)[()]
        case "array":
            return _array(*rest)
        case "error":
            return user_error(*map(_value, rest))
        case "member":
            module, name, value = rest
            return _class(module, name, enum.Enum)(_value(value))
        case "model":
            module, name, stated = rest
            return _modelled(
                _class(module, name, BaseModel), {key: _value(item) for key, item in stated.items()}
            )
        case "fields":
            module, name, *values = rest
            return _filled(_class(module, name, object), [*map(_value, values)])
    raise ValueError(f"{str(kind)[:20]!r} begins no message")


def user_error(kind: str, message: str, code: str, params: dict[str, Any]) -> UserError:
    """An error by the name of its kind; a plain `UserError` for one with fields of its own.

    Raises `TypeError` for what no error has.
    """
    are_texts = type(params) is dict and all(type(text) is str for text in (kind, message, code, *params))
    if not are_texts or not _PARAMS.issuperset(map(type, params.values())):
        raise TypeError("no error of a worker")
    found = getattr(errors, kind, UserError)
    is_kind = isinstance(found, type) and issubclass(found, UserError)
    is_plain = is_kind and found.__init__ is UserError.__init__
    error: UserError = (found if is_plain else UserError)(message, code)
    error.params = params
    return error


def _name(kind: type) -> tuple[str, str]:
    return kind.__module__, kind.__qualname__


def _class(module: str, name: str, base: type) -> Any:
    """A class of edged by its name, where it is defined; nothing else that a module holds."""
    if not _MODULE.fullmatch(module):
        raise ValueError(f"{module[:60]!r} is no module of edged")
    found = getattr(import_module(module), name)
    if not isinstance(found, type) or found.__module__ != module or not issubclass(found, base):
        raise ValueError(f"{module}.{name[:60]} is no message")
    return found


def _modelled(kind: type[BaseModel], stated: dict[str, Any]) -> BaseModel:
    """A model with these values, and defaults in its other fields. Raises `TypeError` for other fields."""
    if not stated.keys() <= kind.model_fields.keys():
        raise TypeError(f"{kind.__qualname__} has other fields")
    return kind.model_construct(set(stated), **stated)


def _filled(kind: type, values: list[Any]) -> Any:
    """An object of a dataclass with these values in its fields. Raises `TypeError` for another class."""
    if not dataclasses.is_dataclass(kind):
        raise TypeError(f"{kind.__qualname__} is no message")
    made = object.__new__(kind)
    for field, value in zip(dataclasses.fields(kind), values, strict=True):
        object.__setattr__(made, field.name, value)
    return made


def _array(kind: str, shape: list[int], data: bytes) -> Any:
    if not re.fullmatch(rf"[<>|][{_ARRAY_KINDS}][0-9]{{1,4}}", kind):
        raise TypeError(f"an array of {kind[:20]} is no message")
    return np.frombuffer(data, np.dtype(kind)).reshape(shape).copy()
