"""Values of variables in robot languages: types, records, arrays, and numbers of 32 bits.

As strict as a compiler: a wrong type, a text that is too long, an index outside of an array are errors.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol


def single(value: float) -> float:
    """Round to the 32 bits of a robot's number."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def real(value: Any) -> float:
    """A number. Raises `TypeError` for anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{value!r} is no number")
    return float(value)


def whole(value: Any) -> int:
    """An integer of 32 bits. Raises `TypeError` for anything else."""
    if not real(value).is_integer() or abs(value) >= 2**31:
        raise TypeError(f"{value!r} is no whole number of 32 bits")
    return int(value)


def text_up_to(longest: int) -> Callable[[Any], str]:
    """Check for a text of at most this many characters, which raises `TypeError` for anything else."""

    def fitted(value: Any) -> str:
        if not isinstance(value, str) or len(value) > longest:
            raise TypeError(f"{value!r} is no text of {longest} characters")
        return value

    return fitted


def quoted(longest: int) -> Callable[[str], str]:
    """Reader of a text between double quotes, of at most this many characters."""

    def read(value: str) -> str:
        assert value[0] == '"', value
        return text_up_to(longest)(value[1:-1])

    return read


class Place(Protocol):
    """Something that can be read, and perhaps written."""

    type: str

    def get(self) -> Any: ...
    def set(self, value: Any) -> None: ...


@dataclass
class Value:
    """The value of an expression."""

    type: str
    value: Any

    def get(self) -> Any:
        """The value itself."""
        return self.value

    def set(self, value: Any) -> None:
        """Raises `TypeError`: an expression cannot be written to."""
        raise TypeError("an expression is no variable")


@dataclass
class Variable:
    """A variable, array element, or record field; `types` checks what is written."""

    type: str
    value: Any
    types: Types
    is_constant: bool = False

    def get(self) -> Any:
        """The current value."""
        return self.value

    def set(self, value: Any) -> None:
        """Assign a value. Raises `TypeError` if it does not fit."""
        if self.is_constant:
            raise TypeError("a constant is written to")
        self.value = self.types.fitted(self.type, value)


@dataclass
class Array:
    """Elements counted from 1, or from `first`."""

    type: str
    elements: list[Variable]
    first: int = 1

    def get(self) -> Any:
        """The array itself."""
        return self

    def set(self, value: Any) -> None:
        """Raises `TypeError`: no supported language assigns whole arrays."""
        raise TypeError("an array is written as a whole")

    def element(self, index: Any) -> Variable:
        """Element by index. Raises `IndexError` outside of its size."""
        if not float(index).is_integer() or not 0 <= index - self.first < len(self.elements):
            raise IndexError(f"{index} of {len(self.elements)}")
        return self.elements[int(index) - self.first]


@dataclass
class Record:
    """A value with named fields."""

    type: str
    fields: dict[str, Variable]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Record) and self.plain() == other.plain()

    def plain(self) -> dict[str, Any]:
        """Field names and values, nested down to numbers."""
        return {
            name: one.value.plain() if isinstance(one.value, Record) else one.value
            for name, one in self.fields.items()
        }


class Types:
    """The types of a language. records : fields and their types for each record type."""

    def __init__(
        self,
        scalars: dict[str, tuple[Any, Callable[[Any], Any]]],
        records: dict[str, dict[str, str]] | None = None,
    ) -> None:
        self.scalars = scalars
        self.records = records or {}

    def fitted(self, kind: str, value: Any) -> Any:
        """The value as a variable of that type stores it. Raises `TypeError`."""
        if kind in self.records:
            if not isinstance(value, Record) or value.type != kind:
                raise TypeError(f"{value!r} is no {kind}")
            return self.copied(value)
        return self.scalars[kind][1](value)

    def copied(self, record: Record) -> Record:
        """An independent copy."""
        kinds = self.records[record.type]
        return Record(
            record.type, {name: self.variable(kinds[name], one.value) for name, one in record.fields.items()}
        )

    def variable(self, kind: str, value: Any = None) -> Variable:
        """A new variable with the type's initial value."""
        if value is None:
            value = self.initial(kind)
        return Variable(kind, self.fitted(kind, value), self)

    def initial(self, kind: str) -> Any:
        """Value of an unassigned variable."""
        if kind in self.records:
            return Record(kind, {name: self.variable(one) for name, one in self.records[kind].items()})
        if kind not in self.scalars:
            raise TypeError(f"no type {kind}")
        return self.scalars[kind][0]

    def array(self, kind: str, size: int) -> Array:
        """An array with the type's initial values."""
        return Array(kind, [self.variable(kind) for _ in range(size)])
