"""Code shared by all foreign formats: options, the result, and strict reading of YAML."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from edged.domain.arrays import FloatArray
from edged.domain.numerals import decimal
from edged.errors import FileFormatError, UserError, translated
from edged.files.atomic import read_bytes
from edged.files.imagesizes import MAX_PIXELS
from edged.vision.geometry.camera import CameraModel, StereoRig, calibration_identity
from edged.vision.geometry.rigid import nearest_rotation, transform

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
_MAX_SIZE_PX = 100_000
MAX_TEXT_BYTES = 250_000
"""Largest YAML file: PyYAML takes twenty seconds for a million bytes. Camera files take a few kB, or 100 kB
with the points of all views."""
MAX_NODES = 50_000
"""Most values of a YAML file with its aliases expanded: nested aliases multiply them. Each list of ten
references to the list before it takes only a hundred bytes."""
_ROTATION_TOLERANCE = 1e-3  # files with four decimals are common; the nearest rotation is taken


@dataclass(frozen=True, slots=True)
class Options:
    """Facts that a file does not state itself.

    size : (width, height) of both images, for OpenCV files without one.
    unit_mm : the length unit of an OpenCV file, in mm.
    pixel_um : pixel size for HALCON files; every value gives the same geometry.
    """

    size: tuple[int, int] | None = None
    unit_mm: float = 1.0
    pixel_um: float = 3.45  # the most common sensors of such cameras (Sony IMX250 and relatives)

    def __post_init__(self) -> None:
        if not 0.1 <= self.pixel_um <= 100:
            raise UserError(f"pixel size {self.pixel_um:g} µm: expected 0.1 to 100")


DEFAULTS = Options()


@dataclass(frozen=True, slots=True, eq=False)
class Imported:
    """An imported rig in edged's conventions, and notes for the user about the conversion."""

    rig: StereoRig
    notes: tuple[str, ...]


def parse_size(text: str) -> tuple[int, int]:
    """Parse "1280x960" as (width, height)."""
    found = re.fullmatch(r"([0-9]{1,5})x([0-9]{1,5})", text.strip().lower())
    if not found or not all(int(n) > 0 for n in found.groups()):
        raise UserError(f"image size {text!r}: expected WIDTHxHEIGHT in pixels, e.g. 1280x960")
    return int(found[1]), int(found[2])


def make_rig(left: CameraModel, right: CameraModel, right_from_left: FloatArray) -> StereoRig:
    """Make a rig whose id derives from its values, as for every rig that was not calibrated here.

    Raises `FileFormatError`.
    """
    for camera in (left, right):
        if camera.width * camera.height > MAX_PIXELS:
            raise FileFormatError(
                f"images of {camera.width}x{camera.height}: expected at most {MAX_PIXELS} pixels"
            )
    return StereoRig(left, right, right_from_left, calibration_identity(left, right, right_from_left))


# --- fields -------------------------------------------------------------------------------------


class Fields:
    """Typed fields of a mapping; each error names the file and the field."""

    def __init__(self, path: Path, values: Mapping[str, Any], prefix: str = "") -> None:
        self.path, self.values, self.prefix = path, values, prefix

    def error(self, name: str, problem: str) -> FileFormatError:
        """Return, not raise, an error that names file and field."""
        return FileFormatError(f"{self.path}: {self.prefix}{name}: {problem}")

    def sub(self, name: str) -> Fields:
        """A nested mapping."""
        value = self.values.get(name)
        if not isinstance(value, Mapping):
            raise self.error(name, f"expected a mapping, got {_kind(value)}")
        return Fields(self.path, value, f"{self.prefix}{name}.")

    def text(self, name: str) -> str:
        """A string."""
        value = self.values.get(name)
        if not isinstance(value, str):
            raise self.error(name, f"expected text, got {_kind(value)}")
        return value

    def numbers(self, name: str, counts: tuple[int, ...] = ()) -> FloatArray:
        """A flat (N,) list of finite numbers; N one of `counts` if given.

        A matrix may be a nested list or OpenCV's and ROS's {rows, cols, data}.
        """
        value = self.values.get(name)
        if isinstance(value, Mapping):
            value = value.get("data")
        wanted = f"expected {' or '.join(str(n) for n in counts)} numbers" if counts else "expected numbers"
        if value is None or isinstance(value, str | bool | Mapping):
            raise self.error(name, f"{wanted}, got {_kind(value)}")
        try:
            array = np.array(value).ravel()
            if array.dtype.kind == "U":  # YAML 1.1 takes 1e-5 (no point) for a string
                array = np.array([decimal(text) for text in array.tolist()])
            if array.dtype.kind not in "iuf":
                raise TypeError(array.dtype)
            array = array.astype(np.float64)
        except (TypeError, ValueError, OverflowError):
            raise self.error(name, wanted) from None
        if not np.isfinite(array).all():
            raise self.error(name, f"{wanted}, all finite")
        if counts and len(array) not in counts:
            raise self.error(name, f"{wanted}, got {len(array)}")
        return array

    def number(self, name: str) -> float:
        """One finite number."""
        return float(self.numbers(name, (1,))[0])

    def size_px(self, name: str) -> int:
        """A positive whole number of pixels."""
        value = self.number(name)
        if value != round(value) or not 0 < value < _MAX_SIZE_PX:
            raise self.error(name, f"expected a size in pixels, got {value:g}")
        return int(value)

    def rotation(self, name: str) -> FloatArray:
        """Nine numbers that are nearly a rotation matrix, as the nearest rotation (3, 3)."""
        return self.nearest_rotation(name, self.numbers(name, (9,)).reshape(3, 3))

    def nearest_rotation(self, name: str, matrix: FloatArray) -> FloatArray:
        """The rotation nearest to `matrix`; an error if it deviates by more than rounding."""
        rotation = nearest_rotation(matrix) if np.linalg.det(matrix) > 0 else np.zeros((3, 3))
        if np.abs(rotation - matrix).max() > _ROTATION_TOLERANCE:
            raise self.error(name, "expected a rotation matrix (orthonormal, determinant 1)")
        return rotation

    def camera(
        self, matrix: FloatArray, size: tuple[int, int], distortion: tuple[float, ...], name: str
    ) -> CameraModel:
        """Brown-Conrady camera with the matrix (9,) fx, skew, cx, 0, fy, cy, 0, 0, 1."""
        fx, skew, cx, zero, fy, cy = (float(v) for v in matrix[:6])
        if not (fx > 0 and fy > 0):
            raise self.error(name, f"focal lengths must be positive, got {fx:g}, {fy:g}")
        if abs(skew) > 1e-6 * fx or zero != 0 or not np.allclose(matrix[6:], (0, 0, 1)):
            raise self.error(name, "expected [fx 0 cx; 0 fy cy; 0 0 1]; edged has no skew")
        return CameraModel("brown", *size, fx, fy, cx, cy, distortion)

    def brown(self, name: str, values: FloatArray) -> tuple[float, ...]:
        """k1, k2, p1, p2, k3 from OpenCV's 4 to 14 values; the values after k3 must be 0."""
        if len(values) not in (0, 4, 5, 8, 12, 14):
            raise self.error(name, f"expected 4, 5, 8, 12 or 14 values, got {len(values)}")
        if np.any(values[5:]):
            raise self.error(
                name, "rational, thin prism and tilt terms are not supported; calibrate with k1 k2 p1 p2 k3"
            )
        padded = np.zeros(5)
        padded[: min(5, len(values))] = values[:5]
        return tuple(float(v) for v in padded)


