"""Collects the types that values of a type may contain, at any depth."""

from __future__ import annotations

import dataclasses
import enum
import typing
from typing import Any

from pydantic import BaseModel


def reachable(kind: Any, found: set[type]) -> None:
    """Add every class that a value of a type may contain to `found`."""
    for part in typing.get_args(kind):
        if not isinstance(part, str | int):
            reachable(part, found)
    if not isinstance(kind, type) or kind in found:
        return
    if issubclass(kind, enum.Enum | BaseModel) or dataclasses.is_dataclass(kind):
        found.add(kind)
        for hint in typing.get_type_hints(kind).values():
            reachable(hint, found)
