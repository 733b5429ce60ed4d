"""Strict reading of the fields of a JSON document in one of our formats."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from edged.domain.arrays import FloatArray
from edged.domain.numerals import json_of
from edged.errors import FileFormatError


def text_of_json(document: Mapping[str, Any]) -> bytes:
    """Serialise a document as the bytes of a JSON file."""
    return (json.dumps(document, indent=1, allow_nan=False) + "\n").encode()


class JsonFields:
    """Reads typed fields of a JSON object and names the field when one is wrong."""

    def __init__(self, path: Path, document: dict[str, Any], prefix: str = "") -> None:
        self.path, self.document, self.prefix = path, document, prefix

    @staticmethod
    def of(
        data: bytes, path: Path, what: str, form: str, version: int, parse: Callable[[bytes], Any] = json_of
    ) -> JsonFields:
        """Parse a whole document. what, form : its name in messages, and the value of its "format".

        parse : `json.loads` if numbers that are not finite shall be reported by their field.
        Raises `FileFormatError` for another kind of document, or another version of it.
        """
        try:
            document = parse(data)
        except (ValueError, RecursionError) as error:
            raise FileFormatError(f"{path}: not JSON: {error}") from error
        if not isinstance(document, dict) or document.get("format") != form:
            raise FileFormatError(f'{path}: not a {what} (expected "format": "{form}")')
        if document.get("version") != version:
            raise FileFormatError(f"{path}: version {document.get('version')!r}, this edged reads {version}")
        return JsonFields(path, document)

    def error(self, name: str, problem: str) -> FileFormatError:
        """Error that names file and field."""
        return FileFormatError(f"{self.path}: {self.prefix}{name}: {problem}")

    def sub(self, name: str) -> JsonFields:
        """Reader of the object in a field."""
        value = self.document.get(name)
        if not isinstance(value, dict):
            raise self.error(name, f"expected an object, got {type(value).__name__}")
        return JsonFields(self.path, value, f"{self.prefix}{name}.")

    def number(self, name: str) -> float:
        """A finite number."""
        value = self.document.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise self.error(name, f"expected a number, got {value!r}")
        return float(value)

    def integer(self, name: str, most: int, least: int = 0, what: str = "") -> int:
        """A whole number from least to most. what : description for the message."""
        value = self.document.get(name)
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise self.error(
                name, f"expected {what or f'a whole number from {least} to {most}'}, got {value!r}"
            )
        return value

    def size_px(self, name: str) -> int:
        """A size in pixels."""
        return self.integer(name, 99_999, 1, "a size in pixels")

    def text(self, name: str) -> str:
        """A string that is not empty."""
        value = self.document.get(name)
        if not isinstance(value, str) or not value:
            raise self.error(name, f"expected a name, got {value!r}")
        return value

    def array(self, name: str, shape: tuple[int, ...]) -> FloatArray:
        """An array of this shape, all finite."""
        try:
            value = np.array(self.document.get(name), dtype=np.float64)
        except (TypeError, ValueError):
            raise self.error(name, f"expected numbers in the shape {shape}") from None
        if value.shape != shape or not np.isfinite(value).all():
            raise self.error(name, f"expected finite numbers in the shape {shape}, got {value.shape}")
        return value

    def transform_or_none(self, name: str) -> FloatArray | None:
        """A rigid motion (4, 4); None if the field is null or missing."""
        return None if self.document.get(name) is None else self.transform(name)

    def transform(self, name: str) -> FloatArray:
        """A rigid motion (4, 4)."""
        value = self.array(name, (4, 4))
        rotation = value[:3, :3]
        rigid = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) and np.linalg.det(rotation) > 0
        if not rigid or not np.allclose(value[3], (0, 0, 0, 1)):
            raise self.error(name, "expected a rigid 4x4 transform (rotation and translation)")
        return value

    def covariance(self, name: str, size: int) -> FloatArray:
        """A covariance (size, size)."""
        matrix = self.array(name, (size, size))
        if not np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-30) or (np.diag(matrix) < 0).any():
            raise self.error(name, "not a covariance (symmetric, positive)")
        return matrix
