"""Checks whether a value has the type that a field is declared with."""

from __future__ import annotations

import typing
from collections import abc
from collections.abc import Callable
from dataclasses import fields
from functools import cache
from types import UnionType
from typing import Any, Literal, Union

import numpy as np
from pydantic import JsonValue

Check = Callable[[Any], bool]
_NUMBERS: dict[type, tuple[type, ...]] = {
    bool: (bool, np.bool_),
    int: (int, np.integer),
    float: (int, float, np.integer, np.floating),
}


@cache
def checks_of(kind: type) -> dict[str, Check]:
    """Checks of the fields of a dataclass, by name."""
    hints = typing.get_type_hints(kind)
    return {field.name: check_of(hints[field.name]) for field in fields(kind)}


@cache
def check_of(hint: Any) -> Check:
    """Check for a type hint. A list is accepted as a homogeneous tuple, and the other way round.

    Raises `TypeError` for a type that cannot be checked here.
    """
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if hint in (Any, object):
        return lambda _value: True
    if hint is JsonValue:
        return _is_json
    if hint is None or hint is type(None):
        return lambda value: value is None
    if origin in (Union, UnionType):
        any_of = [check_of(part) for part in parts]
        return lambda value: any(check(value) for check in any_of)
    if origin is Literal:
        return lambda value: any(type(value) is type(part) and value == part for part in parts)
    if origin is np.ndarray:
        return _array_check(parts[1])
    if origin is tuple and not (len(parts) == 2 and parts[1] is ...):
        each = [check_of(part) for part in parts]
        return lambda value: (
            isinstance(value, tuple)
            and len(value) == len(each)
            and all(check(part) for check, part in zip(each, value, strict=True))
        )
    if origin in (abc.Mapping, dict):
        key_check, item_check = map(check_of, parts)
        return lambda value: (
            isinstance(value, dict)
            and all(key_check(key) and item_check(item) for key, item in value.items())
        )
    if origin in (tuple, list, abc.Sequence, abc.Collection, abc.Iterable, frozenset, abc.Set):
        part_check = check_of(parts[0])
        sets = frozenset if origin in (frozenset, abc.Set) else (tuple, list)
        return lambda value: isinstance(value, sets) and all(map(part_check, value))
    if not isinstance(origin or hint, type):
        raise TypeError(f"a field of {hint}: nothing here checks such a kind")
    wanted: type | tuple[type, ...] = _NUMBERS.get(hint, origin or hint)
    no_bool = bool if hint in (int, float) else ()
    return lambda value: isinstance(value, wanted) and not isinstance(value, no_bool)


def _is_json(value: Any) -> bool:
    if isinstance(value, dict):
        return all(isinstance(key, str) and _is_json(part) for key, part in value.items())
    if isinstance(value, list):
        return all(map(_is_json, value))
    return value is None or type(value) in (bool, int, float, str)


def _array_check(dtype_hint: Any) -> Check:
    (element,) = typing.get_args(dtype_hint)
    if not (isinstance(element, type) and issubclass(element, np.generic)):
        return lambda value: isinstance(value, np.ndarray)
    return lambda value: isinstance(value, np.ndarray) and np.issubdtype(value.dtype, element)
