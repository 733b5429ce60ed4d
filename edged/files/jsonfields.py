"""Fields of a JSON document of ours, read with suspicion."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from edged.domain.arrays import FloatArray
from edged.errors import FileFormatError


class JsonFields:
    """Reads typed fields of a JSON object and names the place when one is wrong."""

    def __init__(self, path: Path, document: dict[str, Any], prefix: str = "") -> None:
        self.path, self.document, self.prefix = path, document, prefix

    def error(self, name: str, problem: str) -> FileFormatError:
        """What is wrong with a field."""
        return FileFormatError(f"{self.path}: {self.prefix}{name}: {problem}")

    def sub(self, name: str) -> JsonFields:
        """An object in a field."""
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

    def integer(self, name: str) -> int:
        """A size in pixels."""
        value = self.document.get(name)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 < value < 100_000:
            raise self.error(name, f"expected a size in pixels, got {value!r}")
        return value

    def array(self, name: str, shape: tuple[int, ...]) -> FloatArray:
        """Finite numbers in this shape."""
        try:
            value = np.array(self.document.get(name), dtype=np.float64)
        except (TypeError, ValueError):
            raise self.error(name, f"expected numbers in the shape {shape}") from None
        if value.shape != shape or not np.isfinite(value).all():
            raise self.error(name, f"expected finite numbers in the shape {shape}, got {value.shape}")
        return value

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
