"""Encoding of values as CBOR, and decoding, for a closed list of types only.

Either end refuses a type that is not on the list, and names it. A message may come from a process that was
compromised by a stranger's file: length, items and depth are counted before anything is constructed, objects
get fields of exactly the types that their class declares, and no code runs but the constructors on the list.

A message is a list of `FORMAT` and the value. A type that CBOR does not have is a list that begins with its
name: `["tuple", 1, 2]`, `["Circle3D", {"radius_mm": 5.0, ...}]`, `["Status", 1]`.
Source: RFC 8949.
"""

from __future__ import annotations

import enum
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import datetime
from importlib import import_module
from pathlib import Path, PurePath
from typing import Any

import cbor2
import numpy as np
from pydantic import BaseModel

from edged.cbor import CborBounds, decode_item, encode_text
from edged.codec.fieldkinds import checks_of
from edged.codec.plainerrors import error_of, plain_error
from edged.domain.arrays import Image
from edged.domain.frames import Frame, FramePair
from edged.domain.measurement import Nearest
from edged.errors import EdgedError, printable

FORMAT = 1
"""Number of this format; it grows when the encoding changes."""
_SEQUENCES: dict[type, str] = {list: "list", tuple: "tuple", frozenset: "set"}
_COLLECTED: dict[str, Callable[[list[Any]], Any]] = {"list": list, "tuple": tuple, "set": frozenset}
_ARRAY_KINDS = "biufUS"
DECODE_ERRORS = (
    cbor2.CBORDecodeError,
    TypeError,
    ValueError,
    LookupError,
    ArithmeticError,
    AttributeError,
    RecursionError,
)
"""Exceptions that decoding an invalid message raises."""


