"""Kinds of values that a kind of value may hold, however deep."""

from __future__ import annotations

import dataclasses
import enum
import typing
from typing import Any

from pydantic import BaseModel


def reachable(kind: Any, found: set[type]) -> None:
    """Every class that a value of a type may hold."""
    for part in typing.get_args(kind):
        if not isinstance(part, str | int):
            reachable(part, found)
    if not isinstance(kind, type) or kind in found:
        return
    if issubclass(kind, enum.Enum | BaseModel) or dataclasses.is_dataclass(kind):
        found.add(kind)
        for hint in typing.get_type_hints(kind).values():
            reachable(hint, found)