def relation(fields: Fields, name: str, rotation: FloatArray, translation_mm: FloatArray) -> FloatArray:
    """Build right_from_left (4, 4); an error if the baseline is zero."""
    if not float(np.linalg.norm(translation_mm)) > 1e-6:
        raise fields.error(name, "the baseline is zero: both cameras are in one place")
    return transform(rotation, translation_mm)


def _kind(value: object) -> str:
    return "nothing" if value is None else type(value).__name__


# --- YAML ---------------------------------------------------------------------------------------


class _Loader(yaml.SafeLoader):
    """YAML loader that reads OpenCV's matrices as mappings."""


def _opencv_matrix(loader: yaml.SafeLoader, node: yaml.Node) -> dict[Any, Any]:
    if not isinstance(node, yaml.MappingNode):
        raise yaml.constructor.ConstructorError(
            None, None, "opencv-matrix without rows, cols, data", node.start_mark
        )
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _opencv_matrix)


def load_yaml(path: Path) -> Fields:
    """Load the top-level mapping of a YAML file, including OpenCV's dialect."""
    try:
        raw = read_bytes(path, "camera parameters")
        if len(raw) > MAX_TEXT_BYTES:
            raise FileFormatError(
                f"{path}: {len(raw)} bytes are too many for camera parameters: at most {MAX_TEXT_BYTES}"
            )
        text = raw.decode("utf-8-sig")
        # "%YAML:1.0" is OpenCV's spelling of a directive that YAML writes with a space
        loader = _Loader(re.sub(r"\A%YAML:1\.0[^\n]*\n", "", text))
        try:
            node = loader.get_single_node()
            nodes = 0 if node is None else _expanded(node, {})
            if nodes > MAX_NODES:
                raise FileFormatError(
                    f"{path}: {nodes} values: expected camera parameters, at most {MAX_NODES}"
                )
            document = None if node is None else loader.construct_document(node)
        finally:
            loader.dispose()
    except (yaml.YAMLError, RecursionError, ValueError, TypeError) as error:
        problem = " ".join(str(error).split())[:200]
        raise FileFormatError(f"{path}: not YAML that can be read: {problem}") from error
    if not isinstance(document, Mapping) or not all(isinstance(key, str) for key in document):
        raise FileFormatError(f"{path}: expected named values, got {_kind(document)}")
    return Fields(path, document)


def _expanded(node: yaml.Node, known: dict[int, int]) -> int:
    """Count the values of a node with aliases expanded. Raises RecursionError if a node contains itself."""
    if id(node) not in known:
        inner = node.value if isinstance(node, yaml.CollectionNode) else []
        parts = (part for entry in inner for part in (entry if isinstance(entry, tuple) else (entry,)))
        known[id(node)] = 1 + sum(_expanded(part, known) for part in parts)
    return known[id(node)]


def holds(path: Path, *names: str) -> bool:
    """Whether a YAML file has all these keys; False if it cannot be read."""
    try:
        return path.is_file() and set(names) <= set(load_yaml(path).values)
    except FileFormatError:
        return False


def files_in(folder: Path, *suffixes: str) -> list[Path]:
    """The folder's files with these suffixes, sorted by name."""
    with translated(FileFormatError, f"{folder}: cannot be read"):
        return sorted(p for p in folder.iterdir() if p.suffix.lower() in suffixes and p.is_file())
