"""STL files of one part: bare triangles without units, binary or as text."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from edged.domain.arrays import FloatArray
from edged.errors import FileFormatError
from edged.files.atomic import read_bytes
from edged.files.dxf import UNITS
from edged.vision.teaching.cadmodel import CadModel, open_sides, welded

MAX_FACETS = 500_000
"""Most triangles of one part; a casting meshed to a micrometre has half as many."""
MAX_SIZE_MM = 1e5
MAX_OPEN = 0.01
"""Largest share of edges without exactly one neighbour; beyond it the mesh is open or damaged."""
HEADER_BYTES, FACET_BYTES = 84, 50
"""80 arbitrary bytes and the count; for each facet twelve float32 and two bytes (StereoLithography
Interface Specification, 3D Systems 1988)."""
_CORNER = re.compile(rb"vertex" + 3 * rb"\s+([-+.0-9eE]{1,40})" + rb"\s")
_OTHER_WORDS = 100
"""Occurrences of "vertex" allowed that are no corners, such as in names of solids."""
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(path: Path, unit: str | None = None) -> CadModel:
    """Read the triangles of an STL file in mm, with coincident corners merged.

    unit : the file's unit, a key of `UNITS`; None: mm.
    Raises `FileFormatError` for a file that is not STL, is cut off, has coordinates that are not finite,
    more than `MAX_FACETS` facets, or is not the closed surface of one body.
    """
    path = Path(path)
    if unit is not None and unit not in UNITS:
        raise FileFormatError(f"{path}: unit {unit!r}: expected one of {', '.join(UNITS)}")
    data = read_bytes(path, "an STL file")
    with np.errstate(invalid="ignore"):  # values that are not finite are refused below
        corners = _text(data, path) if _is_text(data) else _binary(data, path)
    if not len(corners):
        raise FileFormatError(f"{path}: no facet: expected the triangles of one part")
    if not np.isfinite(corners).all():
        raise FileFormatError(f"{path}: coordinates that are no numbers: expected finite ones")
    corners = corners * (1.0 if unit is None else UNITS[unit])
    if float(np.abs(corners).max()) > MAX_SIZE_MM:
        raise FileFormatError(f"{path}: coordinates beyond {MAX_SIZE_MM:g} mm: expected one part")
    points, triangles = welded(corners)
    if len(triangles) < 4:
        raise FileFormatError(f"{path}: {len(triangles)} facets that have an area: expected a closed part")
    alone, bodies = open_sides(triangles)
    if alone > MAX_OPEN * 3 * len(triangles):
        raise FileFormatError(
            f"{path}: not closed: {alone} of the {3 * len(triangles)} sides of its facets do not have "
            "exactly one neighbour: expected the surface of a solid part"
        )
    if bodies != 1:
        raise FileFormatError(f"{path}: {bodies} bodies: expected the model of one part, one body")
    return CadModel(points, triangles, np.arange(len(triangles)), ())


def _is_text(data: bytes) -> bool:
    """Whether the file is text. Binary files may begin with `solid`, too, but their size fits their count."""
    counted = HEADER_BYTES + int.from_bytes(data[80:84], "little") * FACET_BYTES
    return data[:512].lstrip().startswith(b"solid") and len(data) != counted


def _binary(data: bytes, path: Path) -> FloatArray:
    """Corners (N, 3, 3) of a binary file."""
    if len(data) < HEADER_BYTES:
        raise FileFormatError(f"{path}: {len(data)} bytes: expected an STL file, at least {HEADER_BYTES}")
    count = int.from_bytes(data[80:84], "little")
    needed = HEADER_BYTES + count * FACET_BYTES
    if len(data) != needed:
        problem = "cut off, or no STL file" if len(data) < needed else "no STL file, or damaged"
        raise FileFormatError(
            f"{path}: {problem}: {count} facets take {needed} bytes, and it has {len(data)}"
        )
    _check_count(count, path)
    return np.asarray(np.frombuffer(data, _FACET, count, HEADER_BYTES)["corners"], np.float64)


def _text(data: bytes, path: Path) -> FloatArray:
    """Corners (N, 3, 3) of a text file."""
    if b"endsolid" not in data[-1024:]:
        raise FileFormatError(f"{path}: cut off: expected endsolid at its end")
    count = data.count(b"endfacet")
    _check_count(count, path)
    words = data.count(b"vertex")
    found = _CORNER.findall(data) if words <= 3 * count + _OTHER_WORDS else []
    if len(found) != 3 * count:
        corners = len(found) or words
        raise FileFormatError(f"{path}: damaged: {corners} corners of {count} facets: expected three each")
    try:
        return np.array(found).astype(np.float64).reshape(-1, 3, 3)
    except ValueError as error:
        raise FileFormatError(f"{path}: damaged: {error}") from error


def _check_count(count: int, path: Path) -> None:
    if count > MAX_FACETS:
        raise FileFormatError(f"{path}: {count} facets: expected one part, at most {MAX_FACETS}")