@dataclass(frozen=True, slots=True)
class Codec:
    """Encoder and decoder for a closed list of types, by name.

    kinds : dataclasses, models and enumerations, or the module that defines one. what : the messages' owner,
    for errors. bounds : of a message to decode.
    """

    what: str
    kinds: Mapping[str, type | str]
    bounds: CborBounds

    @classmethod
    def of(cls, what: str, kinds: Iterable[type], bounds: CborBounds) -> Codec:
        """Codec for classes that are imported already."""
        return cls(what, {kind.__name__: kind for kind in kinds}, bounds)

    def encode(self, value: object, images: list[Image] | None = None) -> bytes:
        """Encode a value. images : those of its frames are appended here, not written; None: written as well.

        Raises `TypeError` that names a type that is not on the list, `ValueError` beyond 64 bits.
        """
        return cbor2.dumps([FORMAT, self._plain(value, images)], encoders={str: encode_text})

    def decode(self, data: bytes, images: Sequence[Image | None] = ()) -> Any:
        """Decode a value. images : of its frames; a frame or pair whose image is None becomes None.

        Raises `ValueError`, with the reason, for anything that `encode` does not write.
        """
        try:
            message = decode_item(data, self.bounds)
            if not (isinstance(message, list) and len(message) == 2 and message[0] == FORMAT):
                raise ValueError(f"expected a list of the format, {FORMAT}, and a value")
            return self._value(message[1], images)
        except DECODE_ERRORS as error:
            why = printable(str(error)[:300]) or type(error).__name__
            raise ValueError(f"no message of {self.what}: {why}") from error

    # --- encoding --------------------------------------------------------------------------------

    def _plain(self, value: Any, images: list[Image] | None) -> Any:
        """Convert a value to types that CBOR has."""
        if value is None or type(value) in (bool, float, str, bytes):
            return value
        if type(value) is int:
            if not -(2**64) <= value < 2**64:
                raise ValueError(f"{value:#x} needs more than 64 bits")
            return value
        if isinstance(value, enum.Enum):
            return [self._name(type(value)), self._plain(value.value, images)]
        if isinstance(value, np.ndarray | np.generic):
            if value.dtype.kind not in _ARRAY_KINDS:
                raise TypeError(f"an array of {value.dtype} is no message of {self.what}")
            shape = [list(value.shape)] if isinstance(value, np.ndarray) else []
            return ["array" if shape else "scalar", value.dtype.str, *shape, value.tobytes()]
        if isinstance(value, Mapping):
            if all(type(key) is str for key in value):
                return {key: self._plain(item, images) for key, item in value.items()}
            pairs = ([self._plain(key, images), self._plain(item, images)] for key, item in value.items())
            return ["dict", *pairs]
        if (sequence := _SEQUENCES.get(type(value))) is not None:
            return [sequence, *(self._plain(part, images) for part in value)]
        if isinstance(value, PurePath):
            return ["path", bytes(value)]
        if isinstance(value, datetime):
            return ["time", value.isoformat()]
        if isinstance(value, Nearest):
            is_known = value.answered or not value.open
            return ["nearest", is_known, self._plain(value.answer if is_known else None, images)]
        if isinstance(value, EdgedError):
            return ["error", *(self._plain(part, images) for part in plain_error(value).values())]
        name = self._name(type(value))
        if isinstance(value, BaseModel):
            stated = {field: getattr(value, field) for field in sorted(value.model_fields_set)}
        else:
            stated = {field.name: getattr(value, field.name) for field in fields(value)}
        if isinstance(value, Frame) and images is not None:
            images.append(value.image)
            stated["image"] = len(images) - 1
        return [name, self._plain(stated, images)]

    def _name(self, kind: type) -> str:
        listed = self.kinds.get(kind.__name__)
        if listed is not kind and listed != kind.__module__:
            raise TypeError(f"{kind.__module__}.{kind.__qualname__} is no message of {self.what}")
        return kind.__name__

    # --- decoding --------------------------------------------------------------------------------

    def _value(self, plain: Any, images: Sequence[Image | None]) -> Any:
        """Convert CBOR types back to a value. Raises the exceptions in `DECODE_ERRORS`."""
        if isinstance(plain, dict):
            if not all(type(key) is str for key in plain):
                raise TypeError("a key that is no text")
            return {key: self._value(part, images) for key, part in plain.items()}
        if not isinstance(plain, list):
            if plain is not None and type(plain) not in (bool, int, float, str, bytes):
                raise TypeError(f"{type(plain).__name__} is no value")
            return plain
        if not plain or type(plain[0]) is not str:
            raise TypeError("a list that does not begin with what it is")
        name, *parts = plain
        if (collected := _COLLECTED.get(name)) is not None:
            return collected([self._value(part, images) for part in parts])
        match name, parts:
            case "array", [str(kind), list(shape), bytes(data)]:
                return _array(kind, shape, data)
            case "scalar", [str(kind), bytes(data)]:
                return _array(kind, [], data)[()]
            case "path", [bytes(path)]:
                return Path(path.decode("utf-8", "surrogateescape"))
            case "time", [str(at)]:
                return datetime.fromisoformat(at)
            case "dict", _:
                return {self._value(key, images): self._value(item, images) for key, item in parts}
            case "nearest", [bool(is_known), written]:
                answer = self._value(written, images)
                # a known answer is set now, which costs nothing; an unknown one stays open at the receiver
                nearest = Nearest(lambda: answer)
                if is_known:
                    nearest.ask()
                return nearest
            case "error", [kind, text, written]:
                return error_of(kind, text, self._value(written, images))
            case _, [stated]:
                return self._made(self._kind(name), stated, images)
        raise TypeError(f"{printable(name[:60])} does not have {len(parts)} parts of these kinds")

    def _kind(self, name: str) -> Any:
        listed = self.kinds.get(name)
        if listed is None:
            raise TypeError(f"{name[:60]} is not on the list of what may come")
        return getattr(import_module(listed), name) if isinstance(listed, str) else listed

    def _made(self, kind: Any, stated: Any, images: Sequence[Image | None]) -> Any:
        """Construct a value of a listed type from its fields."""
        if issubclass(kind, enum.Enum):
            return kind(self._value(stated, images))
        if type(stated) is not dict:
            raise TypeError(f"{kind.__name__} without its fields")
        if kind is Frame and images:
            image = images[stated["image"]]
            if image is None:
                return None
            stated = {**stated, "image": None}
        values = {str(name): self._value(part, images) for name, part in stated.items()}
        if issubclass(kind, BaseModel):
            if unknown := values.keys() - kind.model_fields.keys():
                raise TypeError(f"{kind.__name__} has no {min(unknown)[:60]}")
            return kind.model_validate(values)
        if kind is Frame and images:
            values["image"] = image
        if kind is FramePair and None in (values.get("left"), values.get("right")):
            return None
        checks = checks_of(kind)
        if values.keys() != checks.keys():
            raise TypeError(f"{kind.__name__} has other fields")
        for name, is_right in checks.items():
            if not is_right(values[name]):
                raise TypeError(f"{kind.__name__}.{name} is of another kind")
        return kind(**values)


def _array(kind: str, shape: list[Any], data: bytes) -> Any:
    if not re.fullmatch(rf"[<>|][{_ARRAY_KINDS}][0-9]{{1,4}}", kind):
        raise TypeError(f"an array of {kind[:20]} is no message")
    return np.frombuffer(data, np.dtype(kind)).reshape(shape).copy()
